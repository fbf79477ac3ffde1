"""A wrong version beside the right one: over time, averaged over runs, against N, and copy by copy."""

import numpy as np

from pfedu.figures.style import COLORS

RIGHT = dict(color=COLORS["particles"], marker="o")
WRONG = dict(color=COLORS["third"], marker="^", ls="--")


def plot_beside(ax, exact, right, wrong, *, band=2.0):
    """Draw the exact mean and its band over time, and the means of a right and a wrong filter in them.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    exact : pfedu.Track
        Of one run with one state.
    right, wrong : array_like, shape (T+1,)
        Posterior means; NaN leaves a gap.
    band : float
        Half width of the band in exact standard deviations.

    Returns
    -------
    list of matplotlib.lines.Line2D
        Exact, right, wrong.

    Examples
    --------
    >>> import pfedu
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures.faults import plot_beside
    >>> exact = pfedu.kalman_filter(pfedu.models.random_walk(), [[0.0], [1.0]])
    >>> [line.get_label() for line in plot_beside(Figure().subplots(), exact, [0, 1], [0, 2])]
    ['exact', 'right', 'wrong']
    """
    mean, sd = exact.mean[:, 0], exact.sd[:, 0]
    t = np.arange(mean.size)
    ax.fill_between(t, mean - band * sd, mean + band * sd, color=COLORS["exact"], alpha=0.18, lw=0)
    lines = ax.plot(t, mean, "-.", color=COLORS["exact"], lw=1.6, label="exact")
    lines += ax.plot(t, right, ms=3, lw=1.2, label="right", **RIGHT)
    lines += ax.plot(t, wrong, ms=4, lw=1.2, label="wrong", **WRONG)
    ax.set(xlabel="time k", ylabel="posterior mean")
    return lines


def plot_deviation(ax, exact, right, wrong):
    """Draw what is left of the error when many runs of one record are averaged: noise goes, a fault stays.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    exact : pfedu.Track
        Of the record; one state.
    right, wrong : array_like, shape (runs, T+1)
        Posterior means. Their average is drawn relative to the exact mean, with two standard errors, over a band of
        one exact standard deviation to either side.

    Returns
    -------
    float
        Largest average deviation of the wrong means.

    Examples
    --------
    >>> import pfedu
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures.faults import plot_deviation
    >>> exact = pfedu.kalman_filter(pfedu.models.random_walk(), [[0.0], [0.0]])
    >>> plot_deviation(Figure().subplots(), exact, [[0, 0], [0, 0]], [[0, 1], [0, 3]])
    2.0
    """
    mean, sd = exact.mean[:, 0], exact.sd[:, 0]
    t = np.arange(mean.size)
    ax.fill_between(t, -sd, sd, color=COLORS["exact"], alpha=0.15, lw=0)
    ax.plot(t, np.zeros(t.size), "-.", color=COLORS["exact"], lw=1.6, label="exact")
    for means, label, look in ((right, "right", RIGHT), (wrong, "wrong", WRONG)):
        off = np.asarray(means) - mean
        bars = 2 * off.std(axis=0, ddof=1) / np.sqrt(len(off))
        ax.errorbar(t, off.mean(axis=0), bars, ms=4, lw=1, capsize=2, label=label, **look)
    ax.set(xlabel="time k", ylabel="average − exact mean")
    return float(np.abs(off.mean(axis=0)).max())


def plot_rates(ax, sizes, right, wrong):
    r"""Draw errors against the number of particles with two standard errors, and a line that falls as 1/sqrt(N).

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    sizes : sequence of int, length m
        Numbers of particles.
    right, wrong : array_like, shape (m, runs)
        An error for each run.

    Returns
    -------
    list of float
        Mean errors of the wrong version relative to those of the right one, one a size.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures.faults import plot_rates
    >>> errors = np.array([[0.3, 0.5], [0.1, 0.3]])
    >>> plot_rates(Figure().subplots(), [100, 400], errors, 2 * errors)
    [2.0, 2.0]
    """
    right, wrong = np.asarray(right), np.asarray(wrong)
    for values, label, look in ((right, "right", RIGHT), (wrong, "wrong", WRONG)):
        bars = 2 * values.std(axis=-1, ddof=1) / np.sqrt(values.shape[-1])
        ax.errorbar(sizes, values.mean(axis=-1), bars, ms=5, lw=1.2, capsize=3, label=label, **look)
    mean = right.mean(axis=-1)
    ax.plot(sizes, mean[0] * np.sqrt(sizes[0] / np.asarray(sizes)), ":", color=COLORS["truth"], label=r"$1/\sqrt{N}$")
    ax.set(xscale="log", yscale="log", xlabel="number of particles N", ylabel="RMS distance from exact")
    ax.set_xticks(sizes, labels=[str(n) for n in sizes])
    ax.set_xticks([], minor=True)
    low, high = ax.get_ylim()
    ticks = [tick for tick in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0) if low < tick < high]
    ax.set_yticks(ticks, labels=[f"{tick:g}" for tick in ticks])
    ax.set_yticks([], minor=True)
    return (wrong.mean(axis=-1) / mean).tolist()


def plot_copies(ax, owed, right, wrong):
    """Draw the mean number of copies of each particle, expected and found, with two standard errors.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    owed : array_like, shape (N,)
        Expected copies.
    right, wrong : array_like, shape (draws, N)
        Copies of each particle in many resamplings.

    Returns
    -------
    list of str
        What the legend says.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures.faults import plot_copies
    >>> plot_copies(Figure().subplots(), [1.5, 0.5], [[1, 1], [2, 0]], [[2, 0], [2, 0]])
    ['expected', 'right', 'wrong']
    """
    i = np.arange(1, len(owed) + 1)
    ax.bar(i, owed, width=0.8, color=COLORS["exact"], alpha=0.25, hatch="//", edgecolor="white", label="expected")
    for values, label, shift, look in ((right, "right", -0.15, RIGHT), (wrong, "wrong", 0.15, WRONG)):
        values = np.asarray(values)
        bars = 2 * values.std(axis=0, ddof=1) / np.sqrt(len(values))
        ax.errorbar(i + shift, values.mean(axis=0), bars, ms=5, capsize=3, label=label, **(look | {"ls": "none"}))
    ax.set(xlabel="particle", ylabel="mean copies", xticks=i, ylim=(-0.15, None))
    return ax.get_legend_handles_labels()[1]
