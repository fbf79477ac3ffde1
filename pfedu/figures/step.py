"""One step of a particle filter, particle by particle: moved, weighed, picked by a comb."""

import numpy as np

from pfedu.figures.style import COLORS


def plot_move(ax, x_old, x_new, *, labels=("time k-1", "time k")):
    """Draw an arrow from where each particle was to where it went; particles are numbered from 1.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    x_old, x_new : array_like, shape (N,)
        One state of each particle, before and after.
    labels : tuple of str
        What to call the upper and the lower line.

    Returns
    -------
    list of matplotlib.text.Annotation
        One arrow a particle.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures.step import plot_move
    >>> len(plot_move(Figure().subplots(), [0.0, 1.0], [0.5, -1.0]))
    2
    """
    look = dict(arrowstyle="->", color=COLORS["measurement"], lw=1.0, shrinkA=6, shrinkB=6)
    arrows = [ax.annotate("", (b, 0.0), (a, 1.0), arrowprops=look) for a, b in zip(x_old, x_new, strict=True)]
    ax.plot(x_old, np.ones(len(x_old)), "o", color=COLORS["light"], ms=8)
    ax.plot(x_new, np.zeros(len(x_new)), "o", color=COLORS["particles"], ms=8)
    for i, x in enumerate(x_old, start=1):
        ax.annotate(str(i), (x, 1.0), (0, 7), textcoords="offset points", ha="center")
    ax.set(ylim=(-0.3, 1.5), yticks=[1, 0], yticklabels=labels)
    return arrows


def plot_weights(ax, x, weights, *, numbers=False, label="weight"):
    """Draw each particle as a stick as tall as its weight.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    x, weights : array_like, shape (N,)
        One state of each particle and its weight.
    numbers : bool
        Number the particles from 1.
    label : str

    Returns
    -------
    matplotlib.lines.Line2D
        The heads of the sticks.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures.step import plot_weights
    >>> plot_weights(Figure().subplots(), [0.0, 1.0], [0.25, 0.75]).get_marker()
    'o'
    """
    ax.vlines(x, 0.0, weights, color=COLORS["particles"], lw=1.6)
    for i, point in enumerate(zip(x, weights, strict=True), start=1):
        if numbers:
            ax.annotate(str(i), point, (0, 7), textcoords="offset points", ha="center")
    return ax.plot(x, weights, "o", color=COLORS["particles"], ms=5, label=label)[0]


def plot_comb(ax, weights, offset):
    """Draw the unit interval cut into one stretch a particle, and the comb of systematic resampling over it.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    weights : array_like, shape (N,)
        Normalised weights: the lengths of the stretches.
    offset : float
        Where in its cell each tooth stands, from 0 to 1.

    Returns
    -------
    ndarray of int, shape (N,)
        Index (from 0) of the particle under each tooth.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures.step import plot_comb
    >>> plot_comb(Figure().subplots(), [0.6, 0.4], 0.5).tolist()
    [0, 1]
    """
    weights = np.asarray(weights, dtype=float)
    ends, n = np.cumsum(weights), weights.size
    teeth = (np.arange(n) + offset) / n
    for i, (end, w) in enumerate(zip(ends, weights, strict=True)):
        hue, hatch = (COLORS["light"], "") if i % 2 else (COLORS["accent"], "//")
        ax.barh(0.0, w, left=end - w, height=0.6, color=hue, alpha=0.6, hatch=hatch, edgecolor="white")
        if w > 0.03:
            ax.text(end - w / 2, -0.08, str(i + 1), ha="center", va="center", bbox=dict(fc="white", ec="none", pad=1.5))
    ax.vlines(teeth, 0.05, 0.75, color=COLORS["truth"], lw=1.4)
    ax.plot(teeth, np.full(n, 0.05), "v", color=COLORS["truth"], ms=6)
    ax.hlines(0.75, teeth[0], teeth[-1], color=COLORS["truth"], lw=3)
    ax.set(xlim=(0, 1), ylim=(-0.4, 0.9), yticks=[], xlabel="cumulative weight")
    return np.minimum(np.searchsorted(ends / ends[-1], teeth, side="right"), n - 1)
