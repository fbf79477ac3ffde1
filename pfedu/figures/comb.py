"""Resampling as points on the unit interval, one row a scheme."""

import numpy as np

from pfedu.figures.style import COLORS


def plot_points(ax, weights, points, *, title="", cells=0):
    """Draw the unit interval cut into one stretch a particle, and the points that pick them.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    weights : array_like, shape (N,)
        Normalised weights: the lengths of the stretches.
    points : array_like, shape (size,)
        Where the points stand, from 0 to 1.
    title : str
    cells : int
        Draw the borders of so many equal cells; 0 for none.

    Returns
    -------
    ndarray of int, shape (size,)
        Index (from 0) of the particle under each point.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures.comb import plot_points
    >>> plot_points(Figure().subplots(), [0.6, 0.4], [0.1, 0.7], cells=2).tolist()
    [0, 1]
    """
    weights, points = np.asarray(weights, dtype=float), np.asarray(points, dtype=float)
    ends = np.cumsum(weights)
    for i, (end, w) in enumerate(zip(ends, weights, strict=True)):
        hue, hatch = (COLORS["light"], "") if i % 2 else (COLORS["accent"], "//")
        ax.barh(0.0, w, left=end - w, height=0.6, color=hue, alpha=0.6, hatch=hatch, edgecolor="white")
        if w > 0.03:
            ax.text(end - w / 2, -0.08, str(i + 1), ha="center", va="center", bbox=dict(fc="white", ec="none", pad=1.5))
    if cells:
        ax.vlines(np.arange(cells + 1) / cells, 0.3, 0.85, color=COLORS["measurement"], lw=1, ls=":")
    ax.vlines(points, 0.3, 0.75, color=COLORS["truth"], lw=1.4)
    ax.plot(points, np.full(points.size, 0.34), "v", color=COLORS["truth"], ms=6)
    ax.set(xlim=(0, 1), ylim=(-0.35, 0.9), yticks=[], title=title)
    ax.grid(visible=False)
    return np.minimum(np.searchsorted(ends / ends[-1], points, side="right"), weights.size - 1)
