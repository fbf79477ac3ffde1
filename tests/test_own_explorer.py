"""The page on explorers of one's own: its code is that of the file, and an explorer made in a notebook is live."""

import ast
import base64
import html
import io
import json
import re
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from PIL import Image

from pfedu.explorers import five
from pfedu.explorers.stage import Stage
from pfedu.figures import COLORS
from pfedu.gaussian import log_density
from pfedu.live import explore
from pfedu.live.picture import small_png
from pfedu.weights import effective_sample_size

ROOT = Path(__file__).parents[1]
CELLS = json.loads((ROOT / "book/your-own-explorer.ipynb").read_text(encoding="utf-8"))["cells"]
CODE = ["".join(cell["source"]) for cell in CELLS if cell["cell_type"] == "code"]


def pieces(*sources):
    """What code defines: name to syntax tree, as text."""
    found = {}
    for node in (node for source in sources for node in ast.parse(source).body):
        if isinstance(node, ast.FunctionDef):
            found[node.name] = ast.dump(node)
        elif isinstance(node, ast.Assign):
            found[node.targets[0].id] = ast.dump(node.value)
    return found


def test_the_page_shows_the_code_of_the_file():
    """Catches a page that teaches one thing and runs another; the file has a puzzle more."""
    page, file = pieces(*CODE), pieces(Path(five.__file__).read_text(encoding="utf-8"))
    for name in ("STATES", "build", "update"):
        assert page[name] == file[name], name
    assert page["EXPLORER"].removesuffix("])") in file["EXPLORER"]


def test_it_is_about_twenty_lines():
    """Catches an example that has grown: lines within the two functions, docstrings and legends aside."""
    tree = ast.parse(Path(five.__file__).read_text(encoding="utf-8"))
    statements = [node for f in tree.body if isinstance(f, ast.FunctionDef) for node in f.body[1:]]
    assert len(statements) <= 20


def test_an_explorer_made_in_a_notebook_is_live():
    """Catches an object that is taken for a name, and controls that are not wired to it."""
    host = explore(five.EXPLORER, r=0.1)
    assert host.explorer is five.EXPLORER and host.params["r"] == 0.1
    before = host.image.value
    host.controls["r"].value = 10.0
    assert host.image.value != before and "With r = 10 " in host.sentence.value
    host.controls["particles"].click()
    assert host.controls["particles"].value == 2
    with pytest.raises(ValueError, match="no control 'q'"):
        explore(five.EXPLORER, q=1.0)


def test_elsewhere_it_is_a_picture_with_words():
    """Catches a place-holder that no page can fill: the built page shows picture and sentence instead."""
    host = explore(five.EXPLORER, y=-2.0)
    bundle = host._repr_mimebundle_()
    assert bundle["text/plain"] == "explore(Explorer('The weights of five particles'), y=-2.0)"
    assert "pfedu-explorer-here" not in bundle["text/html"]
    assert "application/vnd.jupyter.widget-view+json" in bundle
    picture, words = re.search(r'base64,([^"]+)" alt="([^"]+)"', bundle["text/html"]).groups()
    pixels, shown = Stage(five.EXPLORER).draw(five.EXPLORER.check({"y": -2.0}))
    assert html.unescape(words) == shown.sentence
    wanted = Image.open(io.BytesIO(small_png(pixels))).convert("RGB")
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB")), wanted)


def test_the_exact_mean_is_exact():
    """Catches a wrong conjugate formula: mean of prior times likelihood, by a sum over a fine grid."""
    x = np.linspace(-12, 12, 200_001)
    for y, r in ((-3.0, 0.01), (1.0, 1.0), (2.0, 10.0)):
        weight = np.exp(-0.5 * x**2 - 0.5 * (y - x) ** 2 / r)
        _, shown = Stage(five.EXPLORER, dpi=40).draw(five.EXPLORER.check({"y": y, "r": r}))
        assert shown.numbers["exact mean"] == pytest.approx(weight @ x / weight.sum(), abs=1e-6)


def test_the_callback_of_interact(monkeypatch):
    """Catches a plain example that computes something else than the package: N_eff of the same five particles."""
    monkeypatch.setattr(plt, "show", plt.close)
    source = next(code for code in CODE if "def weights_of_five" in code).removesuffix("weights_of_five()")
    scope = {"np": np, "plt": plt, "COLORS": COLORS}
    exec(compile(source, "your-own-explorer.ipynb", "exec"), scope)
    for y, r, seed in ((1.0, 0.1, 1), (-2.0, 0.5, 7), (3.0, 2.0, 100)):
        x = np.random.default_rng(seed).standard_normal((5, 1))
        wanted = float(effective_sample_size(log_density(y - x, 0.0, r)))
        assert scope["weights_of_five"](y, r, seed) == pytest.approx(wanted, abs=0.006)
