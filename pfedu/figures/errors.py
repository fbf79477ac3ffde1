"""Errors of many runs beside what the filter thinks of them, and the ellipse of a Gaussian."""

import numpy as np

from pfedu.figures.style import COLORS


def plot_errors(ax, track, x, *, state=0, bound=3.0, label="filter", color=COLORS["particles"], marker="o"):
    """Draw the mean absolute error over the runs as markers, and the mean bound of the filter as a line.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    track : pfedu.Track
        Of several runs.
    x : array_like, shape (n_runs, T+1, n_x)
        The truths.
    state : int
        Which state to draw.
    bound : float
        Half width of the bound in standard deviations.
    label, color, marker : str

    Returns
    -------
    list of matplotlib.lines.Line2D
        Errors, then bound.

    Examples
    --------
    >>> import numpy as np
    >>> import pfedu
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures.errors import plot_errors
    >>> model = pfedu.models.random_walk()
    >>> x, y = model.simulate(5, np.random.default_rng(1), n_runs=3)
    >>> len(plot_errors(Figure().subplots(), pfedu.kalman_filter(model, y), x))
    2
    """
    error = np.abs(track.mean - x)[..., state].mean(axis=0)
    times, style = np.arange(1, len(error)), "--" if marker == "s" else "-"
    markers = ax.plot(times, error[1:], marker, color=color, ms=3, label=f"{label}: error")
    bounds = bound * track.sd[..., state].mean(axis=0)
    return markers + ax.plot(times, bounds[1:], style, color=color, lw=1.4, label=f"{label}: {bound:g} sd")


def plot_ellipse(ax, mean, cov, *, sd=2.0, label="Gaussian", color=COLORS["exact"], linestyle="--"):
    """Draw where a Gaussian of two dimensions is so many standard deviations from its mean.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    mean : array_like, shape (2,)
    cov : array_like, shape (2, 2)
    sd : float
    label, color, linestyle : str

    Returns
    -------
    matplotlib.lines.Line2D

    Examples
    --------
    >>> import numpy as np
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures.errors import plot_ellipse
    >>> line = plot_ellipse(Figure().subplots(), [1.0, 0.0], np.diag([4.0, 1.0]))
    >>> float(line.get_xdata().max())  # two standard deviations of 2, about 1
    5.0
    """
    angle = np.linspace(0.0, 2.0 * np.pi, 121)
    circle = sd * np.stack([np.cos(angle), np.sin(angle)])
    outline = np.asarray(mean)[:, None] + np.linalg.cholesky(cov) @ circle
    return ax.plot(*outline, linestyle, color=color, lw=1.5, label=label)[0]
