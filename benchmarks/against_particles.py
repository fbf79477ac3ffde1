"""Side by side with the package `particles` 0.4: the growth model, one big filter and a batch of many small ones.

`particles` 0.4 asks for numpy 1, pfedu for numpy 2, so each runs in an environment of its own, and the two take turns:

    python -m venv _build/particles && _build/particles/bin/pip install particles==0.4
    OPENBLAS_NUM_THREADS=1 .venv/bin/python benchmarks/against_particles.py _build/particles/bin/python

Both filter the same simulated record, resample systematically when N_eff falls below N/2, and give mean and variance
of each step. What is printed is the ratio of CPU seconds, pair by pair.
"""

import argparse
import json
import statistics
import subprocess
import sys
import time

import numpy as np

SIZES = {"one filter of 100 000 particles": (100_000, 1), "100 filters of 500 particles": (500, 100)}


def with_particles():
    """A function (y, n, runs) that filters with `particles`."""
    import particles
    from particles import distributions, state_space_models
    from particles.collectors import Moments

    class Growth(state_space_models.StateSpaceModel):
        def PX0(self):
            return distributions.Normal(scale=np.sqrt(5.0))

        def PX(self, t, xp):
            mean = xp / 2 + 25 * xp / (1 + xp * xp) + 8 * np.cos(1.2 * t)
            return distributions.Normal(loc=mean, scale=np.sqrt(10.0))

        def PY(self, t, xp, x):
            return distributions.Normal(loc=x * x / 20, scale=1.0)

    def run(y, n, runs):
        for _ in range(runs):
            model = state_space_models.Bootstrap(ssm=Growth(), data=y)
            particles.SMC(fk=model, N=n, resampling="systematic", ESSrmin=0.5, collect=[Moments()]).run()

    return run


def with_pfedu():
    """A function (y, n, runs) that filters with pfedu."""
    import pfedu

    def run(y, n, runs):
        options = {} if runs == 1 else {"n_runs": runs}
        pfedu.bootstrap_filter(pfedu.models.growth(), y[:, None], n, rng=np.random.default_rng(1), **options)

    return run


def work(run):
    """Answer each line of input, a record and a size, with the CPU seconds of one run."""
    for line in sys.stdin:
        y, n, runs = json.loads(line)
        began = time.process_time()
        run(np.array(y), n, runs)
        print(time.process_time() - began, flush=True)


class Worker:
    """An interpreter that filters when asked."""

    def __init__(self, python, package):
        command = [python, __file__, "--work", package]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def seconds(self, *job):
        self.process.stdin.write(json.dumps(job) + "\n")
        self.process.stdin.flush()
        answer = self.process.stdout.readline()
        if not answer:
            raise SystemExit("a worker ended; does its environment have the package? The first lines here say how")
        return float(answer)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("python", nargs="?", help="the Python of an environment with particles 0.4")
    parser.add_argument("--repeats", type=int, default=11, help="pairs of runs (default 11)")
    parser.add_argument("--work", choices=["particles", "pfedu"], help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        return work({"particles": with_particles, "pfedu": with_pfedu}[options.work]())
    if not options.python:
        parser.error("name the Python of an environment with particles 0.4; the first lines of this file say how")
    import pfedu

    theirs, ours = Worker(options.python, "particles"), Worker(sys.executable, "pfedu")
    y = pfedu.models.growth().simulate(49, np.random.default_rng(1))[1][:, 0].tolist()
    for name, size in SIZES.items():
        theirs.seconds(y, *size), ours.seconds(y, *size)  # what is compiled once is compiled now
        pairs = [(theirs.seconds(y, *size), ours.seconds(y, *size)) for _ in range(options.repeats)]
        ratios = [a / b for a, b in pairs]
        a, b = (statistics.median(column) for column in zip(*pairs, strict=True))
        print(f"{name}, {len(y)} steps: particles / pfedu = {statistics.median(ratios):.2f} (median of {len(pairs)} "
              f"pairs, {min(ratios):.2f} to {max(ratios):.2f}); {a:.3f} and {b:.3f} CPU seconds")  # fmt: skip


if __name__ == "__main__":
    main()
