"""What an explorer is."""

from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Shown:
    """What a redraw says in words and numbers.

    Attributes
    ----------
    sentence : str
        What the picture now shows; it is the caption and the text for those who cannot see it.
    numbers : dict of str to float
        The figures behind it, in the order in which a table lists them.
    """

    sentence: str
    numbers: dict = field(default_factory=dict)


@dataclass(frozen=True)
class Puzzle:
    """A task for the reader that the explorer itself checks.

    Attributes
    ----------
    text : str
        What is to be found; a sentence in the imperative.
    solved : callable
        ``(params, numbers) -> bool``: whether it is found where the controls stand now.
    answer : dict
        Controls, moved from their defaults, that solve it; shown to nobody, it proves that there is one.
    """

    text: str
    solved: Callable
    answer: dict


@dataclass(frozen=True)
class Explorer:
    """A figure with controls.

    Attributes
    ----------
    title : str
        A short name, the label of the whole figure.
    controls : tuple of Control
    layouts : dict
        ``{"wide": (size, mosaic), "narrow": (size, mosaic)}``: figure size in inches and the
        mosaic of named axes (as in ``Figure.subplot_mosaic``) for a desk and for a phone.
    build : callable
        ``(axes) -> artists``: given the named axes, draw what stays, and return a dict of the
        artists that will change.
    update : callable
        ``(artists, axes, **params) -> Shown``: give the artists new data.
    also : tuple of dict
        Combinations that the text asks for, drawn beforehand beside each control moved alone.
    puzzles : tuple of Puzzle
        Tasks that are marked as solved when the reader gets there.

    Examples
    --------
    >>> from pfedu.explorers import Explorer, Shown, Slider
    >>> def build(axes):
    ...     axes["a"].set(xlim=(0, 1), ylim=(0, 10))
    ...     return {"line": axes["a"].plot([], [])[0]}
    >>> def update(artists, axes, slope):
    ...     artists["line"].set_data([0, 1], [0, slope])
    ...     return Shown(f"A line of slope {slope}.", {"slope": slope})
    >>> line = Explorer("A line", (Slider("slope", "slope", range(11), 5),),
    ...                 {"wide": ((4, 3), [["a"]])}, build, update)
    >>> line.defaults()
    {'slope': 5}
    """

    title: str
    controls: tuple
    layouts: dict
    build: Callable
    update: Callable
    also: tuple = ()
    puzzles: tuple = ()

    def defaults(self):
        """Where all controls start: dict of name to value."""
        return {control.name: control.default for control in self.controls}

    def check(self, params):
        """All parameters, those not given at their defaults.

        Parameters
        ----------
        params : dict

        Returns
        -------
        dict

        Raises
        ------
        ValueError
            If a name is no control or a value is no position of it.
        """
        known = {control.name: control for control in self.controls}
        for name, value in params.items():
            if name not in known:
                raise ValueError(f"no control {name!r}: there are {', '.join(known)}")
            if value not in known[name].values:
                raise ValueError(f"control {name!r} has no position {value!r}: choose one of {known[name].values}")
        own = {name: known[name].values[known[name].values.index(value)] for name, value in params.items()}
        return self.defaults() | own  # the control's own value: 500, where 500.0 was given

    def solved(self, params, shown):
        """Which puzzles are solved at these parameters: list of bool, one a puzzle."""
        return [bool(puzzle.solved(params, shown.numbers)) for puzzle in self.puzzles]

    def beforehand(self, start):
        """Yield what is drawn before Python is up: the start, each control moved alone, and ``also``.

        Parameters
        ----------
        start : dict
            A value for each control.

        Yields
        ------
        dict
            A value for each control; the first is the start, and none comes twice.
        """
        alone = ({control.name: value} for control in self.controls for value in control.frames())
        seen = []
        for moved in ({}, *alone, *self.also):
            params = start | moved
            if params not in seen:
                seen.append(params)
                yield params

    def key(self, start, params):
        """Name of what is shown at ``params``: the moved controls and their positions, or ``start``.

        Examples
        --------
        >>> from pfedu.explorers import load
        >>> sir = load("sir")
        >>> sir.key(sir.defaults(), sir.check({"N": 10, "particles": 3}))
        'N-0-particles-2'
        """
        moved = [c for c in self.controls if params[c.name] != start[c.name]]
        return "-".join(f"{c.name}-{c.values.index(params[c.name])}" for c in moved) or "start"
