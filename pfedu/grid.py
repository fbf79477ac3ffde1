"""The recursive Bayesian estimator on a grid: the exact answer for a state of one or two dimensions."""

from functools import reduce
from itertools import product
from typing import NamedTuple

import numpy as np

from pfedu.models import require
from pfedu.track import Track, read_record

_AT_ONCE = 2**22  # numbers in an array of pairs of nodes, 32 MB: the transition density is taken in pieces of this size


class GridError(ValueError):
    """The grid is too narrow or too coarse for this record; the message says where and by how much."""


def grid_filter(model, y, grid, *, tolerance=1e-3):
    r"""Both integrals of the Bayesian recursion as sums over the nodes of a grid.

    .. math::
        p(x_k \mid Y_{k-1}) &= \int p(x_k \mid x_{k-1})\, p(x_{k-1} \mid Y_{k-1})\, dx_{k-1} \\
        p(x_k \mid Y_k) &= p(y_k \mid x_k)\, p(x_k \mid Y_{k-1}) / p(y_k \mid Y_{k-1})

    Integrals are trapezoidal. On evenly spaced nodes the error for a smooth density that fades out
    before both ends falls faster than any power of the spacing; on uneven nodes it falls, in general,
    with the square of the spacing. A step costs as many evaluations of the transition density as there
    are pairs of nodes. Sources: Simon, *Optimal State Estimation* (2006), section 15.1; for a state of
    two dimensions Bucy and Senne (1971).

    Parameters
    ----------
    model : StateSpaceModel
        With n_x = 1 or 2, ``log_initial`` and ``log_transition``.
    y : array_like, shape (..., T+1, n_y)
        Measurements, row k is time k; leading axes are independent records. A row of NaN is missing.
    grid : array_like, shape (G,), or a pair of them, shapes (G_1,) and (G_2,)
        Nodes in ascending order, in the units of the state; they need not be evenly spaced. For n_x = 2
        the nodes of the first and of the second state: the grid is all G = G_1 G_2 pairs.
    tolerance : float
        How much probability a prediction may lose or gain on the grid before it is an error. Each increment of
        the log-likelihood may be off by as much.

    Returns
    -------
    Track
        With mean, covariance, log-likelihood increments, and the density at every node:
        ``grid`` (G,) and ``density`` (..., T+1, G) for n_x = 1; for n_x = 2 ``grid`` is the pair of
        vectors (G_1,) and (G_2,), and ``density`` (..., T+1, G_1, G_2).

    Raises
    ------
    MissingPieceError
        If the model lacks a density.
    GridError
        If the grid is too narrow, or too coarse for a density or for the motion of the model: the
        message gives the step and what to change, and the axis where that can be told.
    ValueError
        If the model has more than two states or a noise without density, or if the grid, the record or
        what a function of the model gives has the wrong shape.

    Examples
    --------
    >>> import pfedu
    >>> model, y = pfedu.models.random_walk(), [[np.nan], [0.5]]
    >>> track = pfedu.grid_filter(model, y, np.linspace(-30, 30, 601))
    >>> exact = pfedu.kalman_filter(model, y)
    >>> bool(np.allclose(track.mean, exact.mean, atol=1e-9))
    True

    Two states, position and velocity. Integrating over the second leaves the density of the first:

    >>> model = pfedu.models.LinearGaussian([[1, 1], [0, 1]], [[1, 0]], Q=[1, 1], R=1, m0=[0, 0], P0=[1, 1])
    >>> track = pfedu.grid_filter(model, y, (np.linspace(-12, 12, 41), np.linspace(-9, 9, 31)))
    >>> track.density.shape, (track.density @ trapezoid_weights(track.grid[1])).shape
    ((2, 41, 31), (2, 41))
    """
    for piece in ("log_initial", "log_transition", "log_likelihood"):
        require(model, piece, "the grid filter")
    y, missing = read_record(y, model.n_y)
    grid = _read_grid(model.n_x, grid)
    p = np.exp(_shaped("log_initial", model.log_initial(grid.x), grid.dx.shape))
    p = np.broadcast_to(p, (*y.shape[:-2], grid.dx.size))
    densities, increments = [], []
    for k in range(y.shape[-2]):
        if k > 0:
            p = _predict(model, k, grid, p * grid.dx)
        _check_mass(p, grid, k, tolerance)
        p, increment = _correct(model, k, y[..., k, :], missing[..., k], grid, p)
        densities.append(p)
        increments.append(increment)
    density = np.stack(densities, -2)  # (..., T+1, G)
    mean, cov = _moments(density, grid)
    nodes = grid.axes[0] if model.n_x == 1 else grid.axes
    return Track(mean, cov, np.stack(increments, -1), grid=nodes, density=grid.cells(density))


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


class _Grid(NamedTuple):
    """All tuples of one node from each axis, as one list of G nodes; the last axis runs fastest."""

    axes: tuple  # n_x vectors (G_i,)
    x: np.ndarray  # (G, n_x): one state a node
    dx: np.ndarray  # (G,): the integral of p is p @ dx

    def cells(self, values):
        """Values at the nodes (..., G) as a table with one axis a state: (..., G_1, ..., G_n)."""
        return values.reshape(*values.shape[:-1], *(nodes.size for nodes in self.axes))

    def every_second(self, values, parity):
        """Of values (..., G) those at nodes with an even index on the axes of parity 0, an odd one on those of 1."""
        cells = self.cells(values)[(..., *(slice(start, None, 2) for start in parity))]
        return cells.reshape(*values.shape[:-1], -1)

    @property
    def parities(self):
        """Even or odd for each axis, all even first: the classes that ``every_second`` takes apart."""
        return list(product((0, 1), repeat=len(self.axes)))

    def compare(self, sums):
        """Total over the classes of nodes, and even minus odd: along each axis, and as on a chessboard."""
        signs = [[(-1.0) ** np.dot(across, parity) for parity in self.parities] for across in self.parities]
        total, *differences = np.tensordot(signs, sums, axes=1)
        return total, dict(zip(self.parities[1:], differences, strict=True))

    def of(self, axes):
        """Which axes, for a message; nothing where there is only one, or none can be told."""
        if len(self.axes) == 1 or not axes:
            return ""
        numbers = " and ".join(str(axis + 1) for axis in sorted(axes))
        return f" of axis {numbers}" if len(axes) == 1 else f" of axes {numbers}"


def _read_grid(n_x, grid):
    """Check the nodes of each axis and make the grid of them."""
    if n_x > 2:
        raise ValueError(
            f"the grid filter takes a state of one or two dimensions, the model has {n_x}: each step goes over all "
            f"pairs of nodes, and 50 nodes an axis already make {50**n_x} nodes, {2500**n_x:.1e} pairs; use a particle "
            "filter, such as pfedu.bootstrap_filter"
        )
    if n_x == 1:
        axes = (_read_axis(grid, "the grid"),)
    else:
        pair = list(grid) if np.iterable(grid) else []
        if len(pair) != 2:
            raise ValueError(
                f"for a state of two dimensions the grid must be a pair (nodes_1, nodes_2) of vectors, got {_got(grid)}"
            )
        axes = tuple(_read_axis(nodes, f"axis {i} of the grid") for i, nodes in enumerate(pair, start=1))
    x = np.stack([table.ravel() for table in np.meshgrid(*axes, indexing="ij")], axis=-1)
    return _Grid(axes, x, reduce(np.multiply.outer, map(trapezoid_weights, axes)).ravel())


def _read_axis(nodes, name):
    wanted = f"{name} must be a vector of at least 3 ascending nodes, got {_got(nodes)}"
    try:
        nodes = np.asarray(nodes, dtype=float)
    except (TypeError, ValueError) as error:
        raise ValueError(wanted) from error
    if nodes.ndim != 1 or nodes.size < 3 or not (np.diff(nodes) > 0).all():
        raise ValueError(wanted)
    return nodes


def _got(values):
    try:
        return f"shape {np.shape(values)}"
    except ValueError:
        return f"{len(values)} parts of different shapes"


def _predict(model, k, grid, mass):
    """Sum over where each node's probability may have come from: once over the even nodes, once over the odd.

    Either half alone is a sum with twice the spacing. Where the two disagree, the density of arriving at a node,
    as a function of where one started, is narrower than the spacing, and their mean cannot be trusted either.
    With two axes there are three such pairs of halves: even and odd along either axis, and the black and the white
    fields of a chessboard, which alone tell of a density that is narrow across a diagonal.
    """
    n_nodes, n_x = grid.x.shape
    masses = {parity: np.ascontiguousarray(grid.every_second(mass, parity)) for parity in grid.parities}
    sums = np.empty((len(masses), *mass.shape))
    rows = max(1, _AT_ONCE // (n_nodes * n_x))
    for new in (slice(start, start + rows) for start in range(0, n_nodes, rows)):
        log_moves = model.log_transition(k, grid.x[new, None], grid.x[None, :])
        moves = np.exp(_shaped("log_transition", log_moves, (len(grid.x[new]), n_nodes)))  # (new, old)
        for i, parity in enumerate(masses):
            sums[i, ..., new] = masses[parity] @ grid.every_second(moves, parity).T
    prediction, differences = grid.compare(sums)
    _check_moves({across: (np.abs(apart) @ grid.dx).max() for across, apart in differences.items()}, grid, k)
    return prediction


def _check_moves(apart, grid, k):
    """Both halves of the nodes must predict the same, to 5 % of the probability."""
    if max(apart.values()) > 0.05:
        coarse = {axis for across, by in apart.items() if by > 0.05 for axis in np.flatnonzero(across)}
        raise GridError(
            f"the step to time {k} is narrower than the grid can see: with every second node{grid.of(coarse)} the "
            f"prediction changes by {max(apart.values()):.2g} of its probability; use a finer grid where the model "
            "moves nearby states far apart"
        )


def _shaped(name, values, shape):
    if np.shape(values) != shape:
        raise ValueError(f"{name} must give shape {shape} on this grid, it gave {np.shape(values)}")
    return values


def _correct(model, k, y, missing, grid, p):
    """Multiply by the likelihood and normalise; a missing measurement leaves p as it is."""
    if missing.all():
        return p / (p @ grid.dx)[..., None], np.zeros(missing.shape)
    log_g = _shaped("log_likelihood", model.log_likelihood(k, y[..., None, :], grid.x), p.shape)
    log_g = np.where(missing[..., None], 0.0, log_g)
    if not (log_g < np.inf).all():  # false for NaN too
        node = np.argwhere(~(log_g < np.inf))[0, -1]
        raise ValueError(f"step {k}: log_likelihood is not finite at the node {grid.x[node].tolist()}")
    with np.errstate(divide="ignore"):  # no probability is a logarithm of -inf
        log_joint = np.log(p) + log_g  # (..., G)
    peak = log_joint.max(axis=-1, keepdims=True)
    if not (peak > -np.inf).all():
        raise GridError(
            f"at step {k} no node has both probability and likelihood: the measurement lies too far from the "
            "prediction for a double, or beyond the grid"
        )
    joint = np.exp(log_joint - peak)
    evidence = joint @ grid.dx
    _check_fine(joint / evidence[..., None] * grid.dx, grid, k)
    return joint / evidence[..., None], np.where(missing, 0.0, np.log(evidence) + peak[..., 0])


def _moments(density, grid):
    """Mean (..., n_x) and covariance (..., n_x, n_x) of densities (..., G)."""
    mean = np.stack([density @ (grid.dx * x) for x in grid.x.T], axis=-1)
    w = density * grid.dx
    d = [x - mean[..., i, None] for i, x in enumerate(grid.x.T)]  # n_x times (..., G)
    cov = np.stack([np.sum(w * (d_i * d_j), axis=-1) for d_i, d_j in product(d, d)], axis=-1)
    return mean, cov.reshape(*mean.shape, len(d))


def _check_mass(p, grid, k, tolerance):
    """A density integrates to one; on the grid it does not if it sticks out or falls between nodes."""
    p = p.reshape(-1, grid.dx.size)  # one row a run
    mass = p @ grid.dx
    worst = np.argmax(np.abs(mass - 1.0))
    if not abs(mass[worst] - 1.0) <= tolerance:
        raise GridError(
            f"before the measurement of step {k} the density integrates to {mass[worst]:.4g} on the grid instead of 1: "
            + _why_not_one(p[worst], mass[worst], grid)
        )


def _why_not_one(p, mass, grid):
    """What is wrong with the grid for a density p (G,) that does not integrate to one on it."""
    wide = {axis for axis in range(len(grid.axes)) if _sticks_out(p, mass, grid, axis)}
    if wide:
        return f"it sticks out at an end{grid.of(wide)}, use a wider grid"
    halves = [grid.every_second(p * grid.dx, parity).sum() for parity in grid.parities]
    _, differences = grid.compare(halves)
    coarse = {
        axis for across, by in differences.items() if abs(by) > abs(mass - 1.0) for axis in np.flatnonzero(across)
    }
    return f"it falls between nodes{grid.of(coarse)}, use a finer grid"


def _sticks_out(p, mass, grid, axis):
    """Whether a density is high at an end of an axis, or could have what is missing beyond it in a long tail.

    A tail that falls with the square of the distance has as much beyond an end as it has there over half the length.
    """
    nodes, others = grid.axes[axis], tuple(i for i in range(len(grid.axes)) if i != axis)
    along = grid.cells(p * grid.dx).sum(axis=others) / trapezoid_weights(nodes)  # (G_i,): density of that state alone
    ends = along[0] + along[-1]
    return max(along[0], along[-1]) > 1e-3 * along.max() or 0.0 < 1.0 - mass < ends * (nodes[-1] - nodes[0])


def _check_fine(w, grid, k):
    """A peak needs about as many nodes as its full width: below 3 the sum is no longer the integral.

    With two axes the nodes of one are counted where the other state is known: a narrow ridge along the diagonal
    covers many nodes of either axis, and yet falls between them.
    """
    squares, n_x = np.sum(w * w, axis=-1), len(grid.axes)
    others = [grid.cells(w).sum(axis=axis - n_x).reshape(*squares.shape, -1) for axis in range(n_x)]
    n_eff = [np.min(np.sum(other * other, axis=-1) / squares) for other in others]
    if min(n_eff) < 3:
        where = grid.of({np.argmin(n_eff)}) + (" with the other state known" if n_x > 1 else "")
        raise GridError(
            f"at step {k} the posterior rests on {min(n_eff):.2g} nodes{where}: use a finer grid there, or a wider one "
            "if it lies beyond the ends"
        )
