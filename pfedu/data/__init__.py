"""Real records that travel with the package. Where each comes from stands in ``README.md`` beside them."""

from importlib.resources import files

import numpy as np


def nile():
    """Annual flow of the Nile at Aswan, 1871 to 1970.

    The record of Cobb (1978), public domain. Its local level model is the first worked example of
    Durbin and Koopman, *Time Series Analysis by State Space Methods*.

    Returns
    -------
    year : ndarray of int, shape (100,)
    flow : ndarray, shape (100,)
        In units of 10^8 cubic metres a year.

    Examples
    --------
    >>> from pfedu.data import nile
    >>> year, flow = nile()
    >>> int(year[0]), float(flow[0]), len(flow)
    (1871, 1120.0, 100)
    """
    with files("pfedu.data").joinpath("nile.csv").open(encoding="utf-8") as record:
        table = np.loadtxt(record, delimiter=",", skiprows=1)
    return table[:, 0].astype(int), table[:, 1]
