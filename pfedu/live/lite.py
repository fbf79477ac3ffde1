"""Every chapter as a live notebook: a Sphinx extension that puts JupyterLite, Jupyter without a server, into the book.

The folder ``_static/lite`` of the built book holds it, with a copy of each chapter's notebook. Its kernel is
Pyodide, from where the explorers have theirs (``pfedu_pyodide``), and it starts with ``pfedu``, matplotlib and
ipywidgets in place: nothing is installed, and no package index is asked. One more setting concerns the links:

``pfedu_repository``
    Web address of the repository on GitHub. Where it is set, each chapter leads to Binder and Colab as well.
"""

import base64
import hashlib
import html
import json
import shutil
import subprocess
import sys
import zipfile
from importlib.metadata import distribution
from pathlib import Path
from textwrap import indent

import nbformat

import pfedu
from pfedu.live.page import _PACKAGE, _is_web, source_digest

KERNEL = "@jupyterlite/pyodide-kernel-extension"
EXTENSIONS = (KERNEL, "@jupyter-widgets/jupyterlab-manager")
BORROWED = ("comm", "ipywidgets")  # as they are installed here; pure Python, and not among Pyodide's packages
PRELOADED = ("micropip", "ssl", "sqlite3", "jedi", "ipython", "numpy", "matplotlib")
FOLDED = {
    "source_hidden": {"hide-input", "hide-cell", "remove-input", "remove-cell"},
    "outputs_hidden": {"hide-output", "remove-output"},
}
# JupyterLite drops the cells that wait behind an error, also behind one that is meant
_CAUGHT = 'try:\n{}\nexcept Exception as error:\n    print(f"{{type(error).__name__}}: {{error}}")'
_WORKER = f"extensions/{KERNEL}/static/"  # the kernel's worker looks for its wheels from here


def setup(app):
    """Connect the extension to Sphinx."""
    app.setup_extension("pfedu.live.page")
    app.add_config_value("pfedu_repository", "", "html")
    app.connect("html-page-context", _offer)
    app.connect("build-finished", _build)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


# -- links --------------------------------------------------------------------------------------------------------


def _offer(app, pagename, templatename, context, doctree):
    """A line under the title of each chapter that has a notebook."""
    if doctree is not None and _is_notebook(app, pagename):
        line = door(pagename, app.config.pfedu_repository)
        context["body"] = context["body"].replace("</h1>", f"</h1>\n{line}", 1)


def _is_notebook(app, pagename):
    return app.env.doc2path(pagename).endswith(".ipynb")


def door(pagename, repository=""):
    """Write the line that leads from a page to its live notebook.

    Parameters
    ----------
    pagename : str
        Path of the page in the book, without ending.
    repository : str
        Web address on GitHub, if the notebook is to be had on Binder and Colab too.

    Returns
    -------
    str
        HTML. Opened as a file, where Jupyter cannot start, the page says so instead.

    Examples
    --------
    >>> from pfedu.live.lite import door
    >>> "Binder" in door("book/03-sir"), "Binder" in door("book/03-sir", "https://github.com/someone/book")
    (False, True)
    """
    lite, chapter = "../" * pagename.count("/") + "_static/lite/notebooks/index.html", pagename.rpartition("/")[2]
    opens = f'<a href="{lite}?path={chapter}.ipynb">Open this chapter as a live notebook</a>'
    links = [f'<span class="pfedu-lite">{opens}</span>', *_elsewhere(pagename, repository.rstrip("/"))]
    return f'<p class="pfedu-live-notebook d-print-none">{" · ".join(links)}</p>\n<script>{_FROM_A_FILE}</script>'


_FROM_A_FILE = (
    "if (location.protocol === 'file:') document.querySelector('.pfedu-lite').textContent = "
    "'Served by a web server (make read), this chapter opens as a live notebook.'"
)


def _elsewhere(pagename, repository):
    """Links to services that run the notebook on a server of theirs, where the repository is known."""
    if not repository:
        return []
    name = repository.partition("github.com/")[2]
    if name.count("/") != 1:
        raise ValueError(f"pfedu_repository is {repository!r}: the form is https://github.com/OWNER/NAME")
    notebook = f"{pagename}.ipynb"
    binder = f"https://mybinder.org/v2/gh/{name}/HEAD?urlpath=lab/tree/{notebook}"
    colab = f"https://colab.research.google.com/github/{name}/blob/HEAD/{notebook}"
    first = html.escape(f'There, run first: %pip install "pfedu[notebook] @ git+{repository}" myst-nb')
    return [f'<a href="{binder}">Binder</a>', f'<a href="{colab}" title="{first}">Colab</a>']


# -- the site -----------------------------------------------------------------------------------------------------


def _build(app, exception):
    if exception or app.builder.format != "html":
        return
    site = Path(app.outdir) / "_static/lite"
    pyodide = app.config.pfedu_pyodide if _is_web(app.config.pfedu_pyodide) else "./../pyodide/"
    notebooks = [Path(app.env.doc2path(name)) for name in sorted(app.env.found_docs) if _is_notebook(app, name)]
    build_site(site, notebooks, pyodide)


def build_site(site, notebooks, pyodide):
    """Put JupyterLite with some notebooks into a folder; one that is up to date stays as it is.

    Parameters
    ----------
    site : pathlib.Path
    notebooks : sequence of pathlib.Path
    pyodide : str
        Address of a Pyodide, complete or beginning with ``./`` and seen from the folder, with a closing slash.

    Raises
    ------
    RuntimeError
        If JupyterLite cannot be built; what it said is in the message.
    """
    digest = _digest(notebooks, pyodide)
    stamp = site / "made-from"
    if stamp.exists() and stamp.read_text(encoding="utf-8") == digest:
        return
    shutil.rmtree(site, ignore_errors=True)
    work = site.with_name(f".{site.name}")
    shutil.rmtree(work, ignore_errors=True)
    (work / "files").mkdir(parents=True)
    for path in notebooks:
        nbformat.write(prepared(nbformat.read(path, 4)), work / "files" / path.name)
    for path in _tables(notebooks):
        (work / "files" / path.parent.name).mkdir(exist_ok=True)
        shutil.copy(path, work / "files" / path.parent.name)
    wheels = [wheel.name for wheel in write_wheels(work / "wheels")]
    (work / "jupyter-lite.json").write_text(json.dumps(_settings(pyodide, wheels, digest)), encoding="utf-8")
    (work / "jupyter_lite_config.json").write_text(json.dumps({"LiteBuildConfig": _config()}), encoding="utf-8")
    command = [sys.executable, "-m", "jupyterlite_core", "build", "--lite-dir", ".", "--output-dir", site.absolute()]
    made = subprocess.run(command, cwd=work, capture_output=True, text=True)
    if made.returncode:
        raise RuntimeError(f"JupyterLite could not be built:\n{made.stdout}{made.stderr}")
    shutil.copytree(work / "wheels", site / "wheels" / digest)
    shutil.rmtree(work)
    stamp.write_text(digest, encoding="utf-8")


def _digest(notebooks, pyodide):
    """Digest of all that the site is made from."""
    made_from = [distribution(n).version for n in ("jupyterlite-core", "jupyterlite-pyodide-kernel", *BORROWED)]
    digest = hashlib.sha256("\n".join([*made_from, source_digest(), pyodide]).encode())
    for path in [*notebooks, *_tables(notebooks)]:
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:12]


def _tables(notebooks):
    """What notebooks read from the folder ``_data`` beside them."""
    return sorted(file for folder in {path.parent for path in notebooks} for file in folder.glob("_data/*"))


def _config():
    """What goes into the site, whatever else is installed here."""
    return {
        "apps": ["notebooks", "tree"],
        "contents": ["files"],
        "federated_extensions": [f"{sys.prefix}/share/jupyter/labextensions/{name}" for name in EXTENSIONS],
        "ignore_sys_prefix": ["federated_extensions"],
        "no_sourcemaps": True,
        "no_unused_shared_packages": True,
        "no_libarchive": True,
    }


def _settings(pyodide, wheels, digest):
    """Where the kernel finds Python, and what it starts with."""
    up = "../" * _WORKER.count("/")
    packages = [*PRELOADED, *(f"{up}wheels/{digest}/{wheel}" for wheel in wheels)]
    kernel = {"pyodideUrl": f"{pyodide}pyodide.js", "loadPyodideOptions": {"packages": packages}}
    data = {
        "appName": "Particle Filters, Alive",
        "appUrl": "./tree",
        "litePluginSettings": {f"{KERNEL}:kernel": kernel},
    }
    return {"jupyter-lite-schema-version": 0, "jupyter-config-data": data}


def prepared(notebook):
    """Make the copy of a notebook that a reader is handed: to be run, and folded where the book folds.

    Parameters
    ----------
    notebook : nbformat.NotebookNode

    Returns
    -------
    nbformat.NotebookNode
        The same cells without outputs; an error that is meant is caught and printed, so that the next cell runs.

    Examples
    --------
    >>> import nbformat
    >>> from pfedu.live.lite import prepared
    >>> cell = nbformat.v4.new_code_cell("x = 1", execution_count=1, metadata={"tags": ["hide-input"]})
    >>> cell = prepared(nbformat.v4.new_notebook(cells=[cell])).cells[0]
    >>> cell.execution_count is None, cell.metadata.jupyter
    (True, {'source_hidden': True})
    """
    notebook = nbformat.from_dict(json.loads(json.dumps(notebook)))
    notebook.metadata.kernelspec = {"name": "python", "display_name": "Python (Pyodide)", "language": "python"}
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs, cell.execution_count = [], None
            tags = set(cell.metadata.get("tags", []))
            if "raises-exception" in tags:
                cell.source = _CAUGHT.format(indent(cell.source, "    "))
            folded = {part: True for part, by in FOLDED.items() if tags & by}
            cell.metadata.update({"jupyter": folded} if folded else {})
    return notebook


# -- wheels -------------------------------------------------------------------------------------------------------


def write_wheels(folder):
    """Write the wheels that a live notebook starts with and Pyodide does not have.

    Parameters
    ----------
    folder : pathlib.Path
        Made if it is not there.

    Returns
    -------
    list of pathlib.Path
        ``pfedu`` from this tree, a ``myst_nb`` that only shows what is glued, and what is borrowed from here.
    """
    folder.mkdir(parents=True, exist_ok=True)
    package = [path for path in sorted(_PACKAGE.rglob("*")) if path.suffix in {".py", ".csv"}]
    contents = {path.relative_to(_PACKAGE.parent).as_posix(): path.read_bytes() for path in package}
    shim = {
        "myst_nb.py": b'"""What the chapters use of myst-nb."""\n\nfrom pfedu.live.glue import glue  # noqa: F401\n'
    }
    made = [("pfedu", pfedu.__version__, contents), ("myst_nb", distribution("myst-nb").version, shim)]
    made += [(name, distribution(name).version, _installed(name)) for name in BORROWED]
    return [_write_wheel(folder, *one) for one in made]


def _installed(name):
    """Contents of an installed pure Python distribution."""
    files = [file for file in distribution(name).files if file.suffix == ".py" and ".." not in file.parts]
    return {file.as_posix(): file.locate().read_bytes() for file in sorted(files)}


def _write_wheel(folder, name, version, contents):
    info = f"{name}-{version}.dist-info"
    contents = contents | {
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n".encode(),
        f"{info}/WHEEL": b"Wheel-Version: 1.0\nGenerator: pfedu\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    record = "".join(f"{path},{_record(content)}\n" for path, content in contents.items())
    contents[f"{info}/RECORD"] = f"{record}{info}/RECORD,,\n".encode()
    with zipfile.ZipFile(folder / f"{name}-{version}-py3-none-any.whl", "w") as wheel:
        for path, content in contents.items():
            wheel.writestr(zipfile.ZipInfo(path, (2000, 1, 1, 0, 0, 0)), content, zipfile.ZIP_DEFLATED)
    return Path(wheel.filename)


def _record(content):
    digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
    return f"sha256={digest},{len(content)}"
