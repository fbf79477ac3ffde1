"""The records with exact answers in ``reference/``, as the tests read them."""

import json
from pathlib import Path

import numpy as np

REFERENCE = Path(__file__).parent / "reference"


def reference(name):
    """Columns of a reference record, by name."""
    return np.genfromtxt(REFERENCE / f"{name}.csv", delimiter=",", names=True)


def measurements(name, *, with_y0=False):
    """Its measurements, one row a time step; the first is missing unless ``with_y0``."""
    y = reference(name)["y"][:, None].copy()
    if not with_y0:
        y[0] = np.nan
    return y


def resampling_cases():
    """The weight vector whose counts have known means and variances."""
    return json.loads((REFERENCE / "resampling_cases.json").read_text(encoding="utf-8"))
