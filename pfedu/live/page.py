"""Explorers in the built book: a Sphinx extension.

It turns each place-holder that :func:`pfedu.live.explore` left in a page into a figure with controls,
draws its pictures (each control moved alone), and puts the scripts and ``pfedu`` itself beside them.
One setting says where the page's Python comes from:

``pfedu_pyodide``
    A web address (by default Pyodide's public one), or a folder that is copied into the book, so
    that nothing is asked of any other site. The environment variable ``PFEDU_PYODIDE`` sets it too.

Another, ``pfedu_pdf`` or ``PFEDU_PDF``, names the printed book, which the first page then offers.
"""

import hashlib
import html
import json
import os
import re
import shutil
import zipfile
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import jinja2
import matplotlib
from docutils import nodes

from pfedu.explorers import load
from pfedu.explorers.stage import Stage
from pfedu.live.execute import execute_into_cache
from pfedu.live.picture import small_png

PYODIDE = "https://cdn.jsdelivr.net/pyodide/v0.27.7/full/"

_PACKAGE = Path(__file__).parents[1]
_STATIC = Path(__file__).with_name("static")
_HERE = re.compile(
    r'<div class="pfedu-explorer-here" data-name="(?P<name>\w+)" data-start="(?P<start>[^"]*)">.*?</div>', re.S
)


def setup(app):
    """Connect the extension to Sphinx."""
    app.add_config_value("pfedu_pyodide", os.environ.get("PFEDU_PYODIDE") or PYODIDE, "html")
    app.add_config_value("pfedu_pdf", os.environ.get("PFEDU_PDF", ""), "html")
    app.connect("config-inited", _cache_by_source)
    app.connect("config-inited", _light_mathjax)
    app.connect("builder-inited", _copy_files)
    app.connect("doctree-resolved", _draw_explorers)
    app.connect("html-page-context", _add_scripts, priority=600)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def source_digest(*leave_out):
    """Digest of the package's source, for caches that must not outlive it.

    Parameters
    ----------
    *leave_out : str
        Folders of the package that do not matter.

    Returns
    -------
    str

    Examples
    --------
    >>> from pfedu.live.page import source_digest
    >>> source_digest() == source_digest("live")
    False
    """
    digest = hashlib.sha256(matplotlib.__version__.encode())
    for path in sorted(_PACKAGE.rglob("*")):
        parts = path.relative_to(_PACKAGE).parts
        if path.suffix in {".py", ".csv"} and parts[0] not in leave_out:
            digest.update("/".join(parts).encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_by_source(app, config):
    """Executed notebooks are kept until a cell or the package changes; those wanted are executed side by side."""
    config.nb_execution_cache_path = str(Path(app.srcdir) / "_build" / ".notebooks" / source_digest())
    if config.nb_execution_mode == "cache":
        execute_into_cache(sorted((Path(app.srcdir) / "book").glob("*.ipynb")), config.nb_execution_cache_path)


def _light_mathjax(app, config):
    """MathJax in the parts that the book uses: two thirds of its weight, with what screen readers need."""
    config.mathjax_path = "mathjax/startup.js"
    parts = ["input/tex", "output/chtml", "a11y/assistive-mml"]
    config.mathjax3_config = (config.mathjax3_config or {}) | {"loader": {"load": parts}}


# -- pictures -----------------------------------------------------------------------------------------------------


def draw_frames(name, start, folder):
    """Draw what an explorer shows before Python is up, in each of its layouts.

    Parameters
    ----------
    name : str
    start : dict
        Where controls start, if not at their defaults.
    folder : pathlib.Path
        Gets one picture a frame, ``LAYOUT-KEY.png``; :meth:`~pfedu.explorers.Explorer.key` names them.

    Returns
    -------
    dict
        ``{layout: {"size": (width, height), "frames": {key: (sentence, numbers, solved)}}}``
    """
    layouts = list(load(name).layouts)
    with ProcessPoolExecutor(min(len(layouts), os.cpu_count() or 1)) as pool:
        return dict(zip(layouts, pool.map(partial(_draw_layout, name, start, folder), layouts), strict=True))


def _draw_layout(name, start, folder, layout):
    explorer = load(name)
    stage, frames, start = Stage(explorer, layout), {}, explorer.check(start)
    for params in explorer.beforehand(start):
        pixels, shown = stage.draw(params)
        key = explorer.key(start, params)
        (folder / f"{layout}-{key}.png").write_bytes(small_png(pixels))
        frames[key] = (shown.sentence, shown.numbers, explorer.solved(params, shown))
    return {"size": pixels.shape[1::-1], "frames": frames}


def _frames(app, name, start):
    """Folder and contents of the pictures of one explorer; drawn once, kept until the package changes."""
    key = f"{name}-{hashlib.sha256((source_digest('live') + json.dumps(start)).encode()).hexdigest()[:10]}"
    kept = Path(app.srcdir) / "_build" / ".explorers" / key
    if not (kept / "frames.json").exists():
        kept.mkdir(parents=True, exist_ok=True)
        drawn = draw_frames(name, start, kept)
        (kept / "frames.json").write_text(json.dumps(drawn), encoding="utf-8")
    shutil.copytree(
        kept, Path(app.outdir) / "_static/explorers" / key, ignore=lambda *_: ["frames.json"], dirs_exist_ok=True
    )
    return key, json.loads((kept / "frames.json").read_text(encoding="utf-8"))


# -- pages --------------------------------------------------------------------------------------------------------


def _draw_explorers(app, doctree, docname):
    if app.builder.format != "html":
        return
    for node in list(doctree.findall(nodes.raw)):
        if "pfedu-explorer-here" in node.astext():
            text = _HERE.sub(lambda found: _figure(app, docname, **found.groupdict()), node.astext())
            node.replace_self(nodes.raw("", text, format="html"))


def _figure(app, docname, name, start):
    """HTML of one explorer: picture, sentence, controls and what the script needs to know."""
    start = json.loads(html.unescape(start))
    explorer = load(name)
    params = explorer.check(start)
    key, drawn = _frames(app, name, start)
    sentence, numbers, _ = drawn["wide"]["frames"]["start"]
    files = {
        layout: {"file": f"{layout}-start.png", "width": d["size"][0], "height": d["size"][1]}
        for layout, d in drawn.items()
    }
    tables = []  # what is listed may differ from position to position, and mostly does not
    for _, values, _ in drawn["wide"]["frames"].values():
        if [*values] not in tables:
            tables.append([*values])
    data = {
        "name": name,
        "start": {control.name: control.values.index(params[control.name]) for control in explorer.controls},
        "texts": {c.name: [c.text(value) for value in c.values] for c in explorer.controls},
        "tables": tables,
        "frames": {
            moved: [words, tables.index([*values]), [float(f"{v:.6g}") for v in values.values()], solved]
            for moved, (words, values, solved) in drawn["wide"]["frames"].items()
        },
    }
    folder = "../" * docname.count("/") + f"_static/explorers/{key}/"
    return _template().render(explorer=explorer, name=name, data=data, files={"narrow": files["wide"], **files},
                              folder=folder, sentence=sentence, numbers=numbers)  # fmt: skip


def _template():
    return jinja2.Environment(autoescape=True).from_string((_STATIC / "explorer.html").read_text(encoding="utf-8"))


def _add_scripts(app, pagename, templatename, context, doctree):
    """The script and style of explorers, on the pages that have one; without what no page uses."""
    body = context.get("body", "")
    context["body"] = re.sub(r'<img (?!class="pfedu-poster")', '<img loading="lazy" ', body)  # as the reader comes
    context["body"] = context["body"].replace('role="list" class="citation-list"', 'class="citation-list"')  # no items
    if app.config.pfedu_pdf and pagename == app.config.root_doc:
        offer = f'<p class="pfedu-pdf"><a href="../_static/{Path(app.config.pfedu_pdf).name}">The book as a PDF</a></p>'
        context["body"] = context["body"].replace("</h1>", f"</h1>\n{offer}", 1)
    if "script_files" in context:
        unused = ("thebe", "THEBE") if "widget-view+json" in body else ("thebe", "THEBE", "widget-state+json")
        context["script_files"][:] = [f for f in context["script_files"] if not any(u in _describe(f) for u in unused)]
    if 'class="pfedu-explorer"' in body:
        app.add_css_file("pfedu/explorer.css")
        python = {"data-pyodide": _address(app), "data-version": f"?v={_version()}"}
        app.add_js_file("pfedu/explorer.js", loading_method="defer", **python)


def _describe(script):
    return f"{getattr(script, 'filename', script)} {getattr(script, 'attributes', '')}"


def _is_web(source):
    return re.match(r"https?://", source)


def _address(app):
    """Where the page's Python comes from, seen from the folder of the scripts."""
    return app.config.pfedu_pyodide if _is_web(app.config.pfedu_pyodide) else "../pyodide/"


def _version():
    static = b"".join(path.read_bytes() for path in sorted(_STATIC.iterdir()))
    return hashlib.sha256(source_digest().encode() + static).hexdigest()[:8]


def _copy_files(app):
    if app.builder.format != "html":
        return
    static = Path(app.outdir) / "_static"
    (static / "pfedu").mkdir(parents=True, exist_ok=True)
    for name in ("explorer.js", "worker.js", "explorer.css"):
        shutil.copy(_STATIC / name, static / "pfedu")
    _zip_package(static / "pfedu" / "pfedu.zip")
    if app.config.pfedu_pdf:
        shutil.copy(Path(app.srcdir) / app.config.pfedu_pdf, static)
    if not _is_web(app.config.pfedu_pyodide):
        shutil.copytree(Path(app.srcdir) / app.config.pfedu_pyodide, static / "pyodide", dirs_exist_ok=True)


def _zip_package(path):
    """The package as the page's Python unpacks it; the same bytes for the same source."""
    with zipfile.ZipFile(path, "w") as archive:
        for file in sorted(_PACKAGE.rglob("*")):
            if file.suffix in {".py", ".csv"}:
                info = zipfile.ZipInfo(file.relative_to(_PACKAGE.parent).as_posix(), (2000, 1, 1, 0, 0, 0))
                archive.writestr(info, file.read_bytes(), zipfile.ZIP_DEFLATED)
