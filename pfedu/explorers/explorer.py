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
        return self.defaults() | params

    def moved_alone(self, params):
        """Each control moved alone from ``params``: yields (name, value, params)."""
        for control in self.controls:
            for value in dict.fromkeys((*control.frames(), params[control.name])):
                yield control.name, value, params | {control.name: value}
