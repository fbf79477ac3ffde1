"""Particle filters: one file an algorithm, one loop for all."""

from pfedu.filters.auxiliary import auxiliary_filter
from pfedu.filters.bootstrap import bootstrap_filter
from pfedu.filters.kalman_bank import kalman_bank_filter
from pfedu.filters.local_linear import local_linear_filter
from pfedu.filters.optimal import optimal_filter
from pfedu.filters.rao_blackwellized import rao_blackwellized_filter
from pfedu.filters.regularized import regularized_filter

__all__ = [
    "auxiliary_filter",
    "bootstrap_filter",
    "kalman_bank_filter",
    "local_linear_filter",
    "optimal_filter",
    "rao_blackwellized_filter",
    "regularized_filter",
]
