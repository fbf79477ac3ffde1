r"""Five checks that every particle filter must pass: an acceptance kit for code of one's own. The hall of bugs.

A check returns how far the worst of what it compared was off, in units of what it allows (1 is the limit), or raises
``AssertionError`` with a statement of what was expected and what was found. What is random is compared with an exact
answer, and allowed ``tolerance`` standard errors, taken from the scatter of the replicates themselves; nothing is
allowed for bias.

A *filter* is a function ``filter(model, y, n_particles, rng=rng)`` of one record, (T+1, n_y), whose row 0 is measured
too. It gives a track, or a pair: posterior means (T+1, n_x), taken from the weighted particles, and log-likelihood
increments (T+1,). Of the model it may use what :class:`~pfedu.models.StateSpaceModel` has. A *resampler* is a function
``resampler(weights, rng)`` of normalised weights (N,), which gives the indices of N ancestors. Filters and schemes of
pfedu are such functions.
"""

import numpy as np

from pfedu.kalman import extended_kalman_filter
from pfedu.models import AdditiveGaussian, require
from pfedu.weights import normalize, weighted_mean

_WEIGHTS = np.array([0.0, 0.31, 0.23, 0.125, 0.125, 0.11, 0.07, 0.03])
_TENTHS = np.full(10, 0.1)  # added up one by one they are the largest number below 1
_ENDS = (0.0, np.nextafter(1.0, 0.0))  # the least and the largest number that a generator can draw


def drifting(q=0.3, r=1.0):
    r"""The model that filters are checked with: linear, so that Kalman's answer is exact, and never twice the same.

    .. math::
        x_k = 0.9\, x_{k-1} + 2 \cos(1.2 k) + N(0, q), \qquad y_k = x_k + N(0, r), \qquad x_0 \sim N(1, 2)

    A filter that takes the step or the measurement of another time is off at once.

    Parameters
    ----------
    q, r : float
        Variances.

    Returns
    -------
    AdditiveGaussian

    Examples
    --------
    >>> from pfedu.checks import drifting
    >>> drifting().f(0, np.array([1.0])).tolist()
    [2.9]
    """
    return AdditiveGaussian(f=lambda k, x: 0.9 * x + 2.0 * np.cos(1.2 * k), h=1.0, Q=q, R=r, m0=1.0, P0=2.0,
                            jacobian_f=lambda k, x: np.full((*x.shape, 1), 0.9))  # fmt: skip


def check_resampler(resampler, *, rng, draws=2000, tolerance=5.0):
    r"""Copies are expected N times the weight, and never of a particle without weight.

    .. math:: \operatorname{E}[n^{(i)}] = N w^{(i)}

    For two orders of eight weights, one of them zero, the mean number of copies over the draws is compared with its
    expectation. Its standard error is at least that of the steadiest scheme there is, whose counts have the variance
    :math:`\rho (1 - \rho)` with :math:`\rho` the fraction of :math:`N w`. Then the generator is made to draw nothing
    but 0, and nothing but the largest number below 1, for weights whose sum is rounded to less than 1: no ancestor
    may be without weight, or beyond the last.

    Parameters
    ----------
    resampler : callable
        ``(weights, rng) -> ancestors``, N indices from 0 to N-1. Its random numbers come from ``rng``.
    rng : numpy.random.Generator
    draws : int
        Resamplings of each order.
    tolerance : float
        Standard errors that are allowed; with 16 comparisons chance alone exceeds five once in 100 000 checks.

    Returns
    -------
    float
        Largest distance as a share of what is allowed.

    Raises
    ------
    AssertionError
        If a count is off, an ancestor impossible, or the search runs off the end.

    Examples
    --------
    >>> from pfedu.checks import check_resampler
    >>> from pfedu.resampling import systematic
    >>> bool(check_resampler(systematic, rng=np.random.default_rng(1)) < 1)
    True
    >>> check_resampler(lambda w, rng: np.arange(len(w)), rng=np.random.default_rng(1))
    Traceback (most recent call last):
    AssertionError: particle 0 has weight 0 and was copied
    """
    off = 0.0
    for w in (_WEIGHTS, _WEIGHTS[::-1]):
        counts = np.array([np.bincount(_ancestors(resampler, w, rng), minlength=w.size) for _ in range(draws)])
        owed, mean = w.size * w, counts.mean(axis=0)
        least = np.sqrt(owed % 1 * (1 - owed % 1))
        se = np.maximum(np.maximum(counts.std(axis=0, ddof=1), least) / np.sqrt(draws), 1e-9)
        distance = np.abs(mean - owed) / se
        i = distance.argmax()
        off = max(off, _allow(distance[i], tolerance, f"the mean number of copies of the particle with weight {w[i]:g} "
                              f"over {draws} draws is {mean[i]:.3f} instead of {owed[i]:g}"))  # fmt: skip
    for value in _ENDS:
        for w in (_TENTHS, np.append(0.0, _TENTHS), np.append(_TENTHS, 0.0)):
            _ancestors(resampler, w, _constant(value))
    return off


def check_model(model, *, rng, draws=20_000, tolerance=5.0):
    r"""The likelihood is the density of the measurements that the model makes, and likewise for the transition.

    Two states are drawn, a coin says which of them is measured, and the likelihood is asked which it was. If it is
    the density of ``measure``, its answer :math:`\pi = p(y \mid x) / (p(y \mid x) + p(y \mid x'))` is calibrated:

    .. math:: \operatorname{E}[(b - \pi)(2 \pi - 1)] = 0, \qquad b = 1 \text{ if it was } x, \text{ else } 0.

    It is negative for a density that is too narrow and therefore too sure, positive for one that is too wide. The
    same is done with ``propagate`` and ``log_transition`` where the model states that density. One time, k = 1, is
    looked at, and states of the prior.

    Parameters
    ----------
    model : StateSpaceModel
        With ``sample_initial``, ``measure`` and ``log_likelihood``.
    rng : numpy.random.Generator
    draws : int
        Coins thrown.
    tolerance : float
        Standard errors that are allowed.

    Returns
    -------
    float
        Largest distance as a share of what is allowed.

    Raises
    ------
    AssertionError
        If a density is not that of the draws.
    MissingPieceError
        If the model has no ``measure``.

    Examples
    --------
    A standard deviation of 3 in the draws, and 3 taken for the variance in the density:

    >>> from pfedu.checks import check_model
    >>> from pfedu.gaussian import log_density
    >>> from pfedu.models import random_walk
    >>> model = random_walk(r=9.0)
    >>> bool(check_model(model, rng=np.random.default_rng(1)) < 1)
    True
    >>> model.log_likelihood = lambda k, y, x: log_density(y, x, 3.0)
    >>> check_model(model, rng=np.random.default_rng(1))  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    AssertionError: log_likelihood is too sure: it is narrower than what measure draws...
    """
    require(model, "measure", "checking a model")
    x, other = (np.asarray(model.sample_initial(draws, rng)) for _ in range(2))
    coin = rng.integers(2, size=draws).astype(bool)
    chosen = np.where(coin[:, None], x, other)
    pairs = {("log_likelihood", "measure"): lambda x: model.log_likelihood(1, y, x)}
    y = np.asarray(model.measure(1, chosen, rng))
    if getattr(model, "log_transition", None):
        moved = np.asarray(model.propagate(1, chosen, rng))
        pairs["log_transition", "propagate"] = lambda x: model.log_transition(1, moved, x)
    off = 0.0
    for (density, draw), log_p in pairs.items():
        sure = np.tanh((log_p(x) - log_p(other)) / 2)  # 2 pi - 1
        mean, se = _mean_and_se((coin - (1 + sure) / 2) * sure)
        how = "too sure: it is narrower" if mean < 0 else "not sure enough: it is wider"
        off = max(off, _allow(abs(mean) / se, tolerance, f"{density} is {how} than what {draw} draws. A standard "
                              "deviation where a variance belongs, or the other way round?"))  # fmt: skip
    return off


def check_correction(filter, *, rng, n_particles=40):
    r"""One correction of known particles is arithmetic: the same numbers, to rounding.

    The prior gives fixed particles, and there is one measurement, near them or 60 standard deviations away. Then

    .. math:: m_0 = \frac{\sum_i g^{(i)} x^{(i)}}{\sum_i g^{(i)}}, \qquad
        \log p(y_0) \approx \log \frac{1}{N} \sum_i g^{(i)}

    hold exactly if the estimate is taken before resampling, and from logarithms. Rounding is allowed 1e-9 of the
    value, or of 1 where it is smaller.

    Parameters
    ----------
    filter : callable
        ``(model, y, n_particles, rng=rng)``, see the top of the module.
    rng : numpy.random.Generator
    n_particles : int

    Returns
    -------
    float
        Largest distance as a share of what is allowed.

    Raises
    ------
    AssertionError
        If mean or log-likelihood is another, or not finite.

    Examples
    --------
    >>> import pfedu
    >>> from pfedu.checks import check_correction
    >>> bool(check_correction(pfedu.bootstrap_filter, rng=np.random.default_rng(1)) < 1)
    True
    """
    x, off = np.linspace(-3.0, 5.0, n_particles)[:, None], 0.0
    model = drifting(r=0.25)
    model.sample_initial = lambda n, rng: x[np.arange(n) % n_particles].copy()
    for where, value in (("near the particles", 3.0), ("60 standard deviations away", 35.0)):
        y = np.array([[value]])
        log_w, log_sum = normalize(model.log_likelihood(0, y, x) - np.log(n_particles))
        with np.errstate(all="ignore"):  # a filter that divides zero by zero is told so below
            mean, increments = _run(filter, model, y, n_particles, rng)
        exact = {"mean": weighted_mean(x, log_w)[0], "log-likelihood": log_sum}
        for (name, wanted), got in zip(exact.items(), (mean[0, 0], increments[0]), strict=True):
            distance = abs(got - wanted) / max(1.0, abs(wanted)) / 1e-9
            if not distance <= 1:  # true for NaN too
                raise AssertionError(f"one measurement {where}: the {name} is {got:.6g} instead of {wanted:.6g}")
            off = max(off, distance)
    return float(off)


def check_unbiased(filter, *, rng, model=None, n_particles=200, n_runs=300, n_steps=10, tolerance=5.0):
    r"""The likelihood, and the mean weighted by it, are unbiased for every number of particles.

    .. math::
        \operatorname{E}\left[\frac{\widehat Z_k}{Z_k}\right] = 1, \qquad
        \operatorname{E}\left[\frac{\widehat Z_k}{Z_k} (\widehat m_k - m_k)\right] = 0

    with :math:`Z_k = p(Y_k)` and :math:`m_k` of the Kalman filter, at each step of one record drawn from the model.
    (Over many records a bias that has the sign of the innovation would average out.) Source: Del Moral (2004), theorem
    7.4.2. A filter that is biased by design, like one that spreads copies by a kernel, is told so.

    Parameters
    ----------
    filter : callable
        ``(model, y, n_particles, rng=rng)``, see the top of the module.
    rng : numpy.random.Generator
    model : AdditiveGaussian, optional
        Linear, so that the extended Kalman filter is exact; :func:`drifting` by default.
    n_particles, n_runs, n_steps : int
        Particles; independent runs; time T of the last measurement.
    tolerance : float
        Standard errors that are allowed; with 22 comparisons chance alone exceeds five once in 50 000 checks (as for
        Gaussian scatter; few particles scatter more wildly, so do not take fewer than 100).

    Returns
    -------
    float
        Largest distance as a share of what is allowed.

    Raises
    ------
    AssertionError
        If likelihood or mean is biased; the message gives the first such step.

    Examples
    --------
    >>> import pfedu
    >>> from pfedu.checks import check_unbiased
    >>> bool(check_unbiased(pfedu.bootstrap_filter, rng=np.random.default_rng(1)) < 1)
    True
    """
    model = model or drifting()
    y = np.broadcast_to(model.simulate(n_steps, rng)[1], (n_runs, n_steps + 1, model.n_y))
    d, log_ratio = _errors(filter, model, y, n_particles, rng)
    with np.errstate(all="ignore"):
        ratio = np.exp(np.cumsum(log_ratio, axis=-1))
    weighted, off = ratio * d.sum(axis=-1), 0.0
    for k in range(n_steps + 1):
        mean, se = _mean_and_se(ratio[:, k] - 1)
        off = max(off, _allow(abs(mean) / se, tolerance, f"step {k}: over {n_runs} runs the likelihood is "
                              f"{1 + mean:.3f} ± {se:.2g} times the exact one"))  # fmt: skip
        mean, se = _mean_and_se(weighted[:, k])
        off = max(off, _allow(abs(mean) / se, tolerance, f"step {k}: over {n_runs} runs the mean, weighted by the "
                              f"likelihood, differs from the exact one by {mean:.3f} ± {se:.2g}"))  # fmt: skip
    return off


def check_convergence(filter, *, rng, model=None, n_particles=50, n_runs=60, n_steps=10, tolerance=5.0):
    r"""Sixteen times the particles, a sixteenth of the mean square error.

    .. math:: \operatorname{E}\,|\widehat m_k - m_k|^2 \sim N^{-a}, \qquad a = 1

    with :math:`m_k` of the Kalman filter. The exponent a is measured between N and 16 N, and must not lie below 1 by
    more than the tolerance. It needs the means only; the increments may be NaN. Faults that add noise and no bias
    pass it.

    Parameters
    ----------
    filter : callable
        ``(model, y, n_particles, rng=rng)``, see the top of the module.
    rng : numpy.random.Generator
    model : AdditiveGaussian, optional
        Linear, so that the extended Kalman filter is exact; :func:`drifting` by default.
    n_particles, n_runs, n_steps : int
        The smaller N; records, with one run for each N; time T of the last measurement.
    tolerance : float
        Standard errors of the exponent that are allowed.

    Returns
    -------
    float
        Distance below 1 as a share of what is allowed; 0 if it is not below.

    Raises
    ------
    AssertionError
        If the error falls more slowly, or is not finite.

    Examples
    --------
    >>> import pfedu
    >>> from pfedu.checks import check_convergence
    >>> bool(check_convergence(pfedu.bootstrap_filter, rng=np.random.default_rng(1)) < 1)
    True
    """
    model, squares = model or drifting(), []
    y = model.simulate(n_steps, rng, n_runs)[1]
    for n in (n_particles, 16 * n_particles):
        d, _ = _errors(filter, model, y, n, rng)
        squares.append(_mean_and_se((d**2).sum(axis=-1).mean(axis=-1)))
    (few, se_few), (many, se_many) = squares
    a = np.log(few / many) / np.log(16)
    se = np.hypot(se_few / few, se_many / many) / np.log(16)
    return _allow(max(0.0, (1 - a) / se) if a == a else np.nan, tolerance,
                  f"the mean square error is {few:.2g} with {n_particles} particles and {many:.2g} with "
                  f"{16 * n_particles}: it falls as N^-{a:.2f} instead of N^-1")  # fmt: skip


def _constant(value):
    """A generator that always draws the same number between 0 and 1."""

    class Constant(np.random.Generator):  # made here, so that importing the package does not load numpy.random
        def random(self, size=None, dtype=np.float64, out=None):
            return value if size is None else np.full(size, value, dtype)

        def uniform(self, low=0.0, high=1.0, size=None):
            return low + (high - low) * self.random(size)

    return Constant(np.random.PCG64(1))


def _ancestors(resampler, w, rng):
    """Ancestors of one resampling, each of them possible."""
    try:
        a = np.asarray(resampler(w, rng))
    except IndexError as error:
        raise AssertionError(f"the search runs off the end of {w.size} weights ({error})") from error
    if a.shape != w.shape or a.dtype.kind not in "iu":
        raise AssertionError(f"resampling must give {w.size} whole numbers, it gave {a.dtype} of shape {a.shape}")
    if a.min() < 0 or a.max() >= w.size:
        raise AssertionError(f"ancestor {a.min() if a.min() < 0 else a.max()} is none of {w.size} particles; "
                             "the search ran off the end")  # fmt: skip
    if (w[a] == 0).any():
        raise AssertionError(f"particle {a[w[a] == 0][0]} has weight 0 and was copied")
    return a


def _run(filter, model, y, n_particles, rng):
    """Means (T+1, n_x) and log-likelihood increments (T+1,) of one run."""
    track = filter(model, y, n_particles, rng=rng)
    mean, increments = track if isinstance(track, tuple) else (track.mean, track.log_likelihood_increments)
    mean, increments = np.asarray(mean, dtype=float), np.asarray(increments, dtype=float)
    mean = mean[:, None] if mean.ndim == 1 and model.n_x == 1 else mean
    if mean.shape != (len(y), model.n_x) or increments.shape != (len(y),):
        raise ValueError(f"a filter must give means ({len(y)}, {model.n_x}) and log-likelihood increments ({len(y)},) "
                         f"for this record, it gave {mean.shape} and {increments.shape}")  # fmt: skip
    return mean, increments


def _errors(filter, model, y, n_particles, rng):
    """Distance from the exact means, (runs, T+1, n_x), and from the exact increments, (runs, T+1)."""
    exact = extended_kalman_filter(model, y)
    with np.errstate(all="ignore"):  # one at a time: a filter of one's own need not know of leading axes
        mean, increments = zip(*(_run(filter, model, record, n_particles, rng) for record in y), strict=True)
    return np.array(mean) - exact.mean, np.array(increments) - exact.log_likelihood_increments


def _mean_and_se(values):
    """Mean and standard error, which rounding alone does not make smaller than 1e-10."""
    return values.mean(), max(values.std(ddof=1) / np.sqrt(len(values)), 1e-10)


def _allow(distance, tolerance, statement):
    """Share of the tolerance that a distance uses up, both in standard errors; more than all of it is an error."""
    if not distance <= tolerance:  # true for NaN too
        raise AssertionError(f"{statement}: {distance:.1f} standard errors off, {tolerance:g} are allowed")
    return float(distance / tolerance)
