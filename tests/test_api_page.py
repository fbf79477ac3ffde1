"""The reference pages of the book: built alone, with stubs for the pages around them."""

import importlib
import inspect
import os
import pkgutil
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from sphinx.util.inventory import InventoryFile

import pfedu

ROOT = Path(__file__).parents[1]
UPPER_FLOORS = {"explorers", "figures", "live"}
STUBS = {
    "notation": "(notation)=\n# Notation\n",
    "chapter": """# Chapter

{func}`pfedu.bootstrap_filter` {class}`pfedu.Track` {attr}`pfedu.Track.sd` {func}`pfedu.models.growth`
{meth}`pfedu.models.StateSpaceModel.simulate` {func}`pfedu.weights.normalize`

{func}`pfedu.no_such_filter`
""",
}


def public_modules():
    """The modules below the figures, by their full names."""
    names = [info.name for info in pkgutil.walk_packages(pfedu.__path__, "pfedu.")]
    return [name for name in names if name.split(".")[1] not in UPPER_FLOORS]


def public_names():
    """Functions and classes by their full names, each in the module that defines it."""
    for module_name in public_modules():
        for name, thing in vars(importlib.import_module(module_name)).items():
            if (inspect.isclass(thing) or inspect.isfunction(thing)) and not name.startswith("_"):
                if thing.__module__ == module_name:
                    yield f"{module_name}.{name}"


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Folder of the reference pages as HTML, and all that the build warned of."""
    here = tmp_path_factory.mktemp("reference")
    for path in ("_config.yml", "book/api.md", "book/references.bib"):
        (here / path).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / path, here / path)
    for path in ("book/api", "book/_extensions", "book/_static"):
        shutil.copytree(ROOT / path, here / path)
    for name, text in STUBS.items():
        (here / f"book/{name}.md").write_text(text, encoding="utf-8")
    pages = [f"book/{name}" for name in STUBS] + [f"book/api/{page.stem}" for page in (here / "book/api").glob("*.md")]
    (here / "_toc.yml").write_text(
        "format: jb-book\nroot: book/api\nchapters:\n" + "".join(f"  - file: {page}\n" for page in pages),
        encoding="utf-8",
    )
    done = subprocess.run(
        [sys.executable, "-c", "from jupyter_book.cli.main import main; main()", "build", "-n", "."],
        cwd=here, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(ROOT), "NO_COLOR": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    warnings = [line for line in done.stderr.splitlines() if re.search(r"WARNING|ERROR|CRITICAL", line)]
    return here / "_build/html", warnings


@pytest.fixture(scope="module")
def entries(built):
    """{kind: full names} of what has an entry."""
    with (built[0] / "objects.inv").open("rb") as file:
        found = InventoryFile.load(file, "", lambda base, path: path)
    return {kind.removeprefix("py:"): set(names) for kind, names in found.items() if kind.startswith("py:")}


def test_every_module_is_on_a_page(entries):
    """Catches a new module that nobody put on its page (and in the table of book/api.md)."""
    assert len(public_modules()) > 10
    assert set(public_modules()) - entries["module"] == set()


def test_every_module_is_in_the_table(built):
    """Catches a module that has a section on a page and no line in the overview."""
    text = (built[0] / "book/api.html").read_text(encoding="utf-8")
    assert [name for name in public_modules() if f'title="{name}"' not in text] == []


def test_every_public_name_has_one_entry(entries):
    """Catches a function that is on no page, and one that is on two because another module passes it on."""
    names = set(public_names())
    assert len(names) > 50
    assert entries["function"] | entries["class"] | entries["exception"] == names


def test_every_reference_resolves_but_the_wrong_one(built):
    """Catches a docstring that Sphinx cannot read or that leads nowhere, and a build that would not say so."""
    assert len(built[1]) == 1 and "pfedu.no_such_filter" in built[1][0], "\n".join(built[1])


@pytest.mark.parametrize(
    "target",
    [
        "api/filters.html#pfedu.filters.bootstrap.bootstrap_filter",
        "api/models.html#pfedu.track.Track",
        "api/models.html#pfedu.track.Track.sd",
        f"api/models.html#{pfedu.models.growth.__module__}.growth",
        f"api/models.html#{pfedu.models.StateSpaceModel.__module__}.StateSpaceModel.simulate",
        "api/weights.html#pfedu.weights.normalize",
    ],
)
def test_a_chapter_may_use_the_short_name(built, target):
    """Catches names of the face that lead nowhere, or to the wrong entry."""
    assert f'href="{target}"' in (built[0] / "book/chapter.html").read_text(encoding="utf-8")


def test_shapes_and_types_stand_as_they_were_written(built):
    """Catches dots that became an ellipsis, words of a type that became links, and classes that did not."""
    text = (built[0] / "book/api/weights.html").read_text(encoding="utf-8")
    assert "array_like, shape (..., N, n_x)" in text
    text = (built[0] / "book/api/exact.html").read_text(encoding="utf-8")
    assert re.search(r'class="classifier"><a [^>]*href="models.html#pfedu.models[.\w]*\.StateSpaceModel"', text)
