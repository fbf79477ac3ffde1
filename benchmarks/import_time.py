"""What importing pfedu costs beyond numpy: ``python benchmarks/import_time.py [repeats]``.

Each measurement is a fresh interpreter; the two kinds take turns, so that a machine that slows down
slows both. The difference is printed with its standard error over the pairs.
"""

import argparse
import statistics
import subprocess
import sys

CLOCK = "from time import perf_counter; start = perf_counter(); {}; print(perf_counter() - start)"


def seconds(statement):
    """Time that one statement takes in a fresh interpreter."""
    run = subprocess.run([sys.executable, "-c", CLOCK.format(statement)], capture_output=True, text=True, check=True)
    return float(run.stdout)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("repeats", type=int, nargs="?", default=30, help="pairs of fresh interpreters (default 30)")
    repeats = parser.parse_args().repeats
    if repeats < 2:
        parser.error("a standard error needs at least 2 repeats")
    seconds("import numpy, pfedu")  # compiles what is not compiled yet
    alone, both = zip(*((seconds("import numpy"), seconds("import numpy, pfedu")) for _ in range(repeats)), strict=True)
    for label, times in (("import numpy", alone), ("import numpy, pfedu", both)):
        print(f"{label:22s} median {1e3 * statistics.median(times):6.1f} ms")
    extra = [b - a for a, b in zip(alone, both, strict=True)]
    error = statistics.stdev(extra) / repeats**0.5
    print(f"{'pfedu itself':22s} mean   {1e3 * statistics.mean(extra):6.1f} +- {1e3 * error:.1f} ms, {repeats} pairs")


if __name__ == "__main__":
    main()
