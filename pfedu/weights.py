"""Importance weights, kept as logarithms.

A likelihood of a few hundred measurements is smaller than the smallest double; its logarithm is not.
Every filter of the book therefore carries ``log_w`` and comes back to ``w`` only to take an average.
"""

import numpy as np


class ZeroLikelihoodError(ArithmeticError):
    """Every particle has likelihood zero: the measurement cannot be weighed with these particles."""


def normalize(log_w):
    r"""Scale weights to sum to one, on the log scale.

    .. math:: \log \bar w^{(i)} = \log w^{(i)} - c, \qquad c = \log \sum_j \exp(\log w^{(j)})

    The largest log weight is taken out of the sum first (log-sum-exp), so nothing overflows and the
    heaviest particle never underflows.

    Parameters
    ----------
    log_w : array_like, shape (..., N)
        Unnormalised log weights; ``-inf`` is a weight of zero.

    Returns
    -------
    log_w : ndarray, shape (..., N)
        Log weights whose exponentials sum to one along the last axis.
    log_sum : ndarray, shape (...)
        The constant taken out, ``log(sum(w))``. In a filter it is the log-likelihood increment.

    Raises
    ------
    ValueError
        If a log weight is NaN or ``+inf``, or there are none.
    ZeroLikelihoodError
        If all weights of a run are zero.

    Examples
    --------
    >>> from pfedu.weights import normalize
    >>> log_w, log_sum = normalize([-1000.0, -1000.0])
    >>> np.exp(log_w).tolist(), round(float(log_sum), 4)
    ([0.5, 0.5], -999.3069)
    """
    log_w = np.asarray(log_w, dtype=float)
    if log_w.ndim == 0 or log_w.shape[-1] == 0:
        raise ValueError(f"log weights need shape (..., N) with N >= 1, got shape {log_w.shape}")
    peak = log_w.max(axis=-1, keepdims=True)  # (..., 1)
    if not (peak < np.inf).all():  # false for NaN too
        raise ValueError(_bad_log_weight(log_w))
    if (peak == -np.inf).any():
        raise ZeroLikelihoodError("all weights are zero (every log weight is -inf)")
    shifted = log_w - peak
    log_sum = np.log(np.exp(shifted).sum(axis=-1, keepdims=True))
    shifted -= log_sum
    return shifted, (peak + log_sum)[..., 0]


def _bad_log_weight(log_w):
    where = tuple(int(i) for i in np.argwhere(~(log_w < np.inf))[0])
    return f"log weight {log_w[where]} at index {where}: log weights are finite numbers, or -inf for a weight of zero"


def effective_sample_size(log_w):
    r"""Effective number of particles, :math:`N_\text{eff} = 1 / \sum_i (\bar w^{(i)})^2`.

    It is N when all weights are equal and 1 when a single particle carries everything
    (Kong, Liu and Wong 1994).

    Parameters
    ----------
    log_w : array_like, shape (..., N)
        Log weights; they need not be normalised.

    Returns
    -------
    ndarray, shape (...)
        Between 1 and N.

    Raises
    ------
    ValueError, ZeroLikelihoodError
        As :func:`normalize`.

    Examples
    --------
    >>> from pfedu.weights import effective_sample_size
    >>> float(effective_sample_size(np.log([0.5, 0.5, 1e-300])))
    2.0
    """
    return effective_number(np.exp(normalize(log_w)[0]))


def effective_number(w):
    r"""Effective number of particles of weights that are normalised and no logarithms, :math:`1 / \sum_i w_i^2`.

    For those who have the weights at hand; :func:`effective_sample_size` takes log weights and normalises them.

    Parameters
    ----------
    w : ndarray, shape (..., N)
        Normalised weights.

    Returns
    -------
    ndarray, shape (...)
        Between 1 and N.

    Examples
    --------
    >>> from pfedu.weights import effective_number
    >>> float(effective_number(np.array([0.5, 0.5])))
    2.0
    """
    return np.minimum(1.0 / np.einsum("...i,...i->...", w, w), w.shape[-1])  # not above N by rounding


def as_circular(circular, n_x):
    """Which states are angles, as an array.

    Parameters
    ----------
    circular : array_like of bool, shape (n_x,), or None
        None is none of them.
    n_x : int
        Number of states.

    Returns
    -------
    ndarray of bool, shape (n_x,)

    Raises
    ------
    ValueError
        If there is not one True or False for each state.

    Examples
    --------
    >>> from pfedu.weights import as_circular
    >>> as_circular(None, 2).tolist(), as_circular([False, True], 2).tolist()
    ([False, False], [False, True])
    """
    circular = np.zeros(n_x, dtype=bool) if circular is None else np.array(circular)
    if circular.dtype != bool or circular.shape != (n_x,):  # 0 and 1 might be flags or numbers of states
        raise ValueError(f"circular must be {n_x} times True or False, one for each state; got {circular.tolist()}")
    return circular


def wrap(angle, circular=True):
    r"""Angle of the same direction in :math:`[-\pi, \pi]`.

    .. math:: \theta - 2\pi \, \mathrm{round}\left(\frac{\theta}{2\pi}\right)

    An angle that lies there already keeps its bits.

    Parameters
    ----------
    angle : array_like, shape (..., n_x)
        In radians.
    circular : array_like of bool, shape () or (n_x,)
        Which components are angles; the others are left alone.

    Returns
    -------
    ndarray, of the same shape

    Examples
    --------
    >>> from pfedu.weights import wrap
    >>> wrap([0.5, 0.5 + 4 * np.pi, -3.5]).round(4).tolist()
    [0.5, 0.5, 2.7832]
    >>> wrap([7.0, 7.0], circular=[False, True]).round(4).tolist()
    [7.0, 0.7168]
    """
    angle = np.asarray(angle, dtype=float)
    turns = np.rint(np.where(circular, angle, 0.0) / (2.0 * np.pi))
    inside = np.clip(angle - 2.0 * np.pi * turns, -np.pi, np.pi)  # not beyond pi by rounding
    return np.where(circular, inside, angle)


def weighted_mean(x, log_w, circular=None):
    r"""Mean of weighted particles, :math:`m = \sum_i \bar w^{(i)} x^{(i)}`.

    An angle near the seam at :math:`\pm\pi` has no such mean: half of its particles at 3.1 and half at
    -3.1 would give 0, the opposite direction. A circular state is averaged as a direction instead
    (Mardia and Jupp, *Directional Statistics*, section 2.2),

    .. math:: m = \operatorname{atan2}\Bigl(\sum_i \bar w^{(i)} \sin x^{(i)}, \sum_i \bar w^{(i)} \cos x^{(i)}\Bigr)

    Where both sums vanish (two equal particles opposite each other) there is no mean direction, and
    rounding picks one.

    Parameters
    ----------
    x : array_like, shape (..., N, n_x)
        Particles, in the units of the state; circular states in radians.
    log_w : array_like, shape (..., N)
        Normalised log weights.
    circular : array_like of bool, shape (n_x,), optional
        Which states are angles; none by default.

    Returns
    -------
    ndarray, shape (..., n_x)
        A circular state lies in :math:`[-\pi, \pi]`.

    Raises
    ------
    ValueError
        If the shapes do not fit or the weights are not normalised.

    Examples
    --------
    >>> from pfedu.weights import weighted_mean
    >>> weighted_mean([[0.0], [10.0]], np.log([0.25, 0.75])).tolist()
    [7.5]
    >>> weighted_mean([[3.0], [-3.0]], np.log([0.5, 0.5]), circular=[True]).round(4).tolist()
    [3.1416]
    """
    x, w = _particles_and_weights(x, log_w)
    return _mean(x, w, as_circular(circular, x.shape[-1]))[..., 0, :]


def weighted_cov(x, log_w, circular=None):
    r"""Covariance of weighted particles, :math:`\sum_i \bar w^{(i)} (x^{(i)}-m)(x^{(i)}-m)^\top`.

    This is the covariance of the weighted point cloud itself (the "biased" one): the cloud *is* the
    posterior, not a sample from which another covariance is guessed. Differences of a circular state
    are wrapped to :math:`[-\pi, \pi]` and taken from its circular mean.

    Parameters
    ----------
    x : array_like, shape (..., N, n_x)
        Particles, in the units of the state; circular states in radians.
    log_w : array_like, shape (..., N)
        Normalised log weights.
    circular : array_like of bool, shape (n_x,), optional
        Which states are angles; none by default.

    Returns
    -------
    ndarray, shape (..., n_x, n_x)

    Raises
    ------
    ValueError
        If the shapes do not fit or the weights are not normalised.

    Examples
    --------
    >>> from pfedu.weights import weighted_cov
    >>> weighted_cov([[0.0], [10.0]], np.log([0.5, 0.5])).tolist()
    [[25.0]]
    >>> weighted_cov([[3.0], [-3.0]], np.log([0.5, 0.5]), circular=[True]).round(4).tolist()
    [[0.02]]
    """
    return weighted_moments(x, log_w, circular)[1]


def weighted_moments(x, log_w, circular=None):
    """Mean and covariance of weighted particles: :func:`weighted_mean` and :func:`weighted_cov` in one go.

    Parameters
    ----------
    x : array_like, shape (..., N, n_x)
        Particles, in the units of the state; circular states in radians.
    log_w : array_like, shape (..., N)
        Normalised log weights.
    circular : array_like of bool, shape (n_x,), optional
        Which states are angles; none by default.

    Returns
    -------
    mean : ndarray, shape (..., n_x)
    cov : ndarray, shape (..., n_x, n_x)

    Raises
    ------
    ValueError
        If the shapes do not fit or the weights are not normalised.

    Examples
    --------
    >>> from pfedu.weights import weighted_moments
    >>> mean, cov = weighted_moments([[0.0], [10.0]], np.log([0.5, 0.5]))
    >>> mean.tolist(), cov.tolist()
    ([5.0], [[25.0]])
    """
    return moments(*_particles_and_weights(x, log_w), circular)


def moments(x, w, circular=None):
    """Mean and covariance with weights that are normalised and no logarithms, for those who have them at hand.

    Parameters
    ----------
    x : ndarray, shape (..., N, n_x)
        Particles, finite; circular states in radians.
    w : ndarray, shape (..., N)
        Normalised weights.
    circular : array_like of bool, shape (n_x,), optional
        Which states are angles; none by default.

    Returns
    -------
    mean : ndarray, shape (..., n_x)
    cov : ndarray, shape (..., n_x, n_x)

    Examples
    --------
    >>> from pfedu.weights import moments
    >>> moments(np.array([[0.0], [10.0]]), np.array([0.5, 0.5]))[0].tolist()
    [5.0]
    """
    circular = as_circular(circular, x.shape[-1])
    mean = _mean(x, w, circular)
    d = x - mean  # (..., N, n_x)
    if circular.any():
        d = wrap(d, circular)
    if x.shape[-1] == 1:  # the same sum, in half the time
        return mean[..., 0, :], (w * d[..., 0])[..., None, :] @ d
    return mean[..., 0, :], np.swapaxes(d * w[..., None], -1, -2) @ d


def _mean(x, w, circular):
    """Mean with the axis of particles kept, against which they broadcast: (..., 1, n_x)."""
    mean = w[..., None, :] @ x
    if not circular.any():
        return mean
    return np.where(circular, np.arctan2(w[..., None, :] @ np.sin(x), w[..., None, :] @ np.cos(x)), mean)


def _particles_and_weights(x, log_w):
    x, log_w = np.asarray(x, dtype=float), np.asarray(log_w, dtype=float)
    if x.ndim < 2 or x.shape[:-1] != log_w.shape:
        raise ValueError(f"particles (..., N, n_x) and log weights (..., N) do not fit: {x.shape} and {log_w.shape}")
    w = np.exp(log_w)
    total = w.sum(axis=-1)
    if (np.abs(total - 1.0) > 1e-5).any():
        raise ValueError(f"weights must be normalised, their sum is {total.ravel()[np.abs(total - 1.0).argmax()]:.6g}: "
                         "use pfedu.weights.normalize first")  # fmt: skip
    return without_runaways(x, w), w


def without_runaways(x, w):
    """Particles among which those of weight zero may be anywhere: what ran away counts for nothing.

    Parameters
    ----------
    x : ndarray, shape (..., N, n_x)
    w : ndarray, shape (..., N)
        Weights.

    Returns
    -------
    ndarray, shape (..., N, n_x)
        The same, with zeros for particles of weight zero if any is not finite.

    Examples
    --------
    >>> from pfedu.weights import without_runaways
    >>> without_runaways(np.array([[1.0], [np.inf]]), np.array([1.0, 0.0])).tolist()
    [[1.0], [0.0]]
    """
    with np.errstate(over="ignore", invalid="ignore"):
        finite = np.isfinite(x.sum()) or np.isfinite(x).all()  # a sum shows it at once; only a huge one needs the look
    return x if finite else np.where(w[..., None] > 0, x, 0.0)
