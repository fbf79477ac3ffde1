"""Resampling: trade weights for copies, without bias.

Every scheme has one signature, ``scheme(weights, rng, size=None) -> ancestors``, and one promise:
particle i is expected ``size * w_i`` times among the ancestors, and never if ``w_i`` is zero.
They differ in how far the counts scatter about that expectation, because they differ in how they
place ``size`` points on the unit interval:

=========== ==================================================================
multinomial all points independent
residual    the whole copies ``floor(size * w_i)`` first, the rest multinomial
stratified  one point at random in each of ``size`` equal cells
systematic  one random offset, shared by all cells (a comb)
=========== ==================================================================
"""

from dataclasses import dataclass

import numpy as np


def multinomial(weights, rng, size=None):
    """Independent draws (Gordon, Salmond and Smith 1993).

    Parameters
    ----------
    weights : array_like, shape (..., N)
        Normalised weights (not logarithms).
    rng : numpy.random.Generator
    size : int, optional
        Number of ancestors; N by default.

    Returns
    -------
    ndarray of int, shape (..., size)
        Indices of the chosen particles, in ascending order.

    Raises
    ------
    ValueError
        If a weight is negative or not finite, or they do not sum to one.

    Examples
    --------
    >>> from pfedu.resampling import multinomial
    >>> multinomial([0.0, 1.0, 0.0], np.random.default_rng(1)).tolist()
    [1, 1, 1]
    """
    w, size = _check(weights, size)
    points = np.sort(rng.random((*w.shape[:-1], size)), axis=-1)
    return _particles_at(points, w)


def stratified(weights, rng, size=None):
    """One draw in each of ``size`` equal cells of the unit interval (Kitagawa 1996).

    Parameters, returns and errors are those of :func:`multinomial`.

    Examples
    --------
    >>> from pfedu.resampling import stratified
    >>> stratified([0.3, 0.7], np.random.default_rng(1)).tolist()
    [0, 1]
    """
    w, size = _check(weights, size)
    ends, last = _ends(w, size)  # counted in cells
    cell = np.minimum(ends.astype(np.intp), size - 1)
    below = cell + (np.take_along_axis(rng.random((*w.shape[:-1], size)), cell, axis=-1) < ends - cell)
    below[last] = size
    return _copied(below, size)


def systematic(weights, rng, size=None):
    """A comb of ``size`` evenly spaced points with one random offset (Carpenter et al. 1999).

    The offset is drawn once, before the search; drawing it again for each tooth would turn the
    comb into the stratified scheme. Parameters, returns and errors are those of :func:`multinomial`.

    Examples
    --------
    >>> from pfedu.resampling import systematic
    >>> systematic([0.3, 0.0, 0.7], np.random.default_rng(1)).tolist()
    [0, 2, 2]
    """
    w, size = _check(weights, size)
    ends, last = _ends(w, size)  # counted in teeth, which stand at u, 1 + u, 2 + u, ...
    ends -= rng.random((*w.shape[:-1], 1))
    below = np.ceil(ends, out=ends).astype(np.intp)
    below[last] = size
    return _copied(below, size)


def residual(weights, rng, size=None):
    """Whole copies first, the remainder multinomial (Liu and Chen 1998).

    Particle i gets ``floor(size * w_i)`` copies for certain; the places left over are drawn from
    the fractions ``size * w_i - floor(size * w_i)``, normalised. Parameters, returns and errors
    are those of :func:`multinomial`.

    Examples
    --------
    >>> from pfedu.resampling import residual
    >>> residual([0.4, 0.3, 0.3], np.random.default_rng(1), size=4).tolist()
    [0, 0, 1, 2]
    """
    w, size = _check(weights, size)
    w = w.astype(float)  # in single precision, N * (1/N) may fall short of one copy
    w /= w.sum(axis=-1, keepdims=True)
    copies = np.floor(size * w + 1e-9).astype(np.intp)  # (..., N), for certain; 3 * (1/3) is one copy
    left = size - copies.sum(axis=-1, keepdims=True)  # (..., 1), places still free
    fraction = np.maximum(size * w - copies, 0.0)
    total = fraction.sum(axis=-1, keepdims=True)
    fraction = np.where(left > 0, fraction / np.where(left > 0, total, 1.0), w)
    draws = _particles_at(rng.random((*w.shape[:-1], size)), fraction)
    draws = np.where(np.arange(size) < left, draws, w.shape[-1])  # only the free places count
    copies = copies + _count(draws, w.shape[-1] + 1)[..., :-1]
    return _repeat(copies, size)


def _check(weights, size):
    w = np.asarray(weights)
    if w.ndim == 0 or w.shape[-1] == 0:
        raise ValueError(f"weights need shape (..., N) with N >= 1, got shape {w.shape}")
    size = w.shape[-1] if size is None else size
    if not isinstance(size, int | np.integer) or size < 1:
        raise ValueError(f"size must be a whole number of at least 1, got {size}")
    total = w.sum(axis=-1, dtype=float)
    if not np.isfinite(total).all():
        raise ValueError(f"weights must be finite, got {_first(w, ~np.isfinite(w))}")
    if w.min() < 0:
        raise ValueError(f"weights must not be negative, got {_first(w, w < 0)}")
    if (np.abs(total - 1.0) > 1e-5).any():
        raise ValueError(
            f"weights must sum to 1, got {_first(total, np.abs(total - 1.0) > 1e-5)}; divide them by their sum"
        )
    return w, size


def _first(array, bad):
    return np.asarray(array)[bad].ravel()[0]


def _cumulative(w):
    """Where the stretch of the unit interval that belongs to each particle ends.

    Dividing by the last cumulative sum makes it exactly one, so no point falls off the end however
    the sum was rounded; a weight of zero is a stretch of length zero, which no point can fall into.
    """
    c = np.cumsum(w, axis=-1, dtype=float)  # (..., N)
    c /= c[..., -1:].copy()
    return c


def _ends(w, size):
    """Where each particle's stretch of the interval from 0 to ``size`` ends, and whether it is the end of all."""
    ends = np.cumsum(w, axis=-1, dtype=float)  # (..., N)
    last = ends >= ends[..., -1:]
    ends *= size / ends[..., -1:]
    return ends, last


def _copied(below, size):
    """Ancestors of ``size`` points in order, given how many of them lie below the end of each particle's stretch.

    Point j belongs to the particle before which exactly so many stretches end as end at or below j.
    """
    return np.cumsum(_count(below, size + 1)[..., :-1], axis=-1)


def _particles_at(points, w):
    """The particle whose stretch of the unit interval holds each point."""
    n, c = w.shape[-1], _cumulative(w)
    if w.ndim == 1:
        found = np.searchsorted(c, points, side="right")
    else:  # all runs in one search: run r lives on [r, r + 1)
        run = np.arange(c[..., 0].size).reshape(*c.shape[:-1], 1)
        found = np.searchsorted((c + run).ravel(), (points + run).ravel(), side="right")
        found = found.reshape(points.shape) - n * run
    last = n - 1 - np.argmax(w[..., ::-1] > 0, axis=-1)[..., None]  # a point rounded up to 1 is the last particle's
    return np.minimum(found, last)


def _count(indices, n):
    """How often each of 0..n-1 stands in the last axis: (..., size) -> (..., n)."""
    if indices.ndim == 1:
        return np.bincount(indices, minlength=n)
    run = np.arange(indices[..., 0].size).reshape(*indices.shape[:-1], 1)
    counts = np.bincount((indices + n * run).ravel(), minlength=n * run.size)
    return counts.reshape(*indices.shape[:-1], n)


def _repeat(copies, size):
    """Particle i, copies_i times: (..., N) -> (..., size)."""
    index = np.broadcast_to(np.arange(copies.shape[-1]), copies.shape)
    return np.repeat(index.ravel(), copies.ravel()).reshape(*copies.shape[:-1], size)


SCHEMES = {"multinomial": multinomial, "residual": residual, "stratified": stratified, "systematic": systematic}


def scheme(resampling):
    """The resampling scheme of that name; a function is passed through.

    Parameters
    ----------
    resampling : str or callable
        ``"multinomial"``, ``"residual"``, ``"stratified"``, ``"systematic"`` or a function
        ``(weights, rng, size=None) -> ancestors``.

    Returns
    -------
    callable

    Raises
    ------
    ValueError
        If there is no scheme of that name.

    Examples
    --------
    >>> from pfedu.resampling import scheme
    >>> scheme("systematic").__name__
    'systematic'
    """
    if callable(resampling):
        return resampling
    if resampling not in SCHEMES:
        raise ValueError(f"no resampling scheme {resampling!r}: choose one of {', '.join(sorted(SCHEMES))}")
    return SCHEMES[resampling]


@dataclass(frozen=True)
class ratio:
    """Resample when the effective number of particles falls strictly below a share of N.

    Parameters
    ----------
    threshold : float
        Share of N, from 0 (never) upwards; above 1 is always.

    Raises
    ------
    ValueError
        If the threshold is negative or NaN.

    Examples
    --------
    >>> from pfedu.resampling import ratio
    >>> ratio(0.5)(n_eff=np.array([40.0, 50.0]), n=100, count=1).tolist()
    [True, False]
    """

    threshold: float = 0.5

    def __post_init__(self):
        if not self.threshold >= 0:
            raise ValueError(f"the threshold is a share of N and must be at least 0, got {self.threshold}")

    def __call__(self, n_eff, n, count):
        """Whether to resample now: bool of the shape of ``n_eff``."""
        return n_eff < self.threshold * n * (1.0 - 1e-9)  # equal weights are not below N by rounding


@dataclass(frozen=True)
class interval:
    """Resample at every n-th correction, whatever the weights.

    Parameters
    ----------
    n : int or float
        1 is after every measurement, ``inf`` is never.

    Raises
    ------
    ValueError
        If n is not a whole number of at least 1 or ``inf``.

    Examples
    --------
    >>> from pfedu.resampling import interval
    >>> [bool(interval(2)(n_eff=1.0, n=100, count=k)) for k in (1, 2, 3, 4)]
    [False, True, False, True]
    """

    n: float = 1

    def __post_init__(self):
        if not (self.n >= 1 and (self.n == np.inf or self.n == int(self.n))):
            raise ValueError(f"the interval must be a whole number of corrections, at least 1, or inf; got {self.n}")

    def __call__(self, n_eff, n, count):
        """Whether to resample now: bool of the shape of ``n_eff``; ``count`` corrections have been made.

        Of a filter that looks ahead, ``count`` are the occasions, with a measurement of this time or the next.
        """
        due = (np.asarray(count) % self.n == 0) if self.n != np.inf else False
        return np.broadcast_to(due, np.shape(n_eff))


always = interval(1)
never = interval(np.inf)
