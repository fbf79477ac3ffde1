"""The hosts of explorers: ipywidgets in Jupyter, the worker's Python, and the figures of the built page."""

import asyncio
import io
import json
import threading
import zipfile

import nbformat
import numpy as np
import pytest
from nbformat.v4 import new_code_cell, new_notebook
from PIL import Image

from pfedu.explorers import Seed, load, names
from pfedu.explorers.stage import Stage
from pfedu.live import explore
from pfedu.live.browser import render
from pfedu.live.page import _HERE, _draw_layout, _zip_package, source_digest
from pfedu.live.picture import quick_png, small_png


def _picture(png):
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


@pytest.mark.parametrize("name", names())
def test_jupyter_moves_every_control(name):
    """A control that is not wired to the picture."""
    host = explore(name)
    for control in host.explorer.controls:
        before, sentence = host.image.value, host.shown
        widget = host.controls[control.name]
        if isinstance(control, Seed):
            widget.click()
            assert widget.value == control.values[control.values.index(control.default) + 1]
        else:
            widget.value = next(v for v in reversed(control.values) if v != widget.value)
        assert (host.image.value, host.shown) != (before, sentence), f"{control.name} did nothing"
        widget.value = control.default


def test_jupyter_lets_time_run():
    """A play button that is tied to nothing, or to the wrong end."""
    host = explore("sir")
    play = next(w for box in host.children for w in getattr(box, "children", ()) if hasattr(w, "playing"))
    assert (play.value, play.max) == (host.controls["k"].index, len(host.controls["k"].options) - 1)
    host.controls["k"].index = 7  # what the front end does with the button's value
    assert "At step 7" in host.shown.sentence


def test_jupyter_marks_a_puzzle_as_solved_and_keeps_the_mark():
    name = next(name for name in names() if load(name).puzzles)
    host, puzzle = explore(name), load(name).puzzles[0]
    assert "Puzzle" in host.puzzles[0].value
    for control, value in puzzle.answer.items():
        host.controls[control].value = value
    assert "Solved" in host.puzzles[0].value and puzzle.text.split()[0] in host.puzzles[0].value
    for control in puzzle.answer:
        host.controls[control].value = load(name).defaults()[control]
    assert "Solved" in host.puzzles[0].value


def test_jupyter_draws_what_the_stage_draws():
    host = explore("sir", N=100, model="random walk")
    pixels, shown = Stage(load("sir")).draw(load("sir").check({"N": 100, "model": "random walk"}))
    assert host.shown == shown and shown.sentence in host.sentence.value
    np.testing.assert_array_equal(_picture(host.image.value), pixels[..., :3])
    assert host.image.alt_text == shown.sentence


def test_jupyter_seed_goes_round():
    host = explore("sir", particles=100)
    host.controls["particles"].click()
    assert host.controls["particles"].value == 1


def test_jupyter_takes_moves_together_and_newest_wins():
    """A queue of redraws that runs behind the hand."""
    host, drawn = explore("sir"), []
    plain = host._stage.draw
    host._stage.draw = lambda params: drawn.append(params["k"]) or plain(params)

    async def drag():
        for k in range(20):
            host.controls["k"].value = k
        await asyncio.sleep(0.2)

    thread = threading.Thread(target=lambda: asyncio.run(drag()))
    thread.start()
    thread.join()
    assert drawn == [19]


def test_jupyter_error_keeps_the_last_picture_and_goes_on():
    host = explore("sir")
    picture, plain = host.image.value, host._stage.draw

    def broken(params):
        raise FloatingPointError("broken on purpose")

    host._stage.draw = broken
    host.controls["k"].value = 3
    assert host.image.value == picture
    assert "Not redrawn" in host.sentence.value and "broken on purpose" in host.sentence.value
    host._stage.draw = plain
    host.controls["k"].value = 4
    assert "At step 4" in host.sentence.value


def test_jupyter_bundle_is_the_same_every_time():
    """Outputs with object ids, which no notebook comparison survives."""
    one, two = (explore("sir", N=100)._repr_mimebundle_() for _ in range(2))
    assert one["text/plain"] == two["text/plain"] == "explore('sir', N=100)"
    assert one["text/html"] == two["text/html"]
    assert _HERE.search(one["text/html"])["name"] == "sir"
    assert "application/vnd.jupyter.widget-view+json" in one


def test_explore_refuses_unknown_names():
    with pytest.raises(ValueError, match="no explorer 'sr': there are"):
        explore("sr")
    with pytest.raises(ValueError, match="no position 11"):
        explore("sir", N=11)


def test_worker_draws_what_the_stage_draws():
    """The page's Python and the native one take the same road."""
    explorer = load("sir")
    positions = {c.name: len(c.values) // 2 for c in explorer.controls}
    pixels, words = render("sir", "narrow", json.dumps(positions))
    params = {c.name: c.values[positions[c.name]] for c in explorer.controls}
    again, shown = Stage(explorer, "narrow").draw(params)
    np.testing.assert_array_equal(pixels, again)
    solved = explorer.solved(params, shown)
    assert json.loads(words) == {"sentence": shown.sentence, "numbers": shown.numbers, "solved": solved}


def test_frames_are_of_the_position_they_are_named_for(tmp_path):
    """Frames mixed up: the first drag would show another position's picture."""
    drawn, explorer = _draw_layout("sir", {"N": 100}, tmp_path, "wide"), load("sir")
    start, stage = explorer.check({"N": 100}), Stage(explorer, "wide")
    for moved in ({}, {"k": 50}, {"scheme": "residual"}, {"N": 10}, {"model": "random walk", "r": 20.0}):
        key = explorer.key(start, start | moved)
        pixels, shown = stage.draw(start | moved)
        assert drawn["frames"][key] == (shown.sentence, shown.numbers, explorer.solved(start | moved, shown))
        saved = (tmp_path / f"wide-{key}.png").read_bytes()
        np.testing.assert_array_equal(_picture(saved), _picture(small_png(pixels)))
    for control in explorer.controls:  # a first drag finds a frame wherever it goes, both ends included
        ends = {0, 1} if isinstance(control, Seed) else {0, len(control.values) - 1}
        for end in ends - {control.values.index(start[control.name])}:
            assert f"{control.name}-{end}" in drawn["frames"]


def test_pictures_keep_their_pixels():
    pixels = np.zeros((30, 40, 4), np.uint8)
    pixels[5:, :, 0], pixels[..., 3] = 200, 255
    np.testing.assert_array_equal(_picture(quick_png(pixels)), pixels[..., :3])
    assert np.abs(_picture(small_png(pixels)).astype(int) - pixels[..., :3]).max() < 8


def test_package_archive_is_reproducible_and_complete(tmp_path):
    """The page's Python runs another pfedu than the one tested here."""
    for name in ("a.zip", "b.zip"):
        _zip_package(tmp_path / name)
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    inside = zipfile.ZipFile(tmp_path / "a.zip").namelist()
    assert {"pfedu/__init__.py", "pfedu/explorers/sir.py", "pfedu/live/browser.py", "pfedu/data/nile.csv"} <= set(
        inside
    )


def test_notebooks_are_executed_once_and_one_that_fails_is_left_to_the_build(tmp_path):
    """A cache that holds what was never run, or that misses what was."""
    from jupyter_cache import get_cache

    from pfedu.live.execute import execute_into_cache

    paths = [tmp_path / "right.ipynb", tmp_path / "wrong.ipynb"]
    for path, source in zip(paths, ("print(6 * 7)", "1 / 0"), strict=True):
        notebook = new_notebook(cells=[new_code_cell(source)])
        notebook.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3", "language": "python"}
        nbformat.write(notebook, path)
    execute_into_cache(paths, tmp_path / "cache")
    cache = get_cache(tmp_path / "cache")
    right, wrong = (nbformat.read(path, 4) for path in paths)
    assert cache.merge_match_into_notebook(right)[1].cells[0].outputs[0].text == "42\n"
    with pytest.raises(KeyError):
        cache.match_cache_notebook(wrong)


def test_digest_follows_the_source():
    assert source_digest() == source_digest() != source_digest("explorers")
