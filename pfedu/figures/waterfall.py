"""The posterior over time as a waterfall: one density a step, stacked away from the reader."""

import numpy as np

from pfedu.figures.style import COLORS


def plot_waterfall(ax, x, densities, *, times=None, height=4.0, color=COLORS["exact"], truth=None):
    """Draw one density a time step, each on its own base line.

    Every row is scaled by the same factor, so areas stay comparable.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    x : array_like, shape (G,)
        Nodes, in the units of the state.
    densities : array_like, shape (T+1, G)
        One density a row.
    times : array_like, shape (T+1,), optional
    height : float
        How many time steps the highest peak reaches up.
    color : str
    truth : array_like, shape (T+1,), optional
        True states, marked on their base lines.

    Returns
    -------
    list of matplotlib.lines.Line2D

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures import plot_waterfall
    >>> len(plot_waterfall(Figure().subplots(), [0, 1, 2], [[0, 1, 0], [0, 1, 0]]))
    2
    """
    densities = np.asarray(densities, dtype=float)
    times = np.arange(len(densities)) if times is None else np.asarray(times)
    step = np.median(np.diff(times)) if len(times) > 1 else 1.0
    rows = times[:, None] + densities * (height * step / densities.max())
    lines = []
    for k in range(len(rows) - 1, -1, -1):  # the far rows first, so that near ones cover them
        ax.fill_between(x, times[k], rows[k], color="white", lw=0, zorder=2 * (len(rows) - k))
        lines += ax.plot(x, rows[k], color=color, lw=0.9, zorder=2 * (len(rows) - k) + 1)
        if truth is not None:
            ax.plot(truth[k], times[k], "o", color=COLORS["truth"], ms=2.5, zorder=2 * (len(rows) - k) + 1)
    ax.set(xlabel="state", ylabel="time step")
    return lines[::-1]
