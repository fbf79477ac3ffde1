"""What surrounds the chapters: the glossary and its links, and what the page on citing says."""

import json
import re
from pathlib import Path

import pytest
import yaml

import pfedu

ROOT = Path(__file__).parents[1]
BOOK = ROOT / "book"
GLOSSARY = (BOOK / "glossary.md").read_text(encoding="utf-8")
NOTEBOOKS = sorted(BOOK.glob("*.ipynb"))


def entries():
    """(names, explanation) of each entry of the glossary."""
    body = GLOSSARY.split(":sorted:")[1].split("\n```")[0]
    for block in re.split(r"\n\n+", body.strip()):
        lines = block.splitlines()
        yield [line for line in lines if line[0] != " "], " ".join(line.strip() for line in lines if line[0] == " ")


AMERICAN = re.compile(
    r"(?<![\w.`])(?:colors?|colored|centers?|centered|gray|behaviors?|neighbors?|neighboring|favor\w*|meters?|"
    r"model(?:ed|ing)|label(?:ed|ing)|analyz\w+|[a-z]{3,}iz(?:e[sd]?|ing|ers?|ations?))(?![\w(])",
    re.I,
)
NO_PROSE = re.compile(r"\$\$.*?\$\$|\$[^$\n]+\$|(?:\{[\w:]+\})?(`+).+?\1|\]\([^)]*\)", re.S)

NAMES = [name for names, _ in entries() for name in names]


def prose(path):
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")


def test_every_word_is_explained_in_few_words_and_leads_to_a_chapter():
    """Catches an entry without text, one that has become an essay, and a name that is given twice."""
    assert len(NAMES) > 80 and len({name.lower() for name in NAMES}) == len(NAMES)
    for names, text in entries():
        assert 20 < len(text) < 420, names
        assert re.search(r"\{ref\}`[^`]+`", text), f"{names[0]} leads nowhere"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_links_to_the_glossary_have_an_entry_and_come_once(path):
    """Catches a misspelt word, and a chapter in which every other word is a link."""
    links = re.findall(r"\{term\}`(?:[^`<]*<([^`>]+)>|([^`]+))`", prose(path))
    terms = [(target or shown).lower() for target, shown in links]
    assert set(terms) <= {name.lower() for name in NAMES}
    assert len(terms) == len(set(terms)), [term for term in terms if terms.count(term) > 1]


def test_the_version_to_cite_is_that_of_the_package():
    """Catches a page or a file that was left behind when the version changed."""
    cff = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    page = (BOOK / "how-to-cite.md").read_text(encoding="utf-8")
    assert cff["version"] == pfedu.__version__
    assert page.count(f"Version {pfedu.__version__}") == 2
    assert cff["title"] in page and f"year   = {{{cff['date-released'].year}}}" in page


@pytest.mark.parametrize("path", [*NOTEBOOKS, *sorted(BOOK.glob("*.md"))], ids=lambda p: p.stem)
def test_the_prose_is_spelt_in_one_way(path):
    """Catches colour and color on one page; names of functions are as they are, and stand in code font."""
    text = prose(path) if path.suffix == ".ipynb" else path.read_text(encoding="utf-8")
    found = {word.lower() for word in AMERICAN.findall(NO_PROSE.sub("", text))}
    assert found - {"prize", "seize", "resize", "initialize"} == set()  # the last is a handle of chapter 5
