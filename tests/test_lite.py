"""Chapters as live notebooks: what is put into the book, and the notebooks run to their end in a real browser.

The network is closed: whatever the notebook asks of another site is refused and recorded. The browser runs one chapter;
``make test-lite`` (``PFEDU_LITE=all``) runs every one, which takes some minutes each on a slow machine.
"""

import hashlib
import json
import os
import subprocess
import sys
import zipfile
from base64 import urlsafe_b64encode
from contextlib import contextmanager
from pathlib import Path
from textwrap import indent
from urllib.parse import urljoin

import nbformat
import pytest

from pfedu.explorers import load
from pfedu.explorers.stage import Stage
from pfedu.live.lite import build_site, door, prepared, write_wheels
from pfedu.live.page import PYODIDE
from pfedu.live.self_host import WHEELS

BOOK = Path(__file__).parents[1] / "book"
CHAPTERS = sorted(path.stem for path in BOOK.glob("*.ipynb"))
CHOSEN = CHAPTERS if os.environ.get("PFEDU_LITE") == "all" else ["05-a-filter-you-can-drive"]
UP = 240_000  # ms that Jupyter with Python may take to come up on a slow machine
TO_THE_END = 20 * 60_000  # ms that a chapter may take


# ---- what is put into the book ------------------------------------------------------------------------------------


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_notebook_is_the_book_s_without_outputs(chapter):
    """A live notebook that tells something else than the chapter, or carries megabytes of pictures."""
    chapter = nbformat.read(BOOK / f"{chapter}.ipynb", 4)
    outputs = sum(len(cell.get("outputs", [])) for cell in chapter.cells)
    live = prepared(chapter)
    nbformat.validate(live)
    for mine, theirs in zip(live.cells, chapter.cells, strict=True):
        caught = "raises-exception" in theirs.metadata.get("tags", [])
        wanted = f"try:\n{indent(theirs.source, '    ')}\nexcept " if caught else theirs.source
        assert mine.cell_type == theirs.cell_type and mine.source[: len(wanted)] == wanted
        assert caught or mine.source == wanted
    assert not any(cell.get("outputs") for cell in live.cells)
    assert sum(len(cell.get("outputs", [])) for cell in chapter.cells) == outputs, "the original was changed"


def test_folded_where_the_book_folds():
    tags = [["hide-input"], ["hide-output"], ["remove-cell"], ["raises-exception"]]
    cells = [nbformat.v4.new_code_cell("1", metadata={"tags": t}) for t in tags]
    live = prepared(nbformat.v4.new_notebook(cells=cells))
    folded = [dict(cell.metadata.get("jupyter", {})) for cell in live.cells]
    assert folded == [{"source_hidden": True}, {"outputs_hidden": True}, {"source_hidden": True}, {}]
    assert [cell.metadata.tags for cell in live.cells] == tags


def test_wheels_are_whole_and_the_same_every_time(tmp_path):
    """A wheel that Pyodide unpacks but whose record is wrong, or one that changes although nothing did."""
    one, two = write_wheels(tmp_path / "one"), write_wheels(tmp_path / "two")
    assert [path.read_bytes() for path in one] == [path.read_bytes() for path in two]
    for path in one:
        wheel = zipfile.ZipFile(path)
        name = next(n for n in wheel.namelist() if n.endswith("RECORD"))
        for line in wheel.read(name).decode().splitlines():
            member, digest, size = line.rsplit(",", 2)
            content = wheel.read(member)
            wanted = urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
            assert member == name or (digest, int(size)) == (f"sha256={wanted}", len(content)), member


def test_wheels_are_importable_without_what_is_installed_here(tmp_path):
    """A part left behind: the notebook's first cell would end in ModuleNotFoundError."""
    wheels = [str(path) for path in write_wheels(tmp_path)]
    code = (f"import sys; sys.path[:0] = {wheels}\n"
            "import myst_nb, pfedu, pfedu.explorers, ipywidgets, comm\n"
            "assert all('.whl' in m.__file__ for m in (myst_nb, pfedu, ipywidgets, comm))\n"
            "from pfedu.data import nile; assert len(nile()[1]) == 100\n"
            "from importlib.metadata import version; assert version('pfedu') == pfedu.__version__\n"
            "myst_nb.glue('seven', 7); myst_nb.glue('eight', 8, display=False)")  # fmt: skip
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert (said.returncode, said.stdout) == (0, "7\n"), said.stderr


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("book") / "lite"
    build_site(folder, [BOOK / f"{CHOSEN[0]}.ipynb"], PYODIDE)
    return folder


def test_site_has_the_notebook_and_what_its_kernel_starts_with(site):
    """A kernel that asks the package index, or an address that only works where the book was built."""
    settings = json.loads((site / "jupyter-lite.json").read_text(encoding="utf-8"))["jupyter-config-data"]
    kernel = settings["litePluginSettings"]["@jupyterlite/pyodide-kernel-extension:kernel"]
    assert kernel["pyodideUrl"] == PYODIDE + "pyodide.js"
    worker = "http://here/extensions/@jupyterlite/pyodide-kernel-extension/static/worker.js"
    wheels = [p for p in kernel["loadPyodideOptions"]["packages"] if p.endswith(".whl")]
    assert {Path(wheel).name.partition("-")[0] for wheel in wheels} == {"pfedu", "myst_nb", "comm", "ipywidgets"}
    for wheel in wheels:
        assert (site / urljoin(worker, wheel).removeprefix("http://here/")).is_file(), wheel
    assert {p for p in kernel["loadPyodideOptions"]["packages"] if not p.endswith(".whl")} <= set(WHEELS)
    assert (site / "files" / f"{CHOSEN[0]}.ipynb").is_file() and (site / "notebooks/index.html").is_file()
    tables = [path.name for path in BOOK.glob("_data/*")]
    assert sorted(path.name for path in site.glob("files/_data/*")) == sorted(tables)
    assert str(site.parent) not in (site / "jupyter-lite.json").read_text(encoding="utf-8")


def test_site_is_made_anew_only_when_something_changed(site):
    notebook, stamp = BOOK / f"{CHOSEN[0]}.ipynb", site / "made-from"
    before = stamp.stat().st_mtime_ns
    build_site(site, [notebook], PYODIDE)
    assert stamp.stat().st_mtime_ns == before
    build_site(site, [notebook], "./../pyodide/")
    assert stamp.stat().st_mtime_ns > before
    assert '"./../pyodide/pyodide.js"' in (site / "jupyter-lite.json").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "repository", ["", "https://github.com/someone/particle-book", "https://github.com/someone/particle-book/"]
)
def test_links_to_services_only_where_the_repository_is_known(repository):
    line = door("book/03-sir", repository)
    assert 'href="../_static/lite/notebooks/index.html?path=03-sir.ipynb"' in line
    links = [
        "https://mybinder.org/v2/gh/someone/particle-book/HEAD?urlpath=lab/tree/book/03-sir.ipynb",
        "https://colab.research.google.com/github/someone/particle-book/blob/HEAD/book/03-sir.ipynb",
    ]
    assert [link in line for link in links] == [bool(repository)] * 2
    assert ("mybinder" in line or "colab" in line) == bool(repository)


def test_a_repository_that_leads_nowhere_is_refused():
    for wrong in ("someone/book", "https://github.com/someone", "https://example.org/someone/book"):
        with pytest.raises(ValueError, match=r"pfedu_repository is .*github\.com/OWNER/NAME"):
            door("book/03-sir", wrong)


def test_sphinx_puts_the_line_on_notebooks_and_the_services_in_where_set(tmp_path):
    """The setting is read by nobody, or the line stands on pages that have no notebook."""
    from sphinx.application import Sphinx

    source, out = tmp_path / "source", tmp_path / "out"
    source.mkdir()
    (source / "index.md").write_text("# A page\n\n```{toctree}\nchapter\n```\n", encoding="utf-8")
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_markdown_cell("# A chapter")])
    nbformat.write(notebook, source / "chapter.ipynb")
    for repository in ("", "https://github.com/someone/book"):
        config = {"extensions": ["myst_nb", "pfedu.live.lite"], "nb_execution_mode": "off"}
        config |= {"pfedu_repository": repository} if repository else {}
        Sphinx(source, None, out, tmp_path / "trees", "html", config, status=None, warning=None).build()
        page, chapter = ((out / f"{p}.html").read_text(encoding="utf-8") for p in ("index", "chapter"))
        assert "pfedu-lite" in chapter and "pfedu-lite" not in page
        assert ("mybinder.org" in chapter) == ("colab.research" in chapter) == bool(repository)
    assert (out / "_static/lite/files/chapter.ipynb").is_file()


# ---- in the browser -----------------------------------------------------------------------------------------------


@contextmanager
def notebook(chromium, address, chapter, **options):
    """A live notebook, its application in reach of the test, with what it asks of other sites recorded."""
    context = chromium.new_context(viewport={"width": 1280, "height": 900}, **options)
    page = context.new_page()
    page.foreign, page.errors = [], []

    def elsewhere(url):
        return not url.startswith((address, "data:", "blob:"))

    def in_reach(route):
        answer = route.fetch()
        settings = answer.json()
        settings["jupyter-config-data"]["exposeAppInBrowser"] = "true"
        route.fulfill(response=answer, json=settings)

    context.on("request", lambda request: elsewhere(request.url) and page.foreign.append(request.url))
    context.route(elsewhere, lambda route: route.abort())
    context.route("**/lite/jupyter-lite.json", in_reach)
    page.on("pageerror", lambda error: page.errors.append(str(error)))
    try:
        page.goto(f"{address}_static/lite/notebooks/index.html?path={chapter}.ipynb")
        page.wait_for_function("window.jupyterapp?.shell?.currentWidget?.context?.isReady", timeout=UP)
        yield page
    finally:
        context.close()


RUN = """() => {
    const { commands, shell } = window.jupyterapp, { sessionContext } = shell.currentWidget;
    const end = () => sessionContext.session.kernel.requestExecute({ code: 'pass', store_history: false }).done;
    window.ended = false;
    sessionContext.ready.then(() => commands.execute('notebook:run-all-cells')).then(end).then(
        () => { window.ended = true; }, error => { window.ended = String(error); });
}"""


def run(page):
    """Run all cells as the menu does; give them when the last one has ended."""
    page.evaluate(RUN)
    page.wait_for_function("window.ended", timeout=TO_THE_END)
    assert page.evaluate("window.ended") is True
    return nbformat.from_dict(page.evaluate("window.jupyterapp.shell.currentWidget.context.model.toJSON()")).cells


@pytest.mark.browser
@pytest.mark.parametrize("chapter", CHOSEN)
def test_the_chapter_runs_to_its_end(chromium, own_book, chapter):
    """Something that Pyodide's versions of numpy and matplotlib, or its lack of threads, cannot do."""
    with notebook(chromium, own_book, chapter) as page:
        cells = [cell for cell in run(page) if cell.cell_type == "code" and cell.source.strip()]
        for cell in cells:
            wrong = [f"{out.ename}: {out.evalue}" for out in cell.outputs if out.output_type == "error"]
            assert not wrong, f"{wrong[0]}\nin the cell\n{cell.source}"
            said = "".join(out.text for out in cell.outputs if out.output_type == "stream")
            assert "raises-exception" not in cell.metadata.get("tags", []) or "Error: " in said, cell.source
        assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
        assert any("image/png" in out.get("data", {}) for cell in cells for out in cell.outputs), "no figure was drawn"
        assert page.foreign == [] and page.errors == []


@pytest.mark.browser
def test_an_explorer_in_a_notebook_of_one_s_own_without_a_service_worker(chromium, own_book):
    """What a private window lacks, and packages that only the chapters' imports would have brought."""
    with notebook(chromium, own_book, CHOSEN[0], service_workers="block") as page:
        page.evaluate(
            "() => { const model = window.jupyterapp.shell.currentWidget.content.model.sharedModel;"
            " model.deleteCellRange(0, model.cells.length);"
            " model.addCell({cell_type: 'code', source: "
            "'import scipy.stats\\nfrom pfedu.live import explore\\nexplore(\"sir\", N=100)'}); }"
        )
        run(page)
        explorer = load("sir")
        params = explorer.check({"N": 100})
        stage = Stage(explorer)
        page.get_by_text(stage.draw(params)[1].sentence).wait_for()
        page.locator("select", has_text="random walk").select_option("random walk")
        page.get_by_text(stage.draw(params | {"model": "random walk"})[1].sentence).wait_for()
        assert page.foreign == []


@pytest.mark.browser
def test_the_public_book_asks_pyodide_alone(chromium, book):
    """A kernel of another version, a package index, or someone's statistics."""
    with notebook(chromium, book, CHOSEN[0]) as page:
        page.wait_for_timeout(5000)
        assert page.foreign and {url.partition("full/")[0] + "full/" for url in page.foreign} == {PYODIDE}


@pytest.mark.browser
@pytest.mark.parametrize("width", [390, 1280])
def test_the_line_is_seen_and_reached_by_keyboard(chromium, own_book, width):
    page = chromium.new_page(viewport={"width": width, "height": 800})
    page.goto(f"{own_book}book/{CHOSEN[0]}.html")
    link = page.get_by_role("link", name="Open this chapter as a live notebook")
    assert link.is_visible() and link.bounding_box()["y"] < 800
    link.focus()
    page.keyboard.press("Enter")
    page.wait_for_url(f"**/lite/notebooks/index.html?path={CHOSEN[0]}.ipynb")
    page.get_by_role("menuitem", name="Run").wait_for(timeout=UP)
    page.close()


@pytest.mark.browser
def test_opened_as_a_file_the_line_says_what_it_needs(chromium, book_folder):
    page = chromium.new_page()
    page.goto((book_folder / f"book/{CHOSEN[0]}.html").as_uri())
    assert "make read" in page.locator(".pfedu-live-notebook").inner_text()
    assert page.get_by_role("link", name="live notebook").count() == 0
    page.close()
