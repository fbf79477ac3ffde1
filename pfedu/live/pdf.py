"""Print a built book into one PDF: ``python -m pfedu.live.pdf _build/html _build/book.pdf``.

Chromium prints every page of the table of contents, solutions opened; the prints are put together with
an outline, and links from page to page lead inside the file.
"""

import argparse
import io
import os
import shutil
from pathlib import Path
from urllib.parse import urldefrag

from playwright.sync_api import sync_playwright
from pypdf import PdfReader, PdfWriter
from pypdf.annotations import Link
from pypdf.generic import Fit, RectangleObject

from pfedu.live.serve import serving

_OPEN = """async () => {
    document.querySelectorAll('img').forEach(image => { image.loading = 'eager'; });
    document.querySelectorAll('details').forEach(box => { box.open = true; });
    document.querySelectorAll('.toggle-hidden').forEach(box => box.classList.remove('toggle-hidden'));
    await window.MathJax?.startup?.promise;
    await Promise.all([...document.images].map(image => image.decode().catch(() => {})));
}"""
_FOOT = """<div style="font-size: 8px; width: 100%; text-align: center; color: #666">
    <span class="title"></span>, <span class="pageNumber"></span></div>"""


def contents(page, address):
    """Addresses and titles of the book's pages, in the order of its table of contents."""
    page.goto(address, wait_until="load")
    page.wait_for_selector(".bd-links a.reference.internal", state="attached")
    links = page.eval_on_selector_all(
        ".bd-links a.reference.internal, .navbar-brand", "links => links.map(a => [a.href, a.textContent.trim()])"
    )
    return dict((urldefrag(href)[0], title) for href, title in links)


def print_page(page, address):
    """One page as PDF bytes, with everything on it opened and drawn."""
    page.goto(address, wait_until="load")
    page.evaluate(_OPEN)
    margin = {"top": "15mm", "bottom": "18mm", "left": "15mm", "right": "15mm"}
    return page.pdf(format="A4", margin=margin, display_header_footer=True, header_template="<span></span>",
                    footer_template=_FOOT, scale=0.8)  # fmt: skip


def put_together(prints):
    """One PDF of many.

    Parameters
    ----------
    prints : list of (str, str, bytes)
        Address, title and PDF of each page.

    Returns
    -------
    pypdf.PdfWriter
        With an outline, and with links from page to page that lead inside.
    """
    writer, first = PdfWriter(), {}
    for address, title, pdf in prints:
        first[address] = len(writer.pages)
        writer.append(io.BytesIO(pdf), outline_item=title)
    for number, page in enumerate(writer.pages):
        for annotation in list(page.get("/Annots") or []):
            link = annotation.get_object()
            target = first.get(urldefrag(link.get("/A", {}).get("/URI", ""))[0])
            if target is not None:
                page["/Annots"].remove(annotation)
                inside = Link(rect=RectangleObject(link["/Rect"]), target_page_index=target, fit=Fit.fit_horizontally())
                writer.add_annotation(number, inside)
    return writer


def print_book(folder, target, chromium=None):
    """Print the book in ``folder`` into the file ``target``.

    Parameters
    ----------
    folder, target : str or pathlib.Path
    chromium : str, optional
        Path of the browser; by default the system's, else playwright's own.

    Returns
    -------
    int
        Number of pages of paper.
    """
    found = chromium or os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as play, serving(folder) as address:
        browser = play.chromium.launch(executable_path=found, args=["--no-sandbox"])
        page = browser.new_context(color_scheme="light", viewport={"width": 1000, "height": 1400}).new_page()
        listed = contents(page, address + "book/preface.html")
        prints = [(where, title or "Preface", print_page(page, where)) for where, title in listed.items()]
        browser.close()
    book = put_together(prints)
    book.add_metadata({"/Title": "Particle Filters, Alive", "/Author": "the pfedu authors"})
    Path(target).parent.mkdir(parents=True, exist_ok=True)
    book.compress_identical_objects()
    book.write(target)
    return len(PdfReader(target).pages)


def main():
    """Print the book and say how long it is."""
    parser = argparse.ArgumentParser(prog="python -m pfedu.live.pdf", description=__doc__)
    parser.add_argument("folder", nargs="?", default="_build/html")
    parser.add_argument("target", nargs="?", default="_build/particle-filters-alive.pdf")
    given = parser.parse_args()
    count = print_book(given.folder, given.target)
    print(f"{count} pages, {Path(given.target).stat().st_size / 1e6:.1f} MB, in {given.target}")


if __name__ == "__main__":
    main()
