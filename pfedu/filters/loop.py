"""The one loop of all particle filters: propose, weigh, estimate, resample.

A filter is a proposal and a weight. Everything else (carrying weights on, the log-likelihood,
estimates, N_eff, resampling, missing measurements, many runs at once) is here, written once.
"""

import numpy as np

from pfedu.models import read_only, require, streams
from pfedu.resampling import scheme
from pfedu.track import Track, read_record
from pfedu.weights import ZeroLikelihoodError, effective_sample_size, normalize, weighted_cov, weighted_mean


def particle_filter(propose, model, y, n_particles, *, rng, resampling, policy, keep=False, n_runs=None):
    """Run a particle filter over a record.

    Parameters
    ----------
    propose : callable
        ``(k, y, x, rng) -> (x, log_g)``: particles (..., N, n_x) of time k drawn from those of time
        k-1, and what their weights (..., N) are multiplied by. Runs without a measurement are
        propagated by the model instead (where others have one, ``y`` is NaN in theirs).
    model : StateSpaceModel
    y : array_like, shape (..., T+1, n_y)
        Measurements; a row of NaN is missing: predicted over, not corrected, not resampled.
    n_particles : int
        N, at least 1.
    rng : numpy.random.Generator
        Two generators are spawned off it, one that moves particles and one that picks them: the
        noise that moves them does not depend on how or when they are resampled.
    resampling : str or callable
        A scheme of :mod:`pfedu.resampling`.
    policy : callable
        When to resample: :class:`~pfedu.resampling.ratio` or :class:`~pfedu.resampling.interval`.
    keep : bool
        Keep particles, log weights and ancestors of each step.
    n_runs : int, optional
        Filter the same record that many times, independently.

    Returns
    -------
    Track

    Raises
    ------
    ValueError
        If an argument has the wrong shape or value.
    ZeroLikelihoodError
        If no particle of a run can explain a measurement; the message gives the step.

    Examples
    --------
    A filter whose particles ignore the measurement until they are weighed is the bootstrap filter:

    >>> import pfedu
    >>> from pfedu.filters.loop import particle_filter
    >>> from pfedu.resampling import always
    >>> model = pfedu.models.random_walk()
    >>> def propose(k, y, x, rng):
    ...     x = model.propagate(k, x, rng)
    ...     return x, model.log_likelihood(k, y, x)
    >>> track = particle_filter(propose, model, [0.0, 1.0], 100, rng=np.random.default_rng(1),
    ...                         resampling="systematic", policy=always)
    >>> track.mean.shape
    (2, 1)
    """
    y, missing, n_particles = _check(model, y, n_particles, n_runs, policy)
    pick, runs = scheme(resampling), y.shape[:-2]
    rng_move, rng_pick = streams(rng, 2)
    x = _start(model, runs, n_particles, rng_move)
    log_w = np.full(x.shape[:-1], -np.log(n_particles))
    ancestors = np.broadcast_to(np.arange(n_particles), log_w.shape)
    count = np.zeros(runs, dtype=int)  # corrections so far
    steps = []
    for k in range(y.shape[-2]):
        # Propose and weigh
        x, log_g = advance(propose, model, k, y[..., k, :], missing[..., k], x, rng_move)
        log_w, increment = reweight(log_w, log_g, k)
        increment = np.where(missing[..., k], 0.0, increment)
        # Estimate, before resampling adds its noise
        n_eff = effective_sample_size(log_w)
        step = (weighted_mean(x, log_w), weighted_cov(x, log_w), increment, n_eff)
        kept = (x, log_w, ancestors) if keep else (None, None, None)
        # Resample
        count = count + ~missing[..., k]
        due = policy(n_eff, n_particles, count) & ~missing[..., k]
        x, log_w, ancestors = resample(x, log_w, due, pick, rng_pick)
        steps.append((*step, due, *kept))
    return _track(steps, len(runs))


def advance(propose, model, k, y, missing, x, rng):
    """Particles of time k and the factors of their weights.

    Parameters
    ----------
    propose : callable
        ``(k, y, x, rng) -> (x, log_g)``.
    model : StateSpaceModel
    k : int
        Time; at 0 the particles stay where the prior put them.
    y : ndarray, shape (..., n_y)
    missing : ndarray of bool, shape (...)
    x : ndarray, shape (..., N, n_x)
    rng : numpy.random.Generator

    Returns
    -------
    x : ndarray, shape (..., N, n_x)
    log_g : ndarray, shape (..., N)
        Zero for a run whose measurement is missing.

    Raises
    ------
    ValueError
        If the model gives back the wrong shape.

    Examples
    --------
    >>> import pfedu
    >>> from pfedu.filters.loop import advance
    >>> model, y, missing = pfedu.models.random_walk(), np.array([1.0]), np.array(False)
    >>> x, log_g = advance(None, model, 0, y, missing, np.zeros((4, 1)), np.random.default_rng(1))
    >>> x.shape, log_g.round(4).tolist()
    ((4, 1), [-1.4189, -1.4189, -1.4189, -1.4189])
    """
    x = read_only(x)
    if missing.all():
        new = model.propagate(k, x, rng) if k > 0 else x
        log_g = np.zeros(x.shape[:-1])
    elif k == 0:
        new, log_g = x, model.log_likelihood(k, y[..., None, :], x)
    else:
        new, log_g = propose(k, y[..., None, :], x, rng)
        if missing.any():  # a run without a measurement has nothing to propose by
            new = np.where(missing[..., None, None], model.propagate(k, x, rng), new)
    if np.shape(new) != x.shape:
        raise ValueError(f"step {k}: propagate must keep the shape {x.shape} of the particles, it gave {np.shape(new)}")
    if np.shape(log_g) != x.shape[:-1]:
        raise ValueError(f"step {k}: log_likelihood must give one value a particle, shape {x.shape[:-1]}, "
                         f"it gave {np.shape(log_g)}")  # fmt: skip
    return new, np.where(missing[..., None], 0.0, log_g)


def reweight(log_w, log_g, k):
    r"""Multiply carried weights by new factors and normalise.

    .. math:: \log p(y_k \mid Y_{k-1}) \approx \log \sum_i w_{k-1}^{(i)} g^{(i)}

    Parameters
    ----------
    log_w : ndarray, shape (..., N)
        Normalised log weights carried over from the step before.
    log_g : ndarray, shape (..., N)
        Log of the factors.
    k : int
        Time, for the error.

    Returns
    -------
    log_w : ndarray, shape (..., N)
        Normalised.
    increment : ndarray, shape (...)
        Log-likelihood increment.

    Raises
    ------
    ZeroLikelihoodError
        If all weights of a run became zero.
    ValueError
        If a factor is NaN.

    Examples
    --------
    >>> from pfedu.filters.loop import reweight
    >>> log_w, increment = reweight(np.log([0.5, 0.5]), np.log([0.1, 0.3]), k=1)
    >>> np.exp(log_w).round(4).tolist(), round(float(np.exp(increment)), 4)
    ([0.25, 0.75], 0.2)
    """
    try:
        return normalize(log_w + log_g)
    except ZeroLikelihoodError as error:
        lost = np.argwhere(np.isneginf(np.max(log_w + log_g, axis=-1)))[0].tolist()
        raise ZeroLikelihoodError(
            f"step {k}{f', run {lost}' if lost else ''}: every particle has likelihood zero. The measurement is where "
            "no particle is: use more particles, a wider prior or process noise, a measurement noise with heavier "
            "tails, or check its units"
        ) from error
    except ValueError as error:
        raise ValueError(f"step {k}: log_likelihood gave a value that is no weight ({error})") from error


def resample(x, log_w, due, pick, rng):
    """Resample the runs that are due; the others keep particles and weights.

    Parameters
    ----------
    x : ndarray, shape (..., N, n_x)
    log_w : ndarray, shape (..., N)
        Normalised log weights.
    due : ndarray of bool, shape (...)
    pick : callable
        A scheme of :mod:`pfedu.resampling`.
    rng : numpy.random.Generator

    Returns
    -------
    x : ndarray, shape (..., N, n_x)
    log_w : ndarray, shape (..., N)
        1/N each in a run that was resampled.
    ancestors : ndarray of int, shape (..., N)

    Examples
    --------
    >>> from pfedu.filters.loop import resample
    >>> from pfedu.resampling import systematic
    >>> x, log_w = np.array([[1.0], [2.0]]), np.log([1e-9, 1 - 1e-9])
    >>> x, log_w, ancestors = resample(x, log_w, np.array(True), systematic, np.random.default_rng(1))
    >>> x.ravel().tolist(), np.exp(log_w).tolist(), ancestors.tolist()
    ([2.0, 2.0], [0.5, 0.5], [1, 1])
    """
    n = log_w.shape[-1]
    own = np.broadcast_to(np.arange(n), log_w.shape)
    if not due.any():
        return x, log_w, own
    picked = np.asarray(pick(np.exp(log_w), rng))
    if picked.shape != log_w.shape or picked.dtype.kind not in "iu":
        raise ValueError(
            f"resampling must give whole numbers of shape {log_w.shape}, it gave {picked.dtype} {picked.shape}"
        )
    ancestors = np.where(due[..., None], picked, own)
    x = np.take_along_axis(x, ancestors[..., None], axis=-2)
    return x, np.where(due[..., None], -np.log(n), log_w), ancestors


def _check(model, y, n_particles, n_runs, policy):
    if not callable(policy):
        raise TypeError(
            f"policy must be ratio(share), interval(n), always or never of pfedu.resampling, got {policy!r}"
        )
    for piece in ("sample_initial", "propagate", "log_likelihood"):
        require(model, piece, "a particle filter")
    for name, value in {"n_particles": n_particles, "n_runs": 1 if n_runs is None else n_runs}.items():
        if not (value >= 1 and value == int(value)):
            raise ValueError(f"{name} must be a whole number of at least 1, got {value}")
    y, missing = read_record(y, model.n_y)
    if n_runs is not None:
        y, missing = (np.broadcast_to(a, (int(n_runs), *a.shape)) for a in (y, missing))
    return y, missing, int(n_particles)


def _start(model, runs, n, rng):
    """Particles from p(x_0): (*runs, N, n_x)."""
    total = int(np.prod(runs)) * n
    x = np.asarray(model.sample_initial(total, rng), dtype=float)
    if x.shape != (total, model.n_x):
        raise ValueError(f"sample_initial({total}, rng) must give shape ({total}, {model.n_x}), it gave {x.shape}")
    return x.reshape(*runs, n, model.n_x)


def _track(steps, axis):
    """Stack the steps along the time axis, which follows the runs."""
    columns = [None if c[0] is None else np.stack(c, axis) for c in zip(*steps, strict=True)]
    mean, cov, increments, n_eff, resampled, particles, log_weights, ancestors = columns
    return Track(mean, cov, increments, n_eff, resampled, particles, log_weights, ancestors)
