"""One palette and one look for every picture of the book.

The colours are those of Okabe and Ito (2008), which readers with any of the common kinds of colour
blindness can tell apart; every use of them is doubled by a marker or a line style.
"""

import matplotlib as mpl

COLORS = {
    "truth": "#000000",
    "measurement": "#666666",
    "exact": "#D55E00",
    "particles": "#0072B2",
    "second": "#009E73",
    "third": "#CC79A7",
    "light": "#56B4E9",
    "accent": "#E69F00",
}

STYLE = {
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "figure.constrained_layout.use": True,
    "figure.dpi": 100,
    "figure.facecolor": "white",
    "font.size": 10,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "savefig.facecolor": "white",
}


def use_style():
    """Set the look of the book for all figures made from here on.

    Examples
    --------
    >>> from pfedu.figures import use_style
    >>> use_style()
    """
    mpl.rcParams.update(STYLE)
