"""Paths of particles, drawn as thick as their weights."""

import numpy as np
from matplotlib.collections import LineCollection

from pfedu.figures.style import COLORS


def plot_paths(ax, x, weights, *, times=None, color=COLORS["particles"], thickest=4.0):
    """Draw the path of each particle; the thicker, the heavier it is in the end.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    x : array_like, shape (T+1, N)
        One state of each particle at each time, never resampled: column i is one path.
    weights : array_like, shape (N,)
        Normalised weights at the last time.
    times : array_like, shape (T+1,), optional
        0, 1, ..., T by default.
    color : str
    thickest : float
        Width in points of the heaviest path.

    Returns
    -------
    matplotlib.collections.LineCollection

    Raises
    ------
    ValueError
        If there is not one weight for each path.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures.paths import plot_paths
    >>> paths = plot_paths(Figure().subplots(), [[0.0, 0.0], [1.0, -1.0]], [0.8, 0.2])
    >>> [round(float(width), 1) for width in paths.get_linewidths()]
    [4.0, 1.4]
    """
    x, weights = np.asarray(x, dtype=float), np.asarray(weights, dtype=float)
    if x.ndim != 2 or weights.shape != x.shape[1:]:
        raise ValueError(f"paths (T+1, N) need N weights, got shapes {x.shape} and {weights.shape}")
    times = np.arange(len(x)) if times is None else np.asarray(times)
    share = weights / weights.max()
    lines = np.stack([np.broadcast_to(times[:, None], x.shape), x], axis=-1).swapaxes(0, 1)  # (N, T+1, 2)
    paths = LineCollection(lines, colors=color, linewidths=0.5 + (thickest - 0.5) * share, alpha=0.35 + 0.55 * share)
    ax.add_collection(paths)
    ax.autoscale_view()
    return paths
