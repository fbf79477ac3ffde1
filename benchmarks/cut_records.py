"""Cut the records of ``pfedu/data`` out of the packages that carry them: ``python benchmarks/cut_records.py [folder]``.

It wants ``arch`` and ``statsmodels`` (any environment will do, pfedu itself needs neither) and writes ``sp500.csv``
and ``co2.csv`` into the folder, by default ``pfedu/data``: the files in the tree are what it writes.
"""

import sys
from pathlib import Path

import numpy as np
from arch.data import sp500
from statsmodels.datasets import co2


def returns():
    """Daily log returns of the adjusted close in per cent, first day after 2006 to last day of 2009."""
    price = sp500.load()["Adj Close"]
    return (100 * np.log(price)).diff()["2007-01-01":"2009-12-31"]


def weeks():
    """Weekly means, from the first one to the end of 1965; weeks that were not measured stay empty."""
    return co2.load_pandas().data["co2"][:"1965-12-31"]


def write(path, name, values, digits):
    """One row a date; nothing after the comma where nothing was measured."""
    rows = (
        f"{day:%Y-%m-%d},{'' if np.isnan(value) else format(value, f'.{digits}f')}" for day, value in values.items()
    )
    path.write_text("\n".join([f"date,{name}", *rows, ""]), encoding="utf-8")


if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[1] / "pfedu/data")
    write(folder / "sp500.csv", "return", returns(), 4)
    write(folder / "co2.csv", "ppm", weeks(), 1)
