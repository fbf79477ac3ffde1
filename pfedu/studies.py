"""Monte Carlo studies: the same measurement over many runs and settings, in one call."""

import copy
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Summary:
    """What many independent runs say of one quantity.

    Attributes
    ----------
    values : ndarray, shape (n_runs, ...)
        One value a run.

    Examples
    --------
    >>> from pfedu.studies import Summary
    >>> Summary(np.array([1.0, 3.0]))
    2 ± 1 (2 runs)
    """

    values: np.ndarray

    @property
    def mean(self):
        """Mean over the runs: (...)."""
        return self.values.mean(axis=0)

    @property
    def standard_error(self):
        """Standard error of that mean, from the scatter of the runs: (...)."""
        return self.values.std(axis=0, ddof=1) / np.sqrt(len(self.values))

    def quantile(self, q):
        """Quantile over the runs: (...)."""
        return np.quantile(self.values, q, axis=0)

    def __repr__(self):
        if self.values.ndim > 1:
            return f"Summary of {len(self.values)} runs, each of shape {self.values.shape[1:]}"
        return f"{self.mean:.4g} ± {self.standard_error:.2g} ({len(self.values)} runs)"


def study(measure, settings, *, n_runs, rng, batch=100, map=map):
    """Measure every setting over many independent runs.

    Runs are done in batches, each with a generator of its own, the same for every setting (common random numbers:
    settings are compared under the same luck). A batch is one call, hence one array; batches may go to several
    processors or machines, and the numbers do not depend on where they were computed.

    Parameters
    ----------
    measure : callable
        ``(n_runs, rng, **setting) -> dict`` of quantities, each an array with one value a run, (n_runs, ...).
    settings : iterable of dict
        Keyword arguments for ``measure``.
    n_runs : int
        Runs of each setting, at least 2.
    rng : numpy.random.Generator
    batch : int
        Runs in one call.
    map : callable
        Anything that maps a function over a list in order: the built-in ``map``; ``Executor.map`` of
        ``concurrent.futures``; with joblib ``lambda f, jobs: Parallel(n_jobs=2)(delayed(f)(job) for job in jobs)``;
        with Dask ``lambda f, jobs: client.gather(client.map(f, jobs))``.

    Returns
    -------
    list of dict
        For each setting its quantities, by name, as :class:`Summary`.

    Raises
    ------
    ValueError
        If there are fewer than 2 runs, or a quantity does not have one value a run.
    TypeError
        If ``rng`` is not a generator.

    Examples
    --------
    >>> import pfedu
    >>> from pfedu.studies import rms, study
    >>> model, y = pfedu.models.random_walk(), np.array([np.nan, 1.0, 2.0])
    >>> exact = pfedu.kalman_filter(model, y)
    >>> def deviation(n_runs, rng, n_particles):
    ...     track = pfedu.bootstrap_filter(model, y, n_particles, rng=rng, n_runs=n_runs)
    ...     return {"rms": rms(track.mean - exact.mean, y)}
    >>> few, many = study(deviation, [{"n_particles": 10}, {"n_particles": 1000}], n_runs=50,
    ...                   rng=np.random.default_rng(1))
    >>> bool(few["rms"].mean > 5 * many["rms"].mean)
    True
    """
    if not isinstance(rng, np.random.Generator):
        raise TypeError(f"rng must be a numpy.random.Generator, e.g. numpy.random.default_rng(1); got {rng!r}")
    if not (n_runs >= 2 and batch >= 1 and n_runs == int(n_runs) and batch == int(batch)):
        raise ValueError(f"a study needs at least 2 runs, in batches of at least 1; got {n_runs} and {batch}")
    sizes = [min(batch, n_runs - begin) for begin in range(0, n_runs, batch)]
    seeds = rng.bit_generator.seed_seq.spawn(len(sizes))
    settings = [dict(setting) for setting in settings]
    jobs = [(measure, size, seed, setting) for setting in settings for size, seed in zip(sizes, seeds, strict=True)]
    results = list(map(_run, jobs))
    per_setting = [results[i : i + len(sizes)] for i in range(0, len(results), len(sizes))]
    return [{name: Summary(np.concatenate([part[name] for part in parts])) for name in parts[0]}
            for parts in per_setting]  # fmt: skip


def _run(job):
    measure, n_runs, seed, setting = job
    rng = np.random.default_rng(copy.deepcopy(seed))  # a seed counts what is spawned off it: each job has its own
    quantities = {name: np.asarray(values) for name, values in measure(n_runs, rng, **setting).items()}
    for name, values in quantities.items():
        if values.shape[:1] != (n_runs,):
            raise ValueError(f"{name} must have one value a run, ({n_runs}, ...); got {values.shape} for {setting}")
    return quantities


def rms(error, y):
    r"""Root mean square of an error over the steps that have a measurement.

    .. math:: \sqrt{\frac{1}{|K|} \sum_{k \in K} |e_k|^2}

    Parameters
    ----------
    error : ndarray, shape (..., T+1, n)
        In the units of the state.
    y : array_like, shape (T+1, n_y) or (T+1,)
        The record; steps whose row is NaN do not count.

    Returns
    -------
    ndarray, shape (...)

    Raises
    ------
    ValueError
        If the record has another number of rows, or no measurement.

    Examples
    --------
    >>> from pfedu.studies import rms
    >>> float(rms(np.array([[9.0], [3.0], [3.0]]), [np.nan, 0.0, 0.0]))
    3.0
    """
    y = np.asarray(y, dtype=float)
    seen = ~np.isnan(y if y.ndim == 1 else y[:, 0])
    if len(seen) != error.shape[-2] or not seen.any():
        raise ValueError(f"errors of {error.shape[-2]} steps do not fit a record of {len(seen)} rows, "
                         f"{int(seen.sum())} of them measured")  # fmt: skip
    return np.sqrt(np.mean(np.sum(error[..., seen, :] ** 2, axis=-1), axis=-1))


def particles_needed(error, target, *, start=10, most=10**6, factor=1.05):
    r"""Smallest number of particles whose error is at most the target, to within a factor.

    The error is taken to fall with N. N is doubled until it is small enough, and then bracketed by bisection on a
    logarithmic scale.

    Parameters
    ----------
    error : callable
        ``(n_particles) -> float``; use common random numbers, so that it falls steadily.
    target : float
        In the units of the error.
    start, most : int
        First N to try, and where to give up.
    factor : float
        How far apart the ends of the bracket may be.

    Returns
    -------
    int

    Raises
    ------
    ValueError
        If ``most`` particles are not enough, or their error is no number.

    Examples
    --------
    >>> from pfedu.studies import particles_needed
    >>> particles_needed(lambda n: 100 / n, 0.1, factor=1.001)
    1000
    """
    if not 1 <= start <= most:
        raise ValueError(f"start must lie between 1 and most, got {start} and {most}")
    low, high = 0, start
    while not error(high) <= target:  # true for NaN too
        if high == most:
            raise ValueError(f"{most} particles, the most allowed, have the error {error(most):g}, above {target:g}")
        low, high = high, min(2 * high, most)
    while high - low > 1 and high > factor * low:
        middle = round((low * high) ** 0.5) if low else high // 2
        low, high = (low, middle) if error(middle) <= target else (middle, high)
    return high
