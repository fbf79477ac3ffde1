"""CPU time of each filter as a multiple of the extended Kalman filter's, for the figure of chapter 12.

    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/which_filter.py [--rounds R] [--out book/_data/which-filter.csv]

Seconds differ from machine to machine, and on one machine from minute to minute. So the filters take turns, and each
is divided by the EKF of the same system and of the same round; what is written is the median of these ratios and its
quartiles. ``records`` is how many records are filtered in one call: 1 is a filter at work, 100 a study.
"""

import argparse
import csv
import statistics
import time
from pathlib import Path

import numpy as np

import pfedu
from pfedu import models

SYSTEMS = {"growth": models.growth, "van der Pol": models.van_der_pol}
SIZES = (10, 100, 1000, 10_000)
STEPS = 50


def filters(records):
    """Name, N and a function (model, y) of each filter that takes its turn."""
    yield "EKF", 0, lambda model, y: pfedu.extended_kalman_filter(model, y)
    yield "UKF", 0, lambda model, y: pfedu.unscented_kalman_filter(model, y)
    for N in SIZES if records == 1 else SIZES[:-1]:
        yield "bootstrap", N, _particles(pfedu.bootstrap_filter, N)
        yield "auxiliary", N, _particles(pfedu.auxiliary_filter, N)
        if records * N <= 10_000:
            yield "local linear", N, _particles(pfedu.local_linear_filter, N, proposal="ukf")


def _particles(run, N, **how):
    return lambda model, y: run(model, y, N, rng=np.random.default_rng(1), **how)


def cpu(run, model, y, least=0.02):
    """CPU seconds of one call, the mean over so many calls that they take a while."""
    began, calls = time.process_time(), 0
    while (spent := time.process_time() - began) < least:
        run(model, y)
        calls += 1
    return spent / calls


def ratios(system, records, rounds):
    """Rows of the table for one system."""
    model = SYSTEMS[system]()
    y = model.simulate(STEPS, np.random.default_rng(1), n_runs=records)[1]
    turns = list(filters(records))
    found = [[cpu(run, model, y) for *_, run in turns] for _ in range(rounds)]
    for i, (name, N, _) in enumerate(turns):
        each = [row[i] / row[0] for row in found]
        low, median, high = statistics.quantiles(each, n=4) if rounds > 1 else each * 3
        yield [system, records, name, N, *(f"{value:.3g}" for value in (median, low, high))]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=9, help="how often each filter takes its turn (default 9)")
    default = Path(__file__).parents[1] / "book" / "_data" / "which-filter.csv"
    parser.add_argument("--out", type=Path, default=default, help="the table that the chapter reads")
    options = parser.parse_args()
    with open(options.out, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["system", "records", "filter", "N", "cpu_ratio", "lower_quartile", "upper_quartile"])
        for system in SYSTEMS:
            for records in (1, 100):
                writer.writerows(ratios(system, records, options.rounds))
    print(options.out.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
