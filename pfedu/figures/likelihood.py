"""The likelihood of parameters: its hill over two of them, by lines of equal height."""

import numpy as np

from pfedu.figures.style import COLORS

DROPS = (8.0, 4.0, 2.0, 1.0, 0.5)  # below the top


def plot_hill(ax, a, b, surface, *, label="exact", color=COLORS["exact"], linestyle="--", marker="^"):
    """Draw a log-likelihood over two parameters as lines 0.5, 1, 2, 4 and 8 below its highest value, and mark that.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    a, b : array_like, shapes (A,) and (B,)
        Values of both parameters, in ascending order.
    surface : array_like, shape (B, A)
        Log-likelihood; row i belongs to ``b[i]``.
    label, color, linestyle, marker : str
        The label is that of the mark at the top.

    Returns
    -------
    matplotlib.contour.QuadContourSet

    Raises
    ------
    ValueError
        If the surface does not fit the parameters.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures.likelihood import plot_hill
    >>> a, b = np.linspace(-3, 3, 13), np.linspace(-3, 3, 7)
    >>> ax = Figure().subplots()
    >>> lines = plot_hill(ax, a, b, -0.5 * (a**2 + b[:, None] ** 2))
    >>> len(lines.levels), ax.lines[0].get_xydata().tolist()
    (5, [[0.0, 0.0]])
    """
    a, b, surface = np.asarray(a), np.asarray(b), np.asarray(surface)
    if surface.shape != (b.size, a.size):
        raise ValueError(f"the surface must have shape {(b.size, a.size)}, a row for each b; got {surface.shape}")
    row, column = np.unravel_index(surface.argmax(), surface.shape)
    look = dict(levels=surface.max() - np.array(DROPS), colors=color, linestyles=linestyle, linewidths=1.3)
    ax.plot(a[column], b[row], marker, color=color, ms=8, label=label)
    return ax.contour(a, b, surface, **look)
