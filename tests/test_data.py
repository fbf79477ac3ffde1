"""Records that travel with the package."""

import numpy as np

from pfedu.data import nile


def test_the_nile_is_the_published_record():
    """Catches a row lost, doubled or mistyped: sums, extremes and their years are those of the copy in statsmodels."""
    year, flow = nile()
    assert year.tolist() == list(range(1871, 1971)) and flow.shape == (100,)
    assert flow.sum() == 91935 and (flow**2).sum() == 87355599
    assert (flow.max(), year[flow.argmax()]) == (1370, 1879)
    assert (flow.min(), year[flow.argmin()]) == (456, 1913)
    assert flow[:5].tolist() == [1120, 1160, 963, 1210, 1160] and flow[-1] == 740
    assert np.issubdtype(year.dtype, np.integer)


def test_each_call_gives_its_own_arrays():
    """Catches a record shared between callers, where blanking the first row blanks it for all."""
    nile()[1][0] = np.nan
    assert nile()[1][0] == 1120
