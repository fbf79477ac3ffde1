"""Particle filters: one file an algorithm, one loop for all."""

from pfedu.filters.bootstrap import bootstrap_filter

__all__ = ["bootstrap_filter"]
