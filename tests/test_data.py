"""Records that travel with the package."""

import numpy as np
import pytest

from pfedu.data import co2, nile, sp500


def test_the_nile_is_the_published_record():
    """Catches a row lost, doubled or mistyped: sums, extremes and their years are those of the copy in statsmodels."""
    year, flow = nile()
    assert year.tolist() == list(range(1871, 1971)) and flow.shape == (100,)
    assert flow.sum() == 91935 and (flow**2).sum() == 87355599
    assert (flow.max(), year[flow.argmax()]) == (1370, 1879)
    assert (flow.min(), year[flow.argmin()]) == (456, 1913)
    assert flow[:5].tolist() == [1120, 1160, 963, 1210, 1160] and flow[-1] == 740
    assert np.issubdtype(year.dtype, np.integer)


def test_the_returns_lead_from_one_published_close_to_the_other():
    """Catches a day lost or doubled, a plain return taken for a logarithm, and a wrong window.

    Logarithms of returns add up to that of the whole: the index closed at 1418.30 on 29 December 2006 and at 1115.10
    on 31 December 2009. Each of the 756 was rounded to 0.0001, which leaves at most 0.04.
    """
    day, change = sp500()
    assert abs(change.sum() - 100 * np.log(1115.10 / 1418.30)) < 0.04
    by_year = [np.sum(day.astype("datetime64[Y]").astype(int) + 1970 == year) for year in (2007, 2008, 2009)]
    assert by_year == [251, 253, 252] and change.shape == (756,)
    assert (np.diff(day) > np.timedelta64(0)).all()
    assert np.is_busday(day).all()  # no Saturday, no Sunday


def test_the_returns_are_those_of_the_source():
    """Catches a digit mistyped: the sum of squares and the extreme days are those of arch 8.0.0."""
    day, change = sp500()
    assert (change**2).sum() == pytest.approx(2688.90071465, abs=1e-9)
    extremes = {str(day[change.argmax()]): change.max(), str(day[change.argmin()]): change.min()}
    assert extremes == {"2008-10-13": 10.9572, "2008-10-15": -9.4695}
    assert change[day == np.datetime64("2008-09-29")].tolist() == [-9.2190]


def test_the_weeks_of_carbon_dioxide_are_complete_and_the_gaps_are_gaps():
    """Catches a gap closed by leaving its weeks out or by a zero: sums and counts are those of statsmodels 0.15.0."""
    day, ppm = co2()
    assert (str(day[0]), str(day[-1])) == ("1958-03-29", "1965-12-25")
    assert (np.diff(day) == np.timedelta64(7, "D")).all() and ppm.shape == (405,)
    assert np.isnan(ppm).sum() == 47
    assert np.nansum(ppm) == pytest.approx(113788.5, abs=1e-6)
    assert np.nansum(ppm**2) == pytest.approx(36168916.63, abs=1e-4)
    assert (np.nanmin(ppm), np.nanmax(ppm)) == (313.0, 322.4)


@pytest.mark.parametrize("record", [nile, sp500, co2])
def test_each_call_gives_its_own_arrays(record):
    """Catches a record shared between callers, where blanking the first row blanks it for all."""
    first = record()[1][0]
    record()[1][0] = np.nan
    assert record()[1][0] == first
