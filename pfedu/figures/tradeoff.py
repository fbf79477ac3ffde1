"""Accuracy against cost, both measured."""

import numpy as np

from pfedu.figures.style import COLORS


def plot_tradeoff(ax, cost, square, *, label="filter", color=COLORS["particles"], marker="o", linestyle="-"):
    """Draw root mean square distances against costs on logarithmic axes, with standard errors.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    cost : array_like, shape (n,)
        What each setting of the filter costs.
    square : array_like, shape (n, n_runs)
        Squared distances to the exact answer, a value for each run. Their mean may come out negative where
        it is measured against references that are noisy themselves; such a point is drawn at its upper bar.
    label, color, marker, linestyle : str

    Returns
    -------
    matplotlib.lines.Line2D
        The line with the markers.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures.tradeoff import plot_tradeoff
    >>> line = plot_tradeoff(Figure().subplots(), [20, 200], [[1.0, 0.5], [0.1, 0.2]])
    >>> line.get_ydata().round(3).tolist()
    [0.866, 0.387]
    """
    square = np.asarray(square)
    mean, error = square.mean(axis=-1), square.std(axis=-1, ddof=1) / np.sqrt(square.shape[-1])
    high = np.sqrt(np.maximum(mean + error, 0.0))
    middle = np.where(mean > 0, np.sqrt(np.maximum(mean, 0.0)), high)
    low = np.where(mean > error, np.sqrt(np.maximum(mean - error, 0.0)), 1e-12)  # to the end of the axis
    ax.vlines(cost, low, high, color=color, lw=1.2)
    ax.set(xscale="log", yscale="log")
    return ax.plot(cost, middle, marker, ls=linestyle, color=color, ms=6, lw=1.3, label=label)[0]
