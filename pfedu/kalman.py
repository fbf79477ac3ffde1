"""The Kalman filter: the Bayesian recursion where everything is linear and Gaussian."""

import numpy as np

from pfedu.gaussian import log_density
from pfedu.models import require
from pfedu.track import Track, read_record


def kalman_filter(model, y):
    r"""Exact posterior of a linear-Gaussian model.

    .. math::
        m^- &= F m, & P^- &= F P F^\top + Q \\
        S &= H P^- H^\top + R, & K &= P^- H^\top S^{-1} \\
        m &= m^- + K (y - H m^-), & P &= (I - K H) P^- (I - K H)^\top + K R K^\top

    Source: Simon, *Optimal State Estimation* (2006), section 5.1; the covariance in Joseph's form,
    which rounding leaves symmetric and positive where shorter forms drift.

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
        If the model is not linear (has no F).
    ValueError
        If the record does not fit the model, or the covariance of an innovation is singular.

    Examples
    --------
    >>> import pfedu
    >>> track = pfedu.kalman_filter(pfedu.models.random_walk(q=0, r=1, p0=1), [[2.0]])
    >>> track.mean.tolist(), track.cov.tolist()
    ([[1.0]], [[[0.5]]])
    """
    require(model, "F", "the Kalman filter")
    y, missing = read_record(y, model.n_y)
    m = np.broadcast_to(model.m0, (*y.shape[:-2], model.n_x))
    P = np.broadcast_to(model.P0, (*m.shape, model.n_x))
    means, covs, increments = [], [], []
    for k in range(y.shape[-2]):
        if k > 0:
            m, P = predict(m, P, model.F, model.Q)
        skip, increment = missing[..., k], np.zeros(missing.shape[:-1])
        if not skip.all():
            m_new, P_new, log_likelihood = correct(m, P, y[..., k, :], model.H, model.R)  # NaN where skipped
            m = np.where(skip[..., None], m, m_new)
            P = np.where(skip[..., None, None], P, P_new)
            increment = np.where(skip, 0.0, log_likelihood)
        means.append(m)
        covs.append(P)
        increments.append(increment)
    return Track(np.stack(means, -2), np.stack(covs, -3), np.stack(increments, -1))


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
    S = H @ P @ H.T + R
    try:
        K = np.swapaxes(np.linalg.solve(S, H @ P), -1, -2)  # P and S are symmetric
    except np.linalg.LinAlgError as error:
        raise ValueError(
            "S = H P H' + R is singular: a measurement without noise of something known for certain"
        ) from error
    A = np.eye(m.shape[-1]) - K @ H
    innovation = y - m @ H.T
    m_new = m + (K @ innovation[..., None])[..., 0]
    P_new = A @ P @ np.swapaxes(A, -1, -2) + K @ R @ np.swapaxes(K, -1, -2)
    return m_new, P_new, log_density(innovation, 0.0, S)
