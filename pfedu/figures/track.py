"""Truth, measurements and estimates over time."""

import numpy as np

from pfedu.figures.style import COLORS


def plot_truth(ax, x, *, times=None, label="truth"):
    """Draw a true state over time.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    x : array_like, shape (T+1,)
        One state, row k is time k.
    times : array_like, shape (T+1,), optional
        Where to put the rows; 0 to T by default.
    label : str

    Returns
    -------
    matplotlib.lines.Line2D

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures import plot_truth
    >>> plot_truth(Figure().subplots(), [0.0, 1.0]).get_label()
    'truth'
    """
    return ax.plot(_times(times, x), x, color=COLORS["truth"], lw=1.4, label=label)[0]


def plot_measurements(ax, y, *, times=None, label="measurement"):
    """Draw measurements over time as crosses; missing ones leave a gap.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    y : array_like, shape (T+1,)
    times : array_like, shape (T+1,), optional
    label : str

    Returns
    -------
    matplotlib.lines.Line2D

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures import plot_measurements
    >>> plot_measurements(Figure().subplots(), [0.0, 1.0]).get_marker()
    'x'
    """
    return ax.plot(_times(times, y), y, "x", color=COLORS["measurement"], ms=5, mew=1.2, label=label)[0]


def plot_track(ax, track, *, state=0, times=None, label="estimate", color=COLORS["particles"], linestyle="-", band=2.0):
    """Draw posterior mean and a band of so many standard deviations about it.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    track : pfedu.Track
        Of a single run.
    state : int
        Which state to draw.
    times : array_like, shape (T+1,), optional
    label, color, linestyle : str
    band : float
        Half width of the band in posterior standard deviations; 0 for none.

    Returns
    -------
    matplotlib.lines.Line2D

    Raises
    ------
    ValueError
        If the track holds several runs.

    Examples
    --------
    >>> import pfedu
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures import plot_track
    >>> track = pfedu.kalman_filter(pfedu.models.random_walk(), [[0.0], [1.0]])
    >>> plot_track(Figure().subplots(), track, label="Kalman").get_label()
    'Kalman'
    """
    if track.mean.ndim != 2:
        raise ValueError(f"plot_track draws one run, the track has means of shape {track.mean.shape}")
    mean, sd = track.mean[:, state], track.sd[:, state]
    t = _times(times, mean)
    if band:
        ax.fill_between(t, mean - band * sd, mean + band * sd, color=color, alpha=0.18, lw=0)
    return ax.plot(t, mean, color=color, ls=linestyle, lw=1.6, label=label)[0]


def _times(times, rows):
    return np.arange(len(rows)) if times is None else times
