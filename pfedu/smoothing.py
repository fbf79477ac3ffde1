r"""Smoothing: the state of each time, given the whole record. Chapter 14.

A filter estimates :math:`x_k` from what was measured up to time k. A smoother waits for the end of the record and
estimates it from all of :math:`Y_T`. Two smoothers are exact: :func:`rts_smoother` for linear models with Gaussian
noise, and :func:`grid_smoother` for one or two states. Two work on what a particle filter has kept:
:func:`genealogy_smoother` follows each last particle back to its ancestors, :func:`backward_smoother` draws paths
through all particles anew.
"""

import numpy as np

from pfedu.gaussian import solve
from pfedu.grid import grid_filter, trapezoid_weights
from pfedu.kalman import kalman_filter, predict
from pfedu.models import require, streams
from pfedu.resampling import multinomial
from pfedu.track import Track
from pfedu.weights import ZeroLikelihoodError, moments, normalize

_AT_ONCE = 2**22  # numbers in an array of pairs of nodes or particles, 32 MB


def rts_smoother(model, y):
    r"""Exact posterior of each time given the whole record, for a linear-Gaussian model.

    .. math::
        G_k &= P_k F^\top (P_{k+1}^-)^{-1} \\
        m_{k|T} &= m_k + G_k (m_{k+1|T} - m_{k+1}^-) \\
        P_{k|T} &= (I - G_k F) P_k (I - G_k F)^\top + G_k (Q + P_{k+1|T}) G_k^\top

    Source: Rauch, Tung and Striebel, *Maximum likelihood estimates of linear dynamic systems* (1965); the
    covariance as a sum of squares, which stays symmetric and positive where a difference may not.

    Parameters
    ----------
    model : LinearGaussian
    y : array_like, shape (..., T+1, n_y)
        Measurements, row k is time k; leading axes are independent records. A row of NaN is missing.

    Returns
    -------
    Track
        Mean and covariance of each state given all measurements; the increments are those of the filter.

    Raises
    ------
    MissingPieceError
        If the model is not linear (has no F and H).
    ValueError
        If the record does not fit the model, or the covariance of a prediction is singular.

    Examples
    --------
    >>> import pfedu
    >>> track = pfedu.rts_smoother(pfedu.models.random_walk(q=1, r=1, p0=1), [[np.nan], [3.0]])
    >>> track.mean.round(12).tolist(), track.cov.ravel().round(4).tolist()
    ([[1.0], [2.0]], [0.6667, 0.6667])
    """
    track = kalman_filter(model, y)
    m, P = track.mean[..., -1, :], track.cov[..., -1, :, :]
    means, covs = [m], [P]
    for k in range(track.mean.shape[-2] - 2, -1, -1):
        m_k, P_k = track.mean[..., k, :], track.cov[..., k, :, :]
        m_next, P_next = predict(m_k, P_k, model.F, model.Q)
        try:
            G = np.swapaxes(solve(P_next, model.F @ P_k), -1, -2)
        except np.linalg.LinAlgError as error:
            raise ValueError(
                f"the covariance of the prediction of step {k + 1} is singular: some state is known for certain; give "
                "P0 or Q a small variance there, or leave that state out of the model"
            ) from error
        A = np.eye(model.n_x) - G @ model.F
        m = m_k + (G @ (m - m_next)[..., None])[..., 0]
        P = A @ P_k @ np.swapaxes(A, -1, -2) + G @ (model.Q + P) @ np.swapaxes(G, -1, -2)
        means.append(m)
        covs.append(P)
    return Track(np.stack(means[::-1], -2), np.stack(covs[::-1], -3), track.log_likelihood_increments)


def grid_smoother(model, y, grid, *, tolerance=1e-3):
    r"""Exact posterior of each time given the whole record, by sums over the nodes of a grid.

    .. math::
        p(x_k \mid Y_T) = p(x_k \mid Y_k) \int p(x_{k+1} \mid x_k)
        \frac{p(x_{k+1} \mid Y_T)}{p(x_{k+1} \mid Y_k)}\, dx_{k+1}

    Source: Kitagawa, *Non-Gaussian state-space modeling of nonstationary time series* (1987).

    Parameters
    ----------
    model : StateSpaceModel
        With n_x = 1 or 2, ``log_initial`` and ``log_transition``.
    y : array_like, shape (..., T+1, n_y)
        Measurements, row k is time k; leading axes are independent records. A row of NaN is missing.
    grid : array_like, shape (G,), or a pair of them, shapes (G_1,) and (G_2,)
        Nodes, as for :func:`~pfedu.grid_filter`.
    tolerance : float
        How much probability a prediction may lose or gain on the grid before it is an error.

    Returns
    -------
    Track
        Mean, covariance and ``density`` given all measurements; the increments are those of the filter.

    Raises
    ------
    MissingPieceError, GridError, ValueError
        As :func:`~pfedu.grid_filter`.

    Examples
    --------
    >>> import pfedu
    >>> model, y = pfedu.models.random_walk(q=1, r=1, p0=1), [[np.nan], [3.0]]
    >>> pfedu.grid_smoother(model, y, np.linspace(-15, 15, 151)).mean.round(6).tolist()
    [[1.0], [2.0]]
    """
    track = grid_filter(model, y, grid, tolerance=tolerance)
    axes = (track.grid,) if model.n_x == 1 else track.grid
    x = np.stack([table.ravel() for table in np.meshgrid(*axes, indexing="ij")], axis=-1)  # (G, n_x)
    dx = np.ones(1)
    for nodes in axes:
        dx = np.multiply.outer(dx, trapezoid_weights(nodes)).ravel()  # (G,)
    runs = track.mean.shape[:-2]
    filtered = np.moveaxis(track.density.reshape(*runs, -1, len(x)), -2, 0)  # (T+1, ..., G)
    densities = [filtered[-1]]
    for k in range(len(filtered) - 2, -1, -1):
        p = filtered[k] * _looking_back(model, k + 1, x, dx, filtered[k], densities[-1])
        densities.append(p / (p @ dx)[..., None])
    density = np.stack(densities[::-1], -2)
    mean, cov = moments(np.broadcast_to(x, (*density.shape, model.n_x)), density * dx)
    density = density.reshape(track.density.shape)
    return Track(mean, cov, track.log_likelihood_increments, grid=track.grid, density=density)


def _looking_back(model, k, x, dx, filtered, smoothed):
    """What the record from time k on says of each node of time k-1, as a factor: (..., G).

    A node that the prediction leaves without probability has none in the end either, and says nothing.
    """
    factor = np.zeros(filtered.shape)
    rows = max(1, _AT_ONCE // (len(x) * x.shape[-1]))
    for new in (slice(start, start + rows) for start in range(0, len(x), rows)):
        moves = np.exp(model.log_transition(k, x[new, None], x[None, :]))  # (new, old)
        predicted = (filtered * dx) @ moves.T
        share = np.divide(smoothed[..., new], predicted, out=np.zeros(predicted.shape), where=predicted > 0)
        factor += (share * dx[new]) @ moves
    return factor


def ancestral_lines(track):
    r"""Number of the particle at each time from which each particle of the last time descends.

    .. math:: b_T^{(i)} = i, \qquad b_{k-1}^{(i)} = a_k^{(b_k^{(i)})}

    Parameters
    ----------
    track : Track
        Of a particle filter that was run with ``keep=True``.

    Returns
    -------
    ndarray of int, shape (..., T+1, N)
        Column i is the line of particle i of time T.

    Raises
    ------
    ValueError
        If the filter kept no ancestors.

    Examples
    --------
    >>> import pfedu
    >>> from pfedu.smoothing import ancestral_lines
    >>> a = np.array([[0, 1, 2], [0, 0, 2], [1, 2, 2]])
    >>> track = pfedu.Track(None, None, None, particles=np.zeros((3, 3, 1)), log_weights=np.zeros((3, 3)), ancestors=a)
    >>> ancestral_lines(track).tolist()
    [[0, 2, 2], [1, 2, 2], [0, 1, 2]]
    """
    _kept(track)
    a = np.moveaxis(track.ancestors, -2, 0)  # (T+1, ..., N)
    lines = [np.broadcast_to(np.arange(a.shape[-1]), a.shape[1:])]
    for k in range(len(a) - 1, 0, -1):
        lines.append(np.take_along_axis(a[k], lines[-1], axis=-1))
    return np.stack(lines[::-1], axis=-2)


def distinct_ancestors(lines):
    """How many different particles of each time have descendants at the last time.

    Parameters
    ----------
    lines : ndarray of int, shape (..., T+1, N)
        What :func:`ancestral_lines` gives.

    Returns
    -------
    ndarray of int, shape (..., T+1)

    Examples
    --------
    >>> from pfedu.smoothing import distinct_ancestors
    >>> distinct_ancestors(np.array([[0, 2, 2], [1, 2, 2], [0, 1, 2]])).tolist()
    [2, 2, 3]
    """
    ordered = np.sort(lines, axis=-1)
    return 1 + np.count_nonzero(np.diff(ordered, axis=-1), axis=-1)


def genealogy_smoother(track):
    r"""Smooth by ancestry: each last particle with its line of ancestors is a path, with the last weight.

    .. math:: p(x_{0:T} \mid Y_T) \approx \sum_i w_T^{(i)}\, \delta(x_{0:T} - x_{0:T}^{(i)})

    It costs nothing beyond the filter, and is right for every N in the sense in which the filter is; but every
    resampling leaves fewer different ancestors, and at early times one may be left of N
    (:func:`distinct_ancestors`). Source: Kitagawa, *Monte Carlo filter and smoother for non-Gaussian nonlinear state
    space models* (1996), section 4.

    Parameters
    ----------
    track : Track
        Of a particle filter that was run with ``keep=True``. Not of the regularised filter, whose particles move
        between two times.

    Returns
    -------
    Track
        Mean and covariance given all measurements. Of its ``particles`` (..., T+1, N, n_x) those with the same
        number form one path; ``log_weights`` are the last ones at every time, and ``n_eff`` is theirs.

    Raises
    ------
    ValueError
        If the filter kept no particles.

    Examples
    --------
    >>> import pfedu
    >>> model, y = pfedu.models.random_walk(q=1, r=1, p0=1), [[np.nan], [3.0]]
    >>> track = pfedu.bootstrap_filter(model, y, 10_000, rng=np.random.default_rng(1), keep=True)
    >>> bool(np.abs(pfedu.genealogy_smoother(track).mean.ravel() - [1.0, 2.0]).max() < 0.05)
    True
    """
    lines = ancestral_lines(track)
    x = np.take_along_axis(track.particles, lines[..., None], axis=-2)
    return _smoothed(track, x, np.broadcast_to(track.log_weights[..., -1:, :], x.shape[:-1]))


def backward_smoother(model, track, n_paths, *, rng):
    r"""Smooth by backward simulation: draw paths from the end, each step among all particles of the time before.

    .. math::
        P(b_T = i) = w_T^{(i)}, \qquad
        P(b_k = i \mid x_{k+1}) =
        \frac{w_k^{(i)}\, p(x_{k+1} \mid x_k^{(i)})}{\sum_j w_k^{(j)}\, p(x_{k+1} \mid x_k^{(j)})}

    Paths are independent given the particles, and need not follow anyone's ancestors, so that early times stay
    diverse. A step costs N evaluations of the transition density for each path. Source: Godsill, Doucet and West,
    *Monte Carlo smoothing for nonlinear time series* (2004), algorithm 1.

    Parameters
    ----------
    model : StateSpaceModel
        With ``log_transition``: that of the filter.
    track : Track
        Of a particle filter that was run with ``keep=True``. Not of the regularised filter, whose particles move
        between two times.
    n_paths : int
        Their number, M, for each run.
    rng : numpy.random.Generator

    Returns
    -------
    Track
        Mean and covariance given all measurements. Of its ``particles`` (..., T+1, M, n_x) those with the same
        number form one path; all ``log_weights`` are -log M.

    Raises
    ------
    MissingPieceError
        If the model has no ``log_transition``.
    ValueError
        If the filter kept no particles, n_paths is no number of paths, the noise of the model has no density, or
        ``log_transition`` gives the wrong shape or a value that is none.
    ZeroLikelihoodError
        If no particle could have moved to where a path is.

    Examples
    --------
    >>> import pfedu
    >>> model, y = pfedu.models.random_walk(q=1, r=1, p0=1), [[np.nan], [3.0]]
    >>> track = pfedu.bootstrap_filter(model, y, 1000, rng=np.random.default_rng(1), keep=True)
    >>> smooth = pfedu.backward_smoother(model, track, 1000, rng=np.random.default_rng(2))
    >>> smooth.particles.shape, bool(np.abs(smooth.mean.ravel() - [1.0, 2.0]).max() < 0.1)
    ((2, 1000, 1), True)
    """
    require(model, "log_transition", "backward simulation")
    _kept(track)
    if not (1 <= n_paths < np.inf and n_paths == int(n_paths)):
        raise ValueError(f"n_paths must be a whole number of at least 1, got {n_paths}")
    (rng,) = streams(rng, 1)
    x = np.moveaxis(track.particles, -3, 0)  # (T+1, ..., N, n_x)
    log_w = np.moveaxis(track.log_weights, -2, 0)  # (T+1, ..., N)
    picked = multinomial(np.exp(log_w[-1]), rng, size=int(n_paths))
    paths = [np.take_along_axis(x[-1], picked[..., None], axis=-2)]  # (..., M, n_x)
    at_once = max(1, _AT_ONCE // (x[0].size))
    for k in range(len(x) - 2, -1, -1):
        parts = np.split(paths[-1], range(at_once, int(n_paths), at_once), axis=-2)
        picked = np.concatenate([_step_back(model, k, x[k], log_w[k], part, rng) for part in parts], axis=-1)
        paths.append(np.take_along_axis(x[k], picked[..., None], axis=-2))
    paths = np.stack(paths[::-1], axis=-3)
    return _smoothed(track, paths, np.full(paths.shape[:-1], -np.log(paths.shape[-2])))


def _step_back(model, k, x, log_w, ahead, rng):
    """For each state ahead (..., M, n_x) of time k+1 the number of a particle of time k that may have led to it."""
    log_moves = model.log_transition(k + 1, ahead[..., :, None, :], x[..., None, :, :])
    shape = (*ahead.shape[:-1], x.shape[-2])  # (..., M, N)
    if np.shape(log_moves) != shape:
        raise ValueError(f"log_transition must give shape {shape} here, it gave {np.shape(log_moves)}")
    try:
        log_p, _ = normalize(log_w[..., None, :] + log_moves)
    except ZeroLikelihoodError as error:
        raise ZeroLikelihoodError(
            f"step {k + 1}: no particle of time {k} could have moved to where a path is: the particles must be those "
            "of a filter of this model that moves them by the model alone"
        ) from error
    except ValueError as error:
        raise ValueError(f"step {k + 1}: log_transition gave a value that is no log density ({error})") from error
    return multinomial(np.exp(log_p), rng, size=1)[..., 0]


def _kept(track):
    """Whether the track has what a smoother goes through."""
    if track.particles is None or track.log_weights is None or track.ancestors is None:
        raise ValueError("the track holds no particles with their ancestors: run a particle filter with keep=True")


def _smoothed(track, x, log_w):
    """Track of paths x (..., T+1, M, n_x): who has the same number belongs together."""
    w = np.exp(log_w)
    mean, cov = moments(x, w)
    itself = np.broadcast_to(np.arange(x.shape[-2]), log_w.shape)
    n_eff = 1.0 / np.sum(w * w, axis=-1)
    return Track(mean, cov, track.log_likelihood_increments, n_eff, particles=x, log_weights=log_w, ancestors=itself)
