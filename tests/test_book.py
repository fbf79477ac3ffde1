"""The notebooks as files: executed, tagged rightly, with words for every picture, and short cells."""

import re
import subprocess
from pathlib import Path

import nbformat
import pytest
import yaml

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "book").glob("*.ipynb"))
TAGS = {"hide-input", "hide-output", "hide-cell", "remove-input", "remove-output", "remove-cell", "raises-exception",
        "full-width", "margin", "scroll-output", "nbval-ignore-output", "nbval-raises-exception"}  # fmt: skip


def _cells(path, kind="code"):
    return [(i, c) for i, c in enumerate(nbformat.read(path, 4).cells) if c.cell_type == kind and c.source.strip()]


def test_there_are_notebooks_and_all_are_in_the_table_of_contents():
    contents = (ROOT / "_toc.yml").read_text(encoding="utf-8")
    assert len(NOTEBOOKS) >= 2
    for page in [*NOTEBOOKS, *(ROOT / "book").glob("*.md")]:
        assert f"book/{page.stem}\n" in contents, f"{page.name} is in no part of the book"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_every_cell_was_executed_without_error(path):
    """nbval says nothing about cells that were never run."""
    for i, cell in _cells(path):
        assert cell.execution_count is not None, f"cell {i} was never executed"
        wanted = "raises-exception" in cell.metadata.get("tags", [])
        errors = [out for out in cell.outputs if out.output_type == "error"]
        assert bool(errors) == wanted, (
            f"cell {i} holds an error" if errors else f"cell {i} promises an error and has none"
        )


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_executed_in_order(path):
    """Outputs of cells run out of order cannot be trusted."""
    counts = [cell.execution_count for _, cell in _cells(path)]
    assert counts == list(range(1, len(counts) + 1))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_tags_are_spelt_right(path):
    """A misspelt tag is ignored without a word."""
    for i, cell in enumerate(nbformat.read(path, 4).cells):
        assert set(cell.metadata.get("tags", [])) <= TAGS, f"cell {i}: {cell.metadata.tags}"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_cells_are_short(path):
    for i, cell in _cells(path):
        assert len(cell.source.splitlines()) <= 15, f"cell {i} has {len(cell.source.splitlines())} lines"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_every_picture_has_words(path):
    for i, cell in _cells(path):
        if any("image/png" in out.get("data", {}) for out in cell.outputs):
            alt = cell.metadata.get("mystnb", {}).get("image", {}).get("alt", "")
            assert len(alt) > 40, f"cell {i} draws a picture without alternative text"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_outputs_are_the_same_everywhere(path):
    """Warnings, addresses of objects and paths in a committed output."""
    for i, cell in _cells(path):
        for out in cell.outputs:
            assert out.get("name") != "stderr", f"cell {i} warns: {out.text}"
            text = out.get("text", "") + str(out.get("data", {}).get("text/plain", ""))
            assert not re.search(r"0x[0-9a-f]{6}|/home/|/Users/|site-packages", text), f"cell {i}: {text}"
    assert "widgets" not in nbformat.read(path, 4).metadata


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_solutions_are_hidden_and_there_are_enough_exercises(path):
    text = "\n".join(cell.source for _, cell in _cells(path, "markdown"))
    exercises = re.findall(r"^`{3,}\{exercise\}", text, re.M) + re.findall(r"^`{3,}\{exercise-start\}", text, re.M)
    solutions = re.findall(r"^`{3,}\{solution(?:-start)?\}[^`]*?(?=^`{3,}|\Z)", text, re.M)
    assert len(exercises) >= 5 and len(solutions) >= len(exercises)
    assert all(":class: dropdown" in s for s in solutions)


def test_configuration_reads_and_asks_no_other_site():
    config = yaml.safe_load((ROOT / "_config.yml").read_text(encoding="utf-8"))
    assert config["sphinx"]["config"]["nb_ipywidgets_js"] == {}
    assert "http" not in str(config["sphinx"]["config"].get("mathjax_path", ""))


def test_nothing_of_this_machine_is_in_the_tree():
    files = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False).stdout.split()
    if not files:
        pytest.skip("not a git checkout")
    home = str(Path.home())
    for name in files:
        path = ROOT / name
        if (
            path.suffix in {".py", ".md", ".yml", ".toml", ".txt", ".ipynb", ".js", ".html", ".css", ""}
            and path.is_file()
        ):
            text = path.read_text(encoding="utf-8", errors="ignore")
            assert str(ROOT) + "/" not in text and (home == "/" or home + "/" not in text), name


def test_the_example_of_the_readme_runs_and_says_the_truth(capsys):
    """A first example that does not run is the last one a reader tries."""
    code = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.S)[1]
    exec(compile(code, "README.md", "exec"), {})
    shape, numbers = capsys.readouterr().out.split(")")
    particles, exact = map(float, numbers.split())
    assert shape == "(51, 1" and 0 < abs(particles - exact) < 0.1
