"""Pictures of the Bayesian recursion: a row of cells with their probabilities, and the model as a chain."""

from matplotlib.patches import Circle, Rectangle

from pfedu.figures.style import COLORS


def plot_cells(ax, p, *, doors=(), color=COLORS["exact"], hatch=""):
    """Draw the probability of each cell as a bar with its value on top; cells are numbered from 1.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    p : array_like, shape (n,)
        Probabilities.
    doors : iterable of int
        Cells that have a door, named below the axis.
    color, hatch : str

    Returns
    -------
    matplotlib.container.BarContainer

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures.recursion import plot_cells
    >>> len(plot_cells(Figure().subplots(), [0.25, 0.75], doors=[2]))
    2
    """
    cells = range(1, len(p) + 1)
    bars = ax.bar(cells, p, width=0.8, color=color, alpha=0.75, hatch=hatch, edgecolor="white")
    ax.bar_label(bars, labels=[f"{value:.2f}" for value in p], padding=2)
    ax.set_xticks(cells, [f"{i}\ndoor" if i in doors else f"{i}" for i in cells])
    ax.set(ylim=(0, 1), yticks=[0, 0.5, 1])
    ax.grid(axis="x", visible=False)
    return bars


def plot_chain(ax, n=4):
    """Draw the model as a graph: states in circles move to the right, measurements in boxes hang below them.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
    n : int
        How many times to draw, at least 2; the last one is called k.

    Returns
    -------
    list of matplotlib.text.Annotation
        The arrows.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from pfedu.figures.recursion import plot_chain
    >>> len(plot_chain(Figure().subplots(), n=3))
    6
    """
    names = [f"k-{n - 1 - i}" if i < n - 1 else "k" for i in range(n)]
    ends = [((2 * i + 0.5, 1.6), (2 * i + 1.5, 1.6)) for i in range(-1, n - 1)]  # along the chain
    ends += [((2 * i, 1.1), (2 * i, 0.42)) for i in range(n)]  # down to the measurements
    for i, name in enumerate(names):
        ax.add_patch(Circle((2 * i, 1.6), 0.47, fc="white", ec=COLORS["particles"], lw=2))
        ax.add_patch(Rectangle((2 * i - 0.42, -0.42), 0.84, 0.8, fc="#eeeeee", ec=COLORS["measurement"], lw=2))
        ax.text(2 * i, 1.6, f"$x_{{{name}}}$", ha="center", va="center", fontsize=13)
        ax.text(2 * i, -0.02, f"$y_{{{name}}}$", ha="center", va="center", fontsize=13)
    ax.set(xlim=(-2, 2 * n - 1), ylim=(-0.6, 2.6), aspect="equal")
    ax.axis("off")
    look = dict(arrowstyle="-|>", lw=1.6, color=COLORS["truth"], shrinkA=0, shrinkB=0)
    return [ax.annotate("", head, tail, arrowprops=look) for tail, head in ends]
