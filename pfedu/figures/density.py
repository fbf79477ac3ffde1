"""Densities, exact and from weighted particles."""

import numpy as np

from pfedu.figures.style import COLORS


def particle_histogram(x, log_w, edges):
    """Density of weighted particles in each bin.

    Particles outside the bins are left out of the bins but not of the normalisation, so nothing piles
    up at the ends.

    Parameters
    ----------
    x : array_like, shape (N,)
        One state of each particle.
    log_w : array_like, shape (N,)
        Normalised log weights.
    edges : array_like, shape (B+1,)
        Bin edges, in the units of the state.

    Returns
    -------
    ndarray, shape (B,)
        Per unit of the state.

    Examples
    --------
    >>> from pfedu.figures import particle_histogram
    >>> particle_histogram([0.5, 1.5], np.log([0.25, 0.75]), [0, 1, 2]).tolist()
    [0.25, 0.75]
    """
    mass, _ = np.histogram(x, bins=edges, weights=np.exp(log_w))
    return mass / np.diff(edges)


def plot_density(ax, x, density, *, label="exact", color=COLORS["exact"], linestyle="-", fill=False):
    """Draw a density over the state.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    x, density : array_like, shape (G,)
        Nodes and density at the nodes.
    label, color, linestyle : str
    fill : bool
        Shade the area below.

    Returns
    -------
    matplotlib.lines.Line2D

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures import plot_density
    >>> plot_density(Figure().subplots(), [0, 1], [1, 1]).get_label()
    'exact'
    """
    if fill:
        ax.fill_between(x, density, color=color, alpha=0.18, lw=0)
    return ax.plot(x, density, color=color, ls=linestyle, lw=1.6, label=label)[0]
