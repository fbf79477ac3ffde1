"""The recursive Bayesian estimator on a grid: the exact answer for a state of one dimension."""

import numpy as np

from pfedu.models import require
from pfedu.track import Track, read_record


class GridError(ValueError):
    """The grid is too narrow or too coarse for this record; the message says where and by how much."""


def grid_filter(model, y, grid, *, tolerance=1e-3):
    r"""Both integrals of the Bayesian recursion as sums over the nodes of a grid.

    .. math::
        p(x_k \mid Y_{k-1}) &= \int p(x_k \mid x_{k-1})\, p(x_{k-1} \mid Y_{k-1})\, dx_{k-1} \\
        p(x_k \mid Y_k) &= p(y_k \mid x_k)\, p(x_k \mid Y_{k-1}) / p(y_k \mid Y_{k-1})

    Integrals are trapezoidal. On evenly spaced nodes the error for a smooth density that fades out
    before both ends falls faster than any power of the spacing; on uneven nodes it falls, in general,
    with the square of the spacing. Source: Simon, *Optimal State Estimation* (2006), section 15.1.

    Parameters
    ----------
    model : StateSpaceModel
        With n_x = 1, ``log_initial`` and ``log_transition``.
    y : array_like, shape (..., T+1, n_y)
        Measurements, row k is time k; leading axes are independent records. A row of NaN is missing.
    grid : array_like, shape (G,)
        Nodes in ascending order, in the units of the state; they need not be evenly spaced.
    tolerance : float
        How much probability a prediction may lose or gain on the grid before it is an error.

    Returns
    -------
    Track
        With mean, covariance, log-likelihood increments, and the density at every node.

    Raises
    ------
    MissingPieceError
        If the model lacks a density.
    GridError
        If the grid is too narrow, or too coarse for a density or for the motion of the model: the
        message gives the step and what to change.
    ValueError
        If the grid, the record or what a function of the model gives has the wrong shape.

    Examples
    --------
    >>> import pfedu
    >>> model, y = pfedu.models.random_walk(), [[np.nan], [0.5]]
    >>> track = pfedu.grid_filter(model, y, np.linspace(-30, 30, 601))
    >>> exact = pfedu.kalman_filter(model, y)
    >>> bool(np.allclose(track.mean, exact.mean, atol=1e-9))
    True
    """
    for piece in ("log_initial", "log_transition", "log_likelihood"):
        require(model, piece, "the grid filter")
    y, missing = read_record(y, model.n_y)
    nodes = _check_grid(model, grid)
    dx = trapezoid_weights(nodes)
    x = nodes[:, None]  # (G, 1): one state a node
    p = np.exp(_shaped("log_initial", model.log_initial(x), (nodes.size,)))
    p = np.broadcast_to(p, (*y.shape[:-2], nodes.size))
    densities, increments = [], []
    for k in range(y.shape[-2]):
        if k > 0:
            p = _predict(model, k, x, p * dx, dx)
        _check_mass(p, dx, k, tolerance)
        p, increment = _correct(model, k, y[..., k, :], missing[..., k], x, p, dx)
        densities.append(p)
        increments.append(increment)
    density = np.stack(densities, -2)  # (..., T+1, G)
    mean = density @ (dx * nodes)
    var = np.sum(density * dx * (nodes - mean[..., None]) ** 2, axis=-1)
    return Track(mean[..., None], var[..., None, None], np.stack(increments, -1), grid=nodes, density=density)


def trapezoid_weights(grid):
    """Weights of the trapezoidal rule: the integral of p is ``p @ weights``.

    Parameters
    ----------
    grid : ndarray, shape (G,)
        Nodes in ascending order.

    Returns
    -------
    ndarray, shape (G,)
        In the units of the grid.

    Examples
    --------
    >>> from pfedu.grid import trapezoid_weights
    >>> trapezoid_weights(np.array([0.0, 1.0, 3.0])).tolist()
    [0.5, 1.5, 1.0]
    """
    gap = np.diff(grid)
    return 0.5 * (np.append(gap, 0.0) + np.append(0.0, gap))


def _predict(model, k, x, mass, dx):
    """Sum over where each node's probability may have come from: once over the even nodes, once over the odd.

    Either half alone is a sum with twice the spacing. Where the two disagree, the density of arriving at a node,
    as a function of where one started, is narrower than the spacing, and their mean cannot be trusted either.
    """
    log_moves = model.log_transition(k, x[:, None], x[None, :])
    moves = np.exp(_shaped("log_transition", log_moves, (dx.size, dx.size)))  # (G new, G old)
    even, odd = 2.0 * mass[..., ::2] @ moves[:, ::2].T, 2.0 * mass[..., 1::2] @ moves[:, 1::2].T
    apart = 0.5 * (np.abs(even - odd) @ dx).max()
    if apart > 0.05:
        raise GridError(
            f"the step to time {k} is narrower than the grid can see: with every second node the prediction changes "
            f"by {apart:.2g} of its probability; use a finer grid where the model moves nearby states far apart"
        )
    return 0.5 * (even + odd)


def _shaped(name, values, shape):
    if np.shape(values) != shape:
        raise ValueError(f"{name} must give shape {shape} on this grid, it gave {np.shape(values)}")
    return values


def _correct(model, k, y, missing, x, p, dx):
    """Multiply by the likelihood and normalise; a missing measurement leaves p as it is."""
    if missing.all():
        return p / (p @ dx)[..., None], np.zeros(missing.shape)
    log_g = _shaped("log_likelihood", model.log_likelihood(k, y[..., None, :], x), p.shape)
    with np.errstate(divide="ignore"):  # no probability is a logarithm of -inf
        log_joint = np.log(p) + np.where(missing[..., None], 0.0, log_g)  # (..., G)
    peak = log_joint.max(axis=-1, keepdims=True)
    if not (peak > -np.inf).all():
        raise GridError(
            f"at step {k} no node has both probability and likelihood: the measurement lies too far from the "
            "prediction for a double, or beyond the grid"
        )
    joint = np.exp(log_joint - peak)
    evidence = joint @ dx
    _check_fine(joint / evidence[..., None] * dx, k)
    return joint / evidence[..., None], np.where(missing, 0.0, np.log(evidence) + peak[..., 0])


def _check_grid(model, grid):
    nodes = np.asarray(grid, dtype=float)
    if model.n_x != 1:
        raise ValueError(f"this grid filter takes a state of one dimension, the model has {model.n_x}")
    if nodes.ndim != 1 or nodes.size < 3 or not (np.diff(nodes) > 0).all():
        raise ValueError(f"the grid must be a vector of at least 3 ascending nodes, got shape {nodes.shape}")
    return nodes


def _check_mass(p, dx, k, tolerance):
    """A density integrates to one; on the grid it does not if it sticks out or falls between nodes."""
    p = p.reshape(-1, dx.size)  # one row a run
    mass = p @ dx
    worst = np.argmax(np.abs(mass - 1.0))
    if not abs(mass[worst] - 1.0) <= tolerance:
        sticks_out = max(p[worst, 0], p[worst, -1]) > 1e-3 * p[worst].max()
        raise GridError(
            f"before the measurement of step {k} the density integrates to {mass[worst]:.4g} on the grid instead of 1: "
            + (
                "it sticks out at an end, use a wider grid"
                if sticks_out
                else "it falls between nodes, use a finer grid"
            )
        )


def _check_fine(w, k):
    """A peak needs about as many nodes as its full width: below 3 the sum is no longer the integral."""
    n_eff = 1.0 / np.max(np.sum(w * w, axis=-1))
    if n_eff < 3:
        raise GridError(
            f"at step {k} the posterior rests on {n_eff:.2g} nodes: use a finer grid there, or a wider one if it lies "
            "beyond the ends"
        )
