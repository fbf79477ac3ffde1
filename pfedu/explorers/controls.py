"""What a reader can move. Every control is a list of values and where it starts.

A slider is a list too: it stops at so many places, the same in Jupyter, in the page and in the
pictures drawn beforehand, so a position means the same everywhere.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Control:
    """A named list of values.

    Attributes
    ----------
    name : str
        The parameter it sets.
    label : str
        What the reader sees.
    values : tuple
        All positions, in order.
    default : object
        Where it starts; one of the values.
    """

    name: str
    label: str
    values: tuple
    default: object

    def __post_init__(self):
        object.__setattr__(self, "values", tuple(self.values))
        if self.default not in self.values:
            raise ValueError(f"control {self.name!r} starts at {self.default!r}, which is none of {self.values}")

    def text(self, value):
        """How a value reads."""
        return f"{value:g}" if isinstance(value, int | float) else str(value)

    def frames(self):
        """The positions that are drawn before Python is up: all of them."""
        return self.values


@dataclass(frozen=True)
class Slider(Control):
    """Positions on a line, in ascending order.

    Up to ``drawn`` positions, evenly spread and with both ends, are drawn beforehand. Where the line
    is time, ``plays=True`` puts a button beside it that lets time run.

    Examples
    --------
    >>> from pfedu.explorers import Slider
    >>> Slider("k", "time step", range(51), 25, drawn=6).frames()
    (0, 10, 20, 25, 30, 40, 50)
    """

    drawn: int = 11
    plays: bool = False

    def frames(self):
        """The positions that are drawn before Python is up, the default among them."""
        picks = np.linspace(0, len(self.values) - 1, min(self.drawn, len(self.values))).round().astype(int)
        return tuple(v for i, v in enumerate(self.values) if i in picks or v == self.default)


@dataclass(frozen=True)
class Choice(Control):
    """One of a few words.

    Examples
    --------
    >>> from pfedu.explorers import Choice
    >>> Choice("scheme", "resampling", ("systematic", "multinomial"), "systematic").frames()
    ('systematic', 'multinomial')
    """


@dataclass(frozen=True)
class Seed(Control):
    """A button that draws again: it steps through seeds 1 to ``len(values)`` and round again.

    Examples
    --------
    >>> from pfedu.explorers import Seed
    >>> Seed("data", "new data", drawn=3).frames()
    (1, 2, 3)
    """

    values: tuple = tuple(range(1, 101))
    default: object = 1
    drawn: int = 6

    def frames(self):
        """The first few seeds."""
        return self.values[: self.drawn]


def geometric(low, high, count):
    """Round numbers evenly spread on a logarithmic scale, to two digits.

    Parameters
    ----------
    low, high : float
        Both ends, both among the values.
    count : int
        How many values; fewer where rounding makes two equal.

    Returns
    -------
    tuple
        Whole numbers where all are 10 or more, else floats.

    Examples
    --------
    >>> from pfedu.explorers.controls import geometric
    >>> geometric(10, 1000, 5)
    (10, 32, 100, 320, 1000)
    """
    values = [low, *(float(f"{v:.2g}") for v in np.geomspace(low, high, count)[1:-1]), high]
    kind = int if low >= 10 else float
    return tuple(dict.fromkeys(kind(v) for v in values))
