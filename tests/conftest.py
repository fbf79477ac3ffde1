"""Fixtures of the browser tests: the built book, served on this machine, and Chromium."""

import os
import shutil
from pathlib import Path

import pytest

from pfedu.live.serve import serving

ROOT = Path(__file__).parents[1]
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync"]  # fmt: skip
_missing = []


def _unavailable(what):
    """Where everything must run, a missing piece is a failure; elsewhere it is said plainly."""
    if os.environ.get("CI"):
        pytest.fail(what)
    _missing.append(what)
    pytest.skip(what)


def pytest_terminal_summary(terminalreporter):
    for what in dict.fromkeys(_missing):
        terminalreporter.write_line(f"THE BROWSER TESTS DID NOT RUN: {what}", yellow=True)


@pytest.fixture(scope="session")
def chromium():
    """A running Chromium."""
    sync_api = pytest.importorskip("playwright.sync_api")
    names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
    found = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, names)), None)
    with sync_api.sync_playwright() as play:
        if not found and not Path(play.chromium.executable_path).exists():
            _unavailable("Chromium was not found. Install it (Debian, Ubuntu: apt install chromium; anywhere: "
                         "python -m playwright install chromium) or set CHROMIUM to its path")  # fmt: skip
        browser = play.chromium.launch(executable_path=found, args=FLAGS)
        yield browser
        browser.close()


def _site(name, target):
    folder = ROOT / "_build" / name
    if not (folder / "index.html").exists():
        _unavailable(f"the book is not built in _build/{name}; run: make {target}")
    return folder


@pytest.fixture(scope="session")
def book_folder():
    """The book as it is published: Python comes from Pyodide's public address."""
    return _site("html", "book")


@pytest.fixture(scope="session")
def book(book_folder):
    """Address of the book as it is published."""
    with serving(book_folder) as address:
        yield address


@pytest.fixture(scope="session")
def own_book():
    """Address of the book that brings its own Pyodide."""
    with serving(_site("self-hosted/_build/html", "self-hosted")) as address:
        yield address
