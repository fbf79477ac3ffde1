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
    return shifted - log_sum, (peak + log_sum)[..., 0]


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
    w = np.exp(normalize(log_w)[0])
    return np.minimum(1.0 / np.sum(w * w, axis=-1), w.shape[-1])  # not above N by rounding


def weighted_mean(x, log_w):
    r"""Mean of weighted particles, :math:`\sum_i \bar w^{(i)} x^{(i)}`.

    Parameters
    ----------
    x : array_like, shape (..., N, n_x)
        Particles, in the units of the state.
    log_w : array_like, shape (..., N)
        Normalised log weights.

    Returns
    -------
    ndarray, shape (..., n_x)

    Raises
    ------
    ValueError
        If the shapes do not fit.

    Examples
    --------
    >>> from pfedu.weights import weighted_mean
    >>> weighted_mean([[0.0], [10.0]], np.log([0.25, 0.75])).tolist()
    [7.5]
    """
    x, w = _particles_and_weights(x, log_w)
    return (w[..., None, :] @ x)[..., 0, :]


def weighted_cov(x, log_w):
    r"""Covariance of weighted particles, :math:`\sum_i \bar w^{(i)} (x^{(i)}-m)(x^{(i)}-m)^\top`.

    This is the covariance of the weighted point cloud itself (the "biased" one): the cloud *is* the
    posterior, not a sample from which another covariance is guessed.

    Parameters
    ----------
    x : array_like, shape (..., N, n_x)
        Particles, in the units of the state.
    log_w : array_like, shape (..., N)
        Normalised log weights.

    Returns
    -------
    ndarray, shape (..., n_x, n_x)

    Raises
    ------
    ValueError
        If the shapes do not fit.

    Examples
    --------
    >>> from pfedu.weights import weighted_cov
    >>> weighted_cov([[0.0], [10.0]], np.log([0.5, 0.5])).tolist()
    [[25.0]]
    """
    x, w = _particles_and_weights(x, log_w)
    d = x - w[..., None, :] @ x  # (..., N, n_x)
    return np.swapaxes(d * w[..., None], -1, -2) @ d


def _particles_and_weights(x, log_w):
    x, log_w = np.asarray(x, dtype=float), np.asarray(log_w, dtype=float)
    if x.ndim < 2 or x.shape[:-1] != log_w.shape:
        raise ValueError(f"particles (..., N, n_x) and log weights (..., N) do not fit: {x.shape} and {log_w.shape}")
    w = np.exp(log_w)
    if not np.isfinite(x).all():  # a state that ran away and was given weight zero counts for nothing
        x = np.where(w[..., None] > 0, x, 0.0)
    return x, w
