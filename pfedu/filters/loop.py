"""The one loop of all particle filters: propose, weigh, estimate, resample.

A filter is a proposal and a weight. Everything else (carrying weights on, the log-likelihood,
estimates, N_eff, resampling, missing measurements, many runs at once) is here, written once.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pfedu.models import read_only, require, streams
from pfedu.resampling import scheme
from pfedu.track import Track, read_record
from pfedu.weights import (
    ZeroLikelihoodError,
    effective_number,
    effective_sample_size,
    moments,
    normalize,
    without_runaways,
)


@dataclass(frozen=True)
class Algorithm:
    """What one particle filter brings to the loop: a proposal with its weight, and what differs besides.

    A particle is a state, or a tuple of arrays that begins with one: whatever else it carries (a covariance, say)
    is then moved, copied and resampled with it. An array of the tuple whose axis of particles has length 1 is
    shared by all of them.

    Attributes
    ----------
    propose : callable
        ``(k, y, x, rng) -> (x, log_g)``: particles (..., N, n_x) of time k drawn from those of time k-1, and what
        their weights (..., N) are multiplied by.
    start : callable, optional
        ``(runs, n, rng) -> x``: n particles of the prior for each run; the model's ``sample_initial`` by default.
    first : callable, optional
        ``(y, x) -> (x, log_g)``: the correction at time 0; the model's likelihood by default.
    predict : callable, optional
        ``(k, x, rng) -> x``: a step without a measurement; the model's ``propagate`` by default.
    look_ahead : callable, optional
        ``(k, y, x, rng) -> (..., N)``: log of what the measurement of time k says of particles of time k-1. Weights
        are multiplied by it for the time of resampling, and divided by it afterwards. A filter that looks ahead may
        resample before a correction as well as after one: each step next to a measurement is one occasion.
    perturb : callable, optional
        ``(x, before, log_w, rng) -> x``: what happens to particles that were just resampled from ``before``, which
        had the normalised log weights ``log_w``.
    state : callable, optional
        ``(x) -> (..., N, n_x)``: the states among what particles carry; the first array of a tuple by default.
    moments : callable, optional
        ``(x, log_w) -> mean (..., n_x), cov (..., n_x, n_x)``; of the states by default.

    Examples
    --------
    >>> from pfedu.filters.loop import Algorithm
    >>> Algorithm(propose=lambda k, y, x, rng: (x, np.zeros(x.shape[:-1]))).look_ahead is None
    True
    """

    propose: Callable
    start: Callable | None = None
    first: Callable | None = None
    predict: Callable | None = None
    look_ahead: Callable | None = None
    perturb: Callable | None = None
    state: Callable | None = None
    moments: Callable | None = None

    def states(self, x):
        """States of the particles: (..., N, n_x)."""
        if self.state:
            return self.state(x)
        return x[0] if isinstance(x, tuple) else x

    def estimate(self, x, log_w, w):
        """Mean and covariance of what the particles say; ``w`` are the exponentials of ``log_w``."""
        return self.moments(x, log_w) if self.moments else moments(without_runaways(self.states(x), w), w)


def particle_filter(algorithm, model, y, n_particles, *, rng, resampling, policy, keep=False, n_runs=None):
    """Run a particle filter over a record.

    Parameters
    ----------
    algorithm : Algorithm or callable
        What the filter brings; its ``propose`` alone will do. Runs without a measurement are propagated by the
        model instead (where others have one, ``y`` is NaN in theirs).
    model : StateSpaceModel
    y : array_like, shape (..., T+1, n_y)
        Measurements; a row of NaN is missing: predicted over, not corrected, not resampled.
    n_particles : int
        N, at least 1.
    rng : numpy.random.Generator
        Two generators are spawned off it, one that moves particles and one that picks them: the
        noise that moves them does not depend on how or when they are resampled. A filter that looks
        ahead or perturbs draws for that from a third.
    resampling : str or callable
        A scheme of :mod:`pfedu.resampling`.
    policy : callable
        When to resample: :class:`~pfedu.resampling.ratio` or :class:`~pfedu.resampling.interval`. A filter that
        looks ahead asks it with the weights that look ahead (with the plain ones in a run where none is left), and
        counts occasions, with a measurement of this time or the next, in place of corrections.
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
        If no particle of a run can explain a measurement, or none that looks ahead where resampling is due; the
        message gives the step.

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
    algorithm = algorithm if isinstance(algorithm, Algorithm) else Algorithm(algorithm)
    y, missing, n_particles = _check(algorithm, model, y, n_particles, n_runs, policy)
    pick, runs = scheme(resampling), y.shape[:-2]
    rng_move, rng_pick = streams(rng, 2)
    rng_own = streams(rng, 1)[0] if algorithm.look_ahead or algorithm.perturb else None
    # glibc, having once seen so much go, keeps the pieces that each step lets go; it would return them to the system
    np.empty(30_000_000, dtype=np.uint8)
    x = (algorithm.start or _from_prior(model))(runs, n_particles, rng_move)
    log_w = np.full((*runs, n_particles), -np.log(n_particles))
    ancestors, steps = _themselves(log_w.shape), []
    count = np.zeros(runs, dtype=int)  # occasions to resample so far
    for k in range(y.shape[-2]):
        # Propose and weigh
        x, log_g = advance(algorithm, model, k, y[..., k, :], missing[..., k], x, log_w.shape, rng_move)
        weighed, increment = reweight(log_w, log_g, k)
        log_w = _where(missing[..., k], log_w, weighed)  # a missing measurement leaves them as they are, to the bit
        increment = np.where(missing[..., k], 0.0, increment)
        # Estimate, before resampling adds its noise
        w = np.exp(log_w)
        n_eff = effective_number(w)
        step = (*algorithm.estimate(x, log_w, w), increment, n_eff)
        kept = (algorithm.states(x), log_w, ancestors) if keep else (None, None, None)
        # Resample, by the weights and by what the next measurement says if the filter looks ahead
        news, ahead, blind = ~missing[..., k], None, False
        if algorithm.look_ahead and k + 1 < y.shape[-2]:
            news = news | ~missing[..., k + 1]
            ahead = foresee(algorithm, k + 1, y[..., k + 1, :], missing[..., k + 1], x, rng_own)
            ahead, blind, n_eff = _first_stage(log_w, ahead, k + 1)
        count = count + news
        due = _sighted(policy(n_eff, n_particles, count) & news, blind, k + 1)
        x, log_w, ancestors = _resampled(algorithm, x, log_w, due, pick, (rng_pick, rng_own), ahead, w)
        steps.append((*step, due, *kept))
    return _track(steps, len(runs))


def advance(algorithm, model, k, y, missing, x, shape, rng):
    """Particles of time k and the factors of their weights.

    Parameters
    ----------
    algorithm : Algorithm
    model : StateSpaceModel
    k : int
        Time; at 0 the particles stay where the prior put them.
    y : ndarray, shape (..., n_y)
    missing : ndarray of bool, shape (...)
    x : ndarray, shape (..., N, n_x), or tuple of such arrays
    shape : tuple of int
        (..., N).
    rng : numpy.random.Generator

    Returns
    -------
    x : as given
    log_g : ndarray, shape (..., N)
        Zero for a run whose measurement is missing.

    Raises
    ------
    ValueError
        If the model gives back the wrong shape.

    Examples
    --------
    >>> import pfedu
    >>> from pfedu.filters.loop import Algorithm, advance
    >>> model, y, missing = pfedu.models.random_walk(), np.array([1.0]), np.array(False)
    >>> rng = np.random.default_rng(1)
    >>> x, log_g = advance(Algorithm(None), model, 0, y, missing, np.zeros((4, 1)), (4,), rng)
    >>> x.shape, log_g.round(4).tolist()
    ((4, 1), [-1.4189, -1.4189, -1.4189, -1.4189])
    """
    x, y = _each(read_only, x), y[..., None, :]
    predict = algorithm.predict or model.propagate
    first = algorithm.first or (lambda y, x: (x, model.log_likelihood(0, y, x)))
    if missing.all():
        new, log_g = predict(k, x, rng) if k > 0 else x, np.zeros(shape)
    elif k == 0:
        new, log_g = first(y, x)
        new = _where(missing, x, new)
    else:
        new, log_g = algorithm.propose(k, y, x, rng)
        if missing.any():  # a run without a measurement has nothing to propose by
            new = _where(missing, predict(k, x, rng), new)
    if not isinstance(x, tuple) and np.shape(new) != x.shape:
        raise ValueError(f"step {k}: propagate must keep the shape {x.shape} of the particles, it gave {np.shape(new)}")
    new = new if isinstance(x, tuple) else np.asarray(new)
    if np.shape(log_g) != shape:
        raise ValueError(f"step {k}: log_likelihood must give one value a particle, shape {shape}, "
                         f"it gave {np.shape(log_g)}")  # fmt: skip
    return new, np.where(missing[..., None], 0.0, log_g) if missing.any() else log_g


def foresee(algorithm, k, y, missing, x, rng):
    """What the measurement of time k says of the particles of time k-1, as log factors.

    Parameters
    ----------
    algorithm : Algorithm
        With ``look_ahead``.
    k : int
    y : ndarray, shape (..., n_y)
    missing : ndarray of bool, shape (...)
    x : ndarray, shape (..., N, n_x), or tuple of such arrays
    rng : numpy.random.Generator

    Returns
    -------
    ndarray, shape (..., N)
        Zero for a run whose measurement is missing.

    Examples
    --------
    >>> from pfedu.filters.loop import Algorithm, foresee
    >>> near = Algorithm(None, look_ahead=lambda k, y, x, rng: -np.abs(y - x)[..., 0])
    >>> foresee(near, 1, np.array([1.0]), np.array(False), np.array([[0.0], [1.0]]), None).tolist()
    [-1.0, -0.0]
    """
    if missing.all():
        return np.zeros(algorithm.states(x).shape[:-1])
    ahead = algorithm.look_ahead(k, y[..., None, :], _each(read_only, x), rng)
    if np.shape(ahead) != algorithm.states(x).shape[:-1]:
        raise ValueError(f"step {k}: looking ahead must give one value a particle, shape "
                         f"{algorithm.states(x).shape[:-1]}, it gave {np.shape(ahead)}")  # fmt: skip
    return np.where(missing[..., None], 0.0, ahead)


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


def _first_stage(log_w, ahead, k):
    """The look ahead, the runs in which it leaves no particle, and N_eff; there it says nothing instead."""
    blind = np.isneginf(np.max(log_w + ahead, axis=-1))
    ahead = _where(blind, np.zeros(ahead.shape), ahead)
    return ahead, blind, effective_sample_size(reweight(log_w, ahead, k)[0])


def _sighted(due, blind, k):
    """Which runs are due, if all of them have something to resample by."""
    if np.any(due & blind):
        run = np.argwhere(due & blind)[0].tolist()
        raise ZeroLikelihoodError(
            f"step {k}{f', run {run}' if run else ''}: no particle's look-ahead point can explain the measurement of "
            f"step {k}, so that none can be resampled by it: look ahead to other points, or use the bootstrap filter"
        )
    return due


def resample(x, log_w, due, pick, rng, ahead=None, w=None):
    r"""Resample the runs that are due; the others keep particles and weights.

    .. math:: P(a = i) = \frac{w^{(i)} \eta^{(i)}}{\sum_j w^{(j)} \eta^{(j)}}, \qquad
        w' = \frac{1}{N} \frac{\sum_j w^{(j)} \eta^{(j)}}{\eta^{(a)}}

    Without a look ahead, :math:`\eta = 1`, that is the plain rule. With one, weights no longer sum to one, but their
    expectation does: what resampling preferred is taken back from the weight, and the log-likelihood increments of
    the next step, log of a sum of these weights times likelihoods, stay unbiased on the natural scale.

    Parameters
    ----------
    x : ndarray, shape (..., N, n_x), or tuple of such arrays
    log_w : ndarray, shape (..., N)
        Normalised log weights.
    due : ndarray of bool, shape (...)
    pick : callable
        A scheme of :mod:`pfedu.resampling`.
    rng : numpy.random.Generator
    ahead : ndarray, shape (..., N), optional
        Logarithms of :math:`\eta`.
    w : ndarray, shape (..., N), optional
        The exponentials of ``log_w``, where they are at hand.

    Returns
    -------
    x : as given
    log_w : ndarray, shape (..., N)
        1/N each in a run that was resampled without a look ahead.
    ancestors : ndarray of int, shape (..., N)

    Raises
    ------
    ValueError
        If the scheme does not give ancestors.
    ZeroLikelihoodError
        If looking ahead leaves no particle.

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
    if not due.any():
        return x, log_w, _themselves(log_w.shape)
    if ahead is not None:
        log_pick, total = normalize(log_w + ahead)
        w = np.exp(log_pick)
    picked = np.asarray(pick(np.exp(log_w) if w is None else w, rng))
    if picked.shape != log_w.shape or picked.dtype.kind not in "iu":
        raise ValueError(
            f"resampling must give whole numbers of shape {log_w.shape}, it gave {picked.dtype} {picked.shape}"
        )
    ancestors = picked if due.all() else _where(due, picked, _themselves(log_w.shape))
    new = np.broadcast_to(-np.log(n), log_w.shape)
    if ahead is not None:
        new = new + total[..., None] - np.take_along_axis(ahead, picked, axis=-1)
    return _each(lambda part: _select(part, ancestors), x), _where(due, new, log_w), ancestors


def _themselves(shape):
    """Ancestors of particles that were not resampled."""
    return np.broadcast_to(np.arange(shape[-1]), shape)


def _resampled(algorithm, x, log_w, due, pick, rngs, ahead, w):
    """Resample, then let the filter perturb the copies where there are any."""
    rng_pick, rng_own = rngs
    new, new_log_w, ancestors = resample(x, log_w, due, pick, rng_pick, ahead, w)
    if algorithm.perturb and due.any():
        new = _where(due, algorithm.perturb(new, x, log_w, rng_own), new)
    return new, new_log_w, ancestors


def _select(part, ancestors):
    """Copy what each ancestor carries; what all particles share stays shared."""
    axis, n = ancestors.ndim - 1, ancestors.shape[-1]
    if part.shape[axis] == 1 and n > 1:
        return part
    if axis > 0:  # runs end to end
        ancestors = ancestors + n * np.arange(ancestors[..., 0].size).reshape(*ancestors.shape[:-1], 1)
    return part.reshape(-1, *part.shape[axis + 1 :]).take(ancestors, axis=0)


def _each(function, x):
    """Apply a function to the array, or to each array of a tuple."""
    return tuple(function(part) for part in x) if isinstance(x, tuple) else function(x)


def _where(runs, x, otherwise):
    """Choose x in some runs and the other in the rest, for an array or each array of a tuple."""
    if runs.all() or not runs.any():
        return x if runs.all() else otherwise
    if isinstance(x, tuple):
        return tuple(_where(runs, a, b) for a, b in zip(x, otherwise, strict=True))
    return np.where(runs.reshape(*runs.shape, *(1,) * (np.ndim(x) - runs.ndim)), x, otherwise)


def _check(algorithm, model, y, n_particles, n_runs, policy):
    if not callable(policy):
        raise TypeError(
            f"policy must be ratio(share), interval(n), always or never of pfedu.resampling, got {policy!r}"
        )
    needs = {"sample_initial": algorithm.start, "propagate": algorithm.predict, "log_likelihood": algorithm.first}
    for piece in (name for name, instead in needs.items() if instead is None):
        require(model, piece, "a particle filter")
    for name, value in {"n_particles": n_particles, "n_runs": 1 if n_runs is None else n_runs}.items():
        if not (1 <= value < np.inf and value == int(value)):
            raise ValueError(f"{name} must be a whole number of at least 1, got {value}")
    y, missing = read_record(y, model.n_y)
    if n_runs is not None:
        y, missing = (np.broadcast_to(a, (int(n_runs), *a.shape)) for a in (y, missing))
    return y, missing, int(n_particles)


def _from_prior(model):
    def start(runs, n, rng):
        """Particles from p(x_0): (*runs, N, n_x)."""
        total = int(np.prod(runs)) * n
        x = np.asarray(model.sample_initial(total, rng), dtype=float)
        if x.shape != (total, model.n_x):
            raise ValueError(f"sample_initial({total}, rng) must give shape ({total}, {model.n_x}), it gave {x.shape}")
        return x.reshape(*runs, n, model.n_x)

    return start


def _track(steps, axis):
    """Stack the steps along the time axis, which follows the runs."""
    columns = [None if c[0] is None else np.stack(c, axis) for c in zip(*steps, strict=True)]
    mean, cov, increments, n_eff, resampled, particles, log_weights, ancestors = columns
    return Track(mean, cov, increments, n_eff, resampled, particles, log_weights, ancestors)
