"""A function fits on a screen: the book's reader holds the page in one hand and the file in the other."""

import ast
import statistics
from pathlib import Path

import pytest

import pfedu

PACKAGE = Path(pfedu.__file__).parent
LONGEST, MEDIAN = 35, 12


def functions():
    """Lines of code of every function of the package, without its docstring, by file and name."""
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                lines = node.end_lineno - node.lineno + 1
                if ast.get_docstring(node) is not None:
                    lines -= node.body[0].end_lineno - node.body[0].lineno + 1
                yield f"{path.relative_to(PACKAGE)}:{node.name}", lines


LENGTHS = dict(functions())


def test_the_walk_finds_the_functions():
    """Catches a walk over nothing, after which the tests below would pass."""
    assert "filters/loop.py:particle_filter" in LENGTHS and len(LENGTHS) > 200


def test_no_function_is_longer_than_a_screen():
    """Catches an algorithm that cannot be seen whole."""
    assert {name: n for name, n in LENGTHS.items() if n > LONGEST} == {}


def test_most_functions_are_short():
    """Catches a slow drift: the median over all functions of the package."""
    assert statistics.median(LENGTHS.values()) <= MEDIAN


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_a_file_is_a_room(path):
    """Catches a file that has become a house."""
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 700
