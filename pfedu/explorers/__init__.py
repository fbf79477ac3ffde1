"""Explorers: figures with controls, written once and shown in Jupyter and in the page alike.

An explorer is one file in this folder with one object, ``EXPLORER``: its controls, how to build its
artists once, and how to give them new data. It knows nothing of where it runs. ``load("sir")`` finds
it by the name of its file; nothing is registered anywhere.
"""

from importlib import import_module
from pkgutil import iter_modules

from pfedu.explorers.controls import Choice, Seed, Slider
from pfedu.explorers.explorer import Explorer, Puzzle, Shown

__all__ = ["Choice", "Explorer", "Puzzle", "Seed", "Shown", "Slider", "load", "names"]

_PARTS = {"controls", "explorer", "stage"}  # what explorers are made of, not explorers


def names():
    """Names of all explorers.

    Returns
    -------
    list of str

    Examples
    --------
    >>> from pfedu.explorers import names
    >>> "sir" in names()
    True
    """
    return sorted(found.name for found in iter_modules(__path__) if found.name not in _PARTS)


def load(name):
    """The explorer in the file of that name.

    Parameters
    ----------
    name : str

    Returns
    -------
    Explorer

    Raises
    ------
    ValueError
        If there is no such file; the message lists those there are.

    Examples
    --------
    >>> from pfedu.explorers import load
    >>> load("sir").defaults()["N"]
    500
    """
    if name not in names():
        raise ValueError(f"no explorer {name!r}: there are {', '.join(names())}")
    return import_module(f"pfedu.explorers.{name}").EXPLORER
