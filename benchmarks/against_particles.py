"""Side by side with the package `particles`: the growth model, one big filter and a batch of many small ones.

``python benchmarks/against_particles.py [repeats]`` needs particles 0.4 beside pfedu; it asks for older versions of
numpy and scipy, so give it an environment of its own:

    python -m venv bench
    bench/bin/pip install particles==0.4 -e .
    bench/bin/python benchmarks/against_particles.py

Both filter the same record, resample systematically when N_eff falls below N/2, and give mean and variance of each
step. The two take turns, and what is printed is the ratio of each pair.
"""

import argparse
import statistics
import time

import numpy as np

import pfedu

try:
    import particles
    from particles import distributions, state_space_models
    from particles.collectors import Moments
except ImportError as error:
    raise SystemExit("particles is not installed; the first lines of this file say how") from error


class Growth(state_space_models.StateSpaceModel):
    """The growth model as `particles` states it."""

    def PX0(self):
        return distributions.Normal(scale=np.sqrt(5.0))

    def PX(self, t, xp):
        mean = xp / 2 + 25 * xp / (1 + xp * xp) + 8 * np.cos(1.2 * t)
        return distributions.Normal(loc=mean, scale=np.sqrt(10.0))

    def PY(self, t, xp, x):
        return distributions.Normal(loc=x * x / 20, scale=1.0)


def theirs(y, n, runs):
    for seed in range(runs):
        np.random.seed(seed)  # noqa: NPY002
        model = state_space_models.Bootstrap(ssm=Growth(), data=y[:, 0])
        particles.SMC(fk=model, N=n, resampling="systematic", ESSrmin=0.5, collect=[Moments()]).run()


def ours(y, n, runs):
    options = {} if runs == 1 else {"n_runs": runs}
    pfedu.bootstrap_filter(pfedu.models.growth(), y, n, rng=np.random.default_rng(1), **options)


def seconds(work, *args):
    began = time.process_time()
    work(*args)
    return time.process_time() - began


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("repeats", type=int, nargs="?", default=9, help="pairs of runs (default 9)")
    repeats = parser.parse_args().repeats
    y = pfedu.models.growth().simulate(49, np.random.default_rng(1))[1]
    for name, n, runs, steps in (("one filter, N = 100 000, 50 steps", 100_000, 1, 50),
                                 ("100 filters, N = 500, 50 steps", 500, 100, 50)):  # fmt: skip
        record = y[:steps]
        ours(record, n, runs), theirs(record, n, min(runs, 2))  # compile what is compiled once
        pairs = [(seconds(theirs, record, n, runs), seconds(ours, record, n, runs)) for _ in range(repeats)]
        ratios = [a / b for a, b in pairs]
        print(f"{name}: particles / pfedu: median {statistics.median(ratios):.2f}, {min(ratios):.2f} to "
              f"{max(ratios):.2f} over {repeats} pairs; medians {statistics.median(a for a, _ in pairs):.3f} s and "
              f"{statistics.median(b for _, b in pairs):.3f} s")  # fmt: skip


if __name__ == "__main__":
    main()
