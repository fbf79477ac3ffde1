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
    year, flow = _columns("nile.csv")
    return year.astype(int), flow.astype(float)


def sp500():
    """Daily returns of the S&P 500 stock index, 3 January 2007 to 31 December 2009.

    Differences of the logarithm of the adjusted closing value, in per cent: three years of trading days with a calm
    beginning and the crisis of autumn 2008. Cut from the daily record that the package arch carries (Sheppard 2017,
    NCSA licence).

    Returns
    -------
    day : ndarray of datetime64, shape (756,)
        Trading days only; the index is not traded at weekends and on holidays.
    change : ndarray, shape (756,)
        In per cent a day.

    Examples
    --------
    >>> from pfedu.data import sp500
    >>> day, change = sp500()
    >>> str(day[change.argmin()]), float(change.min()), len(change)
    ('2008-10-15', -9.4695, 756)
    """
    return _dated("sp500.csv")


def co2():
    """Weekly carbon dioxide in the air of Mauna Loa, Hawaii, March 1958 to December 1965, with gaps.

    The record of Keeling and Whorf (2004), public domain. Weeks without a measurement are NaN, as every filter of this
    package wants them.

    Returns
    -------
    day : ndarray of datetime64, shape (405,)
        The Saturday of each week, none left out.
    ppm : ndarray, shape (405,)
        Parts per million; NaN in 47 weeks.

    Examples
    --------
    >>> from pfedu.data import co2
    >>> day, ppm = co2()
    >>> str(day[0]), float(ppm[0]), int(np.isnan(ppm).sum())
    ('1958-03-29', 316.1, 47)
    """
    return _dated("co2.csv")


def _columns(name):
    """Both columns of a record as text; arrays of their own at each call."""
    with files("pfedu.data").joinpath(name).open(encoding="utf-8") as record:
        return np.loadtxt(record, delimiter=",", skiprows=1, dtype=str, unpack=True)


def _dated(name):
    """Days, and what was measured on them: NaN where nothing was."""
    day, value = _columns(name)
    return day.astype("datetime64[D]"), np.where(value == "", "nan", value).astype(float)
