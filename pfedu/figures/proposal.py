"""What one particle's step and one measurement say of the new state, and what follows from both."""

import numpy as np

from pfedu.figures.style import COLORS


def plot_proposal(ax, f, y, q, r, *, base=0.0, height=1.0, labels=True):
    """Draw a particle's transition N(f, q), the likelihood of y as N(y, r), and the product of the two.

    All are divided by the peak of the product, the optimal importance density, so areas stay comparable.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    f, y : float
        Where the particle goes without noise, and the measurement of the state.
    q, r : float
        Variances of process noise and measurement noise.
    base, height : float
        Of the base line, and of the peak of the optimal density above it.
    labels : bool
        Whether to name the curves for the legend.

    Returns
    -------
    list of matplotlib.lines.Line2D
        Transition, likelihood, optimal density.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures.proposal import plot_proposal
    >>> transition, likelihood, optimal = plot_proposal(Figure().subplots(), 0.0, 2.0, 1.0, 1.0)
    >>> optimal.get_xdata().mean().round(6)  # halfway between what the particle and the measurement say
    np.float64(1.0)
    """
    sigma = q * r / (q + r)
    curves = {
        "transition": (f, q, dict(color=COLORS["second"], ls="-.")),
        "likelihood of $y_k$": (y, r, dict(color=COLORS["measurement"], ls=":")),
        "optimal": (f + q / (q + r) * (y - f), sigma, dict(color=COLORS["particles"], ls="-")),
    }
    z, lines = np.linspace(-4.0, 4.0, 161), []
    for name, (center, variance, look) in curves.items():
        density = np.exp(-0.5 * z * z) * np.sqrt(sigma / variance)  # over the peak of the optimal density
        label = name if labels else None
        lines += ax.plot(center + np.sqrt(variance) * z, base + height * density, lw=1.6, label=label, **look)
    return lines
