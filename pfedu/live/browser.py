"""Explorers in the page: what the worker's Python does with a position of the controls."""

import json
from functools import cache

import numpy as np

from pfedu.explorers import load
from pfedu.explorers.stage import Stage


@cache
def _stage(name, layout):
    return Stage(load(name), layout)


def render(name, layout, positions):
    """Draw an explorer.

    Parameters
    ----------
    name : str
    layout : str
        ``"wide"`` or ``"narrow"``.
    positions : str
        JSON object, the position of each control in its list of values.

    Returns
    -------
    pixels : ndarray of uint8, shape (height, width, 4)
    words : str
        JSON object with ``sentence``, ``numbers`` and ``solved``, which of its puzzles.

    Examples
    --------
    >>> from pfedu.live.browser import render
    >>> pixels, words = render("sir", "narrow", '{"k": 3}')
    >>> "At step 3" in json.loads(words)["sentence"]
    True
    """
    stage = _stage(name, layout)
    controls = {control.name: control for control in stage.explorer.controls}
    params = {key: controls[key].values[position] for key, position in json.loads(positions).items()}
    params = stage.explorer.check(params)
    pixels, shown = stage.draw(params)
    words = {"sentence": shown.sentence, "numbers": shown.numbers, "solved": stage.explorer.solved(params, shown)}
    return np.ascontiguousarray(pixels), json.dumps(words)
