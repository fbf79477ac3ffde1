"""Explorers in Jupyter: ipywidgets made from the declared controls, the picture in place."""

import asyncio
import base64
import html
import json

import ipywidgets as widgets
import traitlets

from pfedu.explorers import Choice, Explorer, Seed, load
from pfedu.explorers.stage import Stage
from pfedu.live.picture import quick_png, small_png

_WAIT = 0.02  # seconds in which further moves of a slider are taken together


class JupyterExplorer(widgets.VBox):
    """An explorer as a widget.

    The picture is one image whose bytes change, so nothing flickers; moves that arrive together are
    answered once, for the newest position.

    Parameters
    ----------
    explorer : str or pfedu.explorers.Explorer
        Name of an explorer, or one made in the notebook.
    **start
        Where controls start, if not at their defaults.

    Attributes
    ----------
    shown : pfedu.explorers.Shown
        Sentence and numbers of the last redraw.

    Examples
    --------
    >>> from pfedu.live.jupyter import JupyterExplorer
    >>> explorer = JupyterExplorer("sir", N=100)
    >>> explorer.controls["N"].value = 50
    >>> explorer.shown.sentence.startswith("Growth model, N = 50")
    True
    """

    def __init__(self, explorer, **start):
        self.name, self.start = (None if isinstance(explorer, Explorer) else explorer), start
        self.explorer = load(explorer) if self.name is not None else explorer
        params = self.explorer.check(start)
        self._stage = Stage(self.explorer)
        self._waiting = None
        self.controls = {control.name: _widget(control, params[control.name]) for control in self.explorer.controls}
        self.image = widgets.Image(format="png", layout={"max_width": "100%", "width": "760px"})
        self.sentence = widgets.HTML()
        self.puzzles = [widgets.HTML() for _ in self.explorer.puzzles]
        self._solved = set()
        for widget in self.controls.values():
            widget.observe(self._moved, "value")
        boxes = [box for control in self.explorer.controls for box in _play(control, self.controls[control.name])]
        panel = widgets.Box(boxes, layout={"flex_flow": "row wrap", "max_width": "800px"})
        super().__init__([self.image, self.sentence, panel, *self.puzzles])
        self.redraw()

    @property
    def params(self):
        """The value of each control."""
        return {name: widget.value for name, widget in self.controls.items()}

    def redraw(self):
        """Draw the explorer where its controls stand now."""
        self._waiting = None
        try:
            pixels, self.shown = self._stage.draw(self.params)
        except Exception as error:
            self.sentence.value = f"<p><b>Not redrawn:</b> {html.escape(f'{type(error).__name__}: {error}')}</p>"
            return
        self.image.value = quick_png(pixels)
        self.image.alt_text = self.shown.sentence
        self.sentence.value = f"<p>{html.escape(self.shown.sentence)}</p>"
        self._check_puzzles()

    def _check_puzzles(self):
        """Mark what is solved; a puzzle stays solved wherever the controls go next."""
        solved = self.explorer.solved(self.params, self.shown)
        self._solved |= {i for i, done in enumerate(solved) if done}
        for i, (puzzle, line) in enumerate(zip(self.explorer.puzzles, self.puzzles, strict=True)):
            mark = "✓ Solved" if i in self._solved else "Puzzle"
            line.value = f"<p><b>{mark}:</b> {html.escape(puzzle.text)}</p>"

    def _moved(self, _change):
        try:
            loop = asyncio.get_running_loop()
        except RuntimeError:  # no loop, as in a script: answer at once
            self.redraw()
            return
        if self._waiting is None:
            self._waiting = loop.call_later(_WAIT, self.redraw)

    def __repr__(self):
        what = repr(self.name) if self.name is not None else f"Explorer({self.explorer.title!r})"
        return f"explore({', '.join([what, *(f'{k}={v!r}' for k, v in self.start.items())])})"

    def _repr_mimebundle_(self, **kwargs):
        """Widget for Jupyter; a place-holder that the built page replaces; a line of text elsewhere."""
        bundle = super()._repr_mimebundle_(**kwargs)
        here = self._still() if self.name is None else self._place()
        return bundle | {"text/plain": repr(self), "text/html": here}

    def _place(self):
        """What the built page replaces by a live figure."""
        start = html.escape(json.dumps(self.start))
        return (
            f'<div class="pfedu-explorer-here" data-name="{self.name}" data-start="{start}">'
            f"<p>{html.escape(self.explorer.title)}: a figure with controls. Run the notebook to move them.</p></div>"
        )

    def _still(self):
        """A picture: no file of the package holds this explorer, so no page can run it."""
        pixels, shown = self._stage.draw(self.params)
        picture = base64.b64encode(small_png(pixels)).decode()
        words = html.escape(shown.sentence)
        return (
            f'<figure><img src="data:image/png;base64,{picture}" alt="{words}" style="max-width: 100%; width: 760px">'
            f"<figcaption><p>{words} Run the notebook to move the controls.</p></figcaption></figure>"
        )


def _widget(control, value):
    style = {"description_width": "auto"}
    if isinstance(control, Seed):
        return _SeedButton(control, value)
    options = [(control.text(v), v) for v in control.values]
    kind = widgets.Dropdown if isinstance(control, Choice) else widgets.SelectionSlider
    return kind(options=options, value=value, description=control.label, style=style, layout={"width": "380px"})


def _play(control, widget):
    """The widget of a control, with a button before it where time can run."""
    if not getattr(control, "plays", False):
        return [widget]
    button = widgets.Play(value=widget.index, max=len(control.values) - 1, interval=200, show_repeat=False)
    widgets.jslink((button, "value"), (widget, "index"))
    return [button, widget]


class _SeedButton(widgets.Button):
    """A button that steps through the seeds and round again."""

    value = traitlets.Int()

    def __init__(self, control, value):
        super().__init__(description=control.label, icon="refresh", layout={"width": "180px"}, value=value)
        values = control.values
        self.on_click(lambda _: self.set_trait("value", values[(values.index(self.value) + 1) % len(values)]))
