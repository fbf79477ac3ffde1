"""Angles on a circle: weighted headings and the directions that are made of them."""

import numpy as np

from pfedu.figures.style import COLORS


def plot_headings(ax, angle, weights, *, directions=(), numbers=True):
    """Draw headings as dots on a circle, as large as their weights, and directions as rays from its middle.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    angle, weights : array_like, shape (N,)
        Headings in radians, counted from the right against the clock, and their weights.
    directions : iterable of (float, str, str, str)
        Angle, label, colour and line style of each ray.
    numbers : bool
        Number the headings from 1.

    Returns
    -------
    list of matplotlib.lines.Line2D
        The rays.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures.circle import plot_headings
    >>> rays = plot_headings(Figure().subplots(), [3.1, -3.1], [0.5, 0.5], directions=[(np.pi, "mean", "k", "-")])
    >>> [ray.get_label() for ray in rays]
    ['mean']
    """
    ring = np.linspace(-np.pi, np.pi, 181)
    ax.plot(np.cos(ring), np.sin(ring), color=COLORS["measurement"], lw=0.8)
    ax.plot([-1.12, -0.88], [0, 0], color=COLORS["second"], lw=2.5)  # the seam
    ax.scatter(np.cos(angle), np.sin(angle), s=20 + 500 * np.asarray(weights), color=COLORS["light"], alpha=0.8)
    for i, a in enumerate(angle if numbers else (), start=1):
        radius = 1.22 + 0.14 * (i % 3)  # neighbours stand apart
        ax.annotate(str(i), (radius * np.cos(a), radius * np.sin(a)), ha="center", va="center", fontsize=9)
    ax.set(xlim=(-1.6, 1.2), ylim=(-1.2, 1.2), aspect="equal")
    ax.axis("off")
    return [
        ax.plot([0, np.cos(a)], [0, np.sin(a)], color=color, ls=style, lw=2, label=label)[0]
        for a, label, color, style in directions
    ]
