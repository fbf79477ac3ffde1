"""The Kalman filter, exact where everything is linear and Gaussian, and the extended one, by tangents."""

import numpy as np

from pfedu.gaussian import log_density, solve
from pfedu.models import require
from pfedu.track import Track, read_record


def kalman_filter(model, y):
    r"""Exact posterior of a linear-Gaussian model.

    .. math::
        m^- &= F m, & P^- &= F P F^\top + Q \\
        S &= H P^- H^\top + R, & K &= P^- H^\top S^{-1} \\
        m &= m^- + K (y - H m^-), & P &= (I - K H) P^- (I - K H)^\top + K R K^\top

    Source: Simon, *Optimal State Estimation* (2006), section 5.1; the covariance in Joseph's form,
    which stays symmetric to rounding, and positive, where shorter forms drift.

    Parameters
    ----------
    model : LinearGaussian
    y : array_like, shape (..., T+1, n_y)
        Measurements, row k is time k; leading axes are independent records. A row of NaN is missing.

    Returns
    -------
    Track
        With mean, covariance and log-likelihood increments.

    Raises
    ------
    MissingPieceError
        If the model is not linear (has no F and H).
    ValueError
        If the record does not fit the model, or the covariance of an innovation is singular.

    Examples
    --------
    >>> import pfedu
    >>> track = pfedu.kalman_filter(pfedu.models.random_walk(q=0, r=1, p0=1), [[2.0]])
    >>> track.mean.tolist(), track.cov.tolist()
    ([[1.0]], [[[0.5]]])
    """
    for piece in ("F", "H"):
        require(model, piece, "the Kalman filter")
    return gaussian_filter(
        model, y,
        lambda k, m, P: predict(m, P, model.F, model.Q),
        lambda k, m, P, y: correct(m, P, y, model.H, model.R),
    )  # fmt: skip


def extended_kalman_filter(model, y):
    r"""Kalman filter of the model as it looks from the estimate: tangents for curves.

    .. math::
        m^- &= f(k, m), & P^- &= F P F^\top + G Q G^\top, & F &= \partial f / \partial x \text{ at } m \\
        e &= y - h(k, m^-), & S &= H P^- H^\top + R, & H &= \partial h / \partial x \text{ at } m^-

    and the correction of the Kalman filter; G is the derivative of the step by its noise, the identity where noise
    is added. Source: Simon, *Optimal State Estimation* (2006), section 13.2.

    Parameters
    ----------
    model : AdditiveGaussian
        Derivatives that it does not state are taken by differences.
    y : array_like, shape (..., T+1, n_y)
        Measurements, row k is time k; leading axes are independent records. A row of NaN is missing.

    Returns
    -------
    Track
        An approximation: nothing in it says how good.

    Raises
    ------
    MissingPieceError
        If the model has no functions f and h with Gaussian noise.
    ValueError
        If the record does not fit the model, or the covariance of an innovation is singular.

    Examples
    --------
    >>> import pfedu
    >>> model, y = pfedu.models.random_walk(), [[1.0], [2.0]]
    >>> bool((pfedu.extended_kalman_filter(model, y).mean == pfedu.kalman_filter(model, y).mean).all())
    True
    """
    require_gaussian(model, "the extended Kalman filter")
    return gaussian_filter(model, y, *linearised(model))


def require_gaussian(model, purpose):
    """Raise a clear error unless the model has functions f and h with Gaussian noise.

    Parameters
    ----------
    model : StateSpaceModel
    purpose : str
        What asks for it, for the message.

    Raises
    ------
    MissingPieceError
        Naming the piece.

    Examples
    --------
    >>> import pfedu
    >>> pfedu.kalman.require_gaussian(pfedu.models.growth(), "the extended Kalman filter")
    """
    for piece in ("f", "Q", "h", "R", "jacobian_f", "jacobian_h"):
        require(model, piece, purpose)


def gaussian_filter(model, y, predict, correct):
    """Run over a record with two updates of a Gaussian, whichever they are.

    Parameters
    ----------
    model : AdditiveGaussian
        Where m0, P0 and n_y are taken from.
    y : array_like, shape (..., T+1, n_y)
        A row of NaN is missing.
    predict : callable
        ``(k, m, P) -> (m, P)`` for m (..., n_x) and P (..., n_x, n_x).
    correct : callable
        ``(k, m, P, y) -> (m, P, log_likelihood)`` for y (..., n_y).

    Returns
    -------
    Track

    Examples
    --------
    >>> import pfedu
    >>> model = pfedu.models.random_walk()
    >>> pfedu.kalman.gaussian_filter(model, [1.0, 2.0], *pfedu.kalman.linearised(model)).mean.shape
    (2, 1)
    """
    y, missing = read_record(y, model.n_y)
    m = np.broadcast_to(model.m0, (*y.shape[:-2], model.n_x))
    P = np.broadcast_to(model.P0, (*m.shape, model.n_x))
    means, covs, increments = [], [], []
    for k in range(y.shape[-2]):
        if k > 0:
            m, P = predict(k, m, P)
        skip, increment = missing[..., k], np.zeros(missing.shape[:-1])
        if not skip.all():
            m_new, P_new, log_likelihood = correct(k, *_lent(skip, m, P, y[..., k, :]))
            m = np.where(skip[..., None], m, m_new)
            P = np.where(skip[..., None, None], P, P_new)
            increment = np.where(skip, 0.0, log_likelihood)
        means.append(m)
        covs.append(P)
        increments.append(increment)
    return Track(np.stack(means, -2), np.stack(covs, -3), np.stack(increments, -1))


def _lent(skip, *arrays):
    """Give runs that are skipped what another has: what they have may not allow a correction."""
    if not skip.any():
        return arrays
    other = tuple(np.argwhere(~skip)[0])
    return (np.where(skip.reshape(*skip.shape, *(1,) * (a.ndim - skip.ndim)), a[other], a) for a in arrays)


def linearised(model):
    """The two updates of the extended Kalman filter, for one Gaussian or many.

    Parameters
    ----------
    model : AdditiveGaussian

    Returns
    -------
    predict : callable
        ``(k, m, P) -> (m, P)`` for m (..., n_x) and P (..., n_x, n_x).
    correct : callable
        ``(k, m, P, y) -> (m, P, log_likelihood)`` for y (..., n_y).

    Examples
    --------
    >>> import pfedu
    >>> predict, correct = pfedu.kalman.linearised(pfedu.models.random_walk(q=1.0))
    >>> m, P = predict(1, np.zeros((5, 1)), np.ones((5, 1, 1)))  # five at once
    >>> P.ravel().tolist()
    [2.0, 2.0, 2.0, 2.0, 2.0]
    """

    def predict(k, m, P):
        F = model.jacobian_f(k, m)
        noise = model.Q
        if not model.noise_is_additive:
            G = model.jacobian_w(k, m)
            noise = G @ model.Q @ _T(G)
        return model.f(k, m), F @ P @ _T(F) + noise

    def correct(k, m, P, y):
        return update(m, P, y - model.h(k, m), model.jacobian_h(k, m), model.R)

    return predict, correct


def predict(m, P, F, Q):
    """Time update, :math:`m^- = F m` and :math:`P^- = F P F^T + Q`.

    Parameters
    ----------
    m : ndarray, shape (..., n_x)
    P : ndarray, shape (..., n_x, n_x)
    F, Q : ndarray, shape (n_x, n_x)

    Returns
    -------
    m, P : ndarray
        Mean and covariance a priori, shapes as given.

    Examples
    --------
    >>> from pfedu.kalman import predict
    >>> m, P = predict(np.array([1.0]), np.eye(1), np.eye(1), np.eye(1))
    >>> m.tolist(), P.tolist()
    ([1.0], [[2.0]])
    """
    return m @ F.T, F @ P @ F.T + Q


def correct(m, P, y, H, R):
    """Measurement update of a Gaussian, with the log-likelihood of the measurement.

    Parameters
    ----------
    m : ndarray, shape (..., n_x)
    P : ndarray, shape (..., n_x, n_x)
    y : ndarray, shape (..., n_y)
    H : ndarray, shape (n_y, n_x)
    R : ndarray, shape (n_y, n_y)

    Returns
    -------
    m, P : ndarray
        Mean and covariance a posteriori, shapes as given.
    log_likelihood : ndarray, shape (...)
        Log density of y under N(H m, H P H' + R).

    Raises
    ------
    ValueError
        If the covariance of the innovation is singular.

    Examples
    --------
    >>> from pfedu.kalman import correct
    >>> m, P, log_likelihood = correct(np.zeros(1), np.eye(1), np.ones(1), np.eye(1), np.eye(1))
    >>> m.tolist(), P.tolist(), round(float(log_likelihood), 4)
    ([0.5], [[0.5]], -1.5155)
    """
    return update(m, P, y - m @ H.T, H, R)


def update(m, P, innovation, H, R):
    r"""Correct a Gaussian by an innovation, however that was predicted.

    .. math:: S = H P H^\top + R, \quad K = P H^\top S^{-1}, \quad m \leftarrow m + K e, \quad
        P \leftarrow (I - K H) P (I - K H)^\top + K R K^\top

    Parameters
    ----------
    m : ndarray, shape (..., n_x)
    P : ndarray, shape (..., n_x, n_x)
    innovation : ndarray, shape (..., n_y)
        e, measurement minus its prediction.
    H : ndarray, shape (..., n_y, n_x)
    R : ndarray, shape (..., n_y, n_y)

    Returns
    -------
    m, P : ndarray
        Mean and covariance a posteriori.
    log_likelihood : ndarray, shape (...)
        Log density of e under N(0, S).

    Raises
    ------
    ValueError
        If S is singular.

    Examples
    --------
    >>> from pfedu.kalman import update
    >>> m, P, log_likelihood = update(np.zeros(1), np.eye(1), np.ones(1), np.eye(1), np.eye(1))
    >>> m.tolist(), P.tolist()
    ([0.5], [[0.5]])
    """
    S = H @ P @ _T(H) + R
    try:
        K = _T(solve(S, H @ P))  # P and S are symmetric
    except np.linalg.LinAlgError as error:
        raise ValueError(
            "S = H P H' + R is singular: a measurement without noise of something known for certain"
        ) from error
    A = np.eye(m.shape[-1]) - K @ H
    P_new = A @ P @ _T(A) + K @ R @ _T(K)
    return m + (K @ innovation[..., None])[..., 0], P_new, log_density(innovation, 0.0, S, "S = H P H' + R")


def _T(A):
    return np.swapaxes(A, -1, -2)
