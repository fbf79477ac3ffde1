"""The index of equations: it lists every numbered equation, and leads to code and tests that exist."""

import ast
import json
import re
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "book" / "index-of-equations.md"
WITHOUT_TEST = {"a step of the derivation", "a cell of the chapter", "a definition", "an assumption"}


def labels_of(path):
    """Labels of the equations of one page, in order."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".ipynb":
        text = "\n".join("".join(c["source"]) for c in json.loads(text)["cells"] if c["cell_type"] == "markdown")
    return re.findall(r"\$\$[ \t]*\(([\w:.-]+)\)[ \t]*$|^:label: (eq-[\w:.-]+)", text, re.M)


def labels():
    """Labels of all equations of the book, by page."""
    pages = sorted([*(ROOT / "book").glob("*.ipynb"), *(ROOT / "book").glob("*.md")])
    return {page.stem: [a or b for a, b in labels_of(page)] for page in pages}


def rows():
    """(label, code, proof) of each row of the index."""
    text = PAGE.read_text(encoding="utf-8")
    for row in re.findall(r"^\| (\{eq\}.*) \|$", text, re.M):
        first, _, code, proof = (cell.strip() for cell in row.split(" | "))
        yield re.fullmatch(r"\{eq\}`([^`]+)`", first)[1], code, proof


LABELS, ROWS = labels(), list(rows())


def test_there_are_equations_and_none_is_labelled_twice():
    """Catches a search that finds nothing, after which all below would pass; a label that names two equations."""
    found = [label for page in LABELS.values() for label in page]
    assert len(found) > 150
    assert len(found) == len(set(found))


def test_every_equation_is_listed_once_and_nothing_else():
    """Catches an equation that was added, renamed or taken out after the index was written."""
    found, listed = [label for page in LABELS.values() for label in page], [label for label, _, _ in ROWS]
    assert [label for label in found if label not in listed] == [], "add a row for each to book/index-of-equations.md"
    assert [label for label in listed if label not in found] == [], "these are in no chapter any more"
    assert len(listed) == len(set(listed)), "listed twice"


@pytest.mark.parametrize("page", [page for page, found in LABELS.items() if found])
def test_the_equations_of_a_chapter_stand_in_its_order(page):
    """Catches a row in the wrong table, where no reader would look for it."""
    wanted = LABELS[page]
    assert [label for label, _, _ in ROWS if label in wanted] == wanted


def found_in_pfedu(name):
    """Whether a dotted name leads to something in the package."""
    parts = ["pfedu", *name.split(".")]
    for end in range(len(parts), 0, -1):
        try:
            thing = import_module(".".join(parts[:end]))
        except ModuleNotFoundError:
            continue
        for part in parts[end:]:
            thing = getattr(thing, part, None)
        return thing is not None


def test_the_code_exists():
    """Catches a function that was renamed or moved."""
    names = {label: re.fullmatch(r"(?:\{\w+\})?`~?(?:pfedu\.)?([\w.]+)`", code)[1] for label, code, _ in ROWS if code}
    assert len(names) > 100
    assert {label: name for label, name in names.items() if not found_in_pfedu(name)} == {}


def test_the_tests_exist():
    """Catches a test that was renamed or taken out, and words that promise less or more than the page explains."""
    proofs = {label: proof for label, _, proof in ROWS if proof not in WITHOUT_TEST}
    trees = {path.stem: ast.parse(path.read_text(encoding="utf-8")) for path in (ROOT / "tests").glob("test_*.py")}
    defined = {(file, node.name) for file, tree in trees.items() for node in tree.body if hasattr(node, "name")}
    missing = {}
    for label, proof in proofs.items():
        file, words = re.fullmatch(r"`(test_\w+)`: ([\w ]+)", proof).groups()
        if (file, "test_" + words.replace(" ", "_")) not in defined:
            missing[label] = proof
    assert missing == {}
