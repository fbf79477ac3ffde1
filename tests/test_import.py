"""Importing the package: what it pulls in, and that its rooms are stacked one way."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import pfedu

PACKAGE = Path(pfedu.__file__).parent

# Lowest floor first; a room imports from lower floors, or from rooms named before it on its own.
FLOORS = ["weights", "gaussian", "resampling", "models", "importance", "dimension", "track", "grid", "kalman",
          "unscented", "filters", "particle_filter", "smoothing", "pmmh", "adaptive",
          "studies", "checks", "data"]  # fmt: skip
UPPER = ["figures", "explorers", "live"]


@pytest.fixture(scope="module")
def imported():
    """Top-level modules that importing the package adds to those of numpy, in a fresh interpreter."""
    code = (
        "import sys, numpy; before = set(sys.modules); import pfedu;"
        "print(*sorted({name.split('.')[0] for name in set(sys.modules) - before}))"
    )
    return set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split())


def test_importing_needs_numpy_alone(imported):
    """Catches an import at the top of a module that the page (numpy only) cannot satisfy, or that costs a second."""
    assert "pfedu" in imported  # else this test shows nothing
    assert imported - set(sys.stdlib_module_names) - {"numpy"} == {"pfedu"}


@pytest.mark.parametrize("heavy", ["scipy", "matplotlib", "ipywidgets", "IPython"])
def test_importing_pulls_in_nothing_heavy(heavy):
    """Catches a heavy import that numpy itself or a start-up file would hide from the test above."""
    code = f"import pfedu, sys; sys.exit({heavy!r} in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_figures_and_their_hosts_are_not_imported():
    """Catches `from pfedu import figures` in the package's own front door."""
    code = f"import pfedu, sys; print([m for m in {UPPER!r} if 'pfedu.' + m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


def imports_of(path):
    """Modules of the package that a source file imports, by the name of their room."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names = [f"pfedu.{a.name}" for a in node.names] if node.module == "pfedu" else [node.module]
        yield from (name.split(".")[1] for name in names if name.startswith("pfedu."))


@pytest.mark.parametrize("room", FLOORS)
def test_imports_run_one_way(room):
    """Catches a circle, and a filter that draws."""
    path = PACKAGE / f"{room}.py"
    files = [path] if path.exists() else sorted((PACKAGE / room).glob("*.py"))
    assert files
    below = {*FLOORS[: FLOORS.index(room)], room}
    for file in files:
        assert set(imports_of(file)) <= below, file.name


def test_the_face_is_complete():
    """Catches a promised name that is missing, or one that leads nowhere."""
    filters = {"bootstrap", "optimal", "auxiliary", "regularized", "local_linear", "kalman_bank", "rao_blackwellized",
               "kalman", "extended_kalman", "unscented_kalman", "grid"}  # fmt: skip
    promised = {f"{name}_filter" for name in filters} | {"ParticleFilter", "Track", "models", "resampling", "weights"}
    assert promised <= set(pfedu.__all__)
    assert all(getattr(pfedu, name) is not None for name in pfedu.__all__)
    assert sorted(pfedu.__all__) == pfedu.__all__


def test_errors_are_of_the_usual_kinds():
    """Catches an `except ValueError` or `except ArithmeticError` in a reader's code that no longer works."""
    assert issubclass(pfedu.GridError, ValueError)
    assert issubclass(pfedu.MissingPieceError, TypeError)
    assert issubclass(pfedu.ZeroLikelihoodError, ArithmeticError)
