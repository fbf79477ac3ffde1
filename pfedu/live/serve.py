"""Serve a built book on this machine: ``python -m pfedu.live.serve _build/html``."""

import argparse
import contextlib
import functools
import http.server
import threading
import webbrowser
from pathlib import Path


class _Handler(http.server.SimpleHTTPRequestHandler):
    extensions_map = http.server.SimpleHTTPRequestHandler.extensions_map | {
        ".js": "text/javascript",
        ".wasm": "application/wasm",
    }

    def log_message(self, *args):
        """Say nothing of each request."""


@contextlib.contextmanager
def serving(folder, port=0):
    """Serve a folder on 127.0.0.1 while the context lasts.

    Parameters
    ----------
    folder : str or pathlib.Path
    port : int
        0 takes any free one.

    Yields
    ------
    str
        The address of the folder.

    Raises
    ------
    FileNotFoundError
        If there is no such folder.

    Examples
    --------
    >>> from pfedu.live.serve import serving
    >>> with serving(".") as address:
    ...     print(address.startswith("http://127.0.0.1:"))
    True
    """
    if not Path(folder).is_dir():
        raise FileNotFoundError(f"there is no folder {folder}: build the book first")
    handler = functools.partial(_Handler, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", port), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


def main():
    """Serve until interrupted, with the browser opened on the book."""
    parser = argparse.ArgumentParser(prog="python -m pfedu.live.serve", description=__doc__)
    parser.add_argument("folder", nargs="?", default="_build/html", help="the built book (default: %(default)s)")
    parser.add_argument("--port", type=int, default=0, help="where to serve it (default: any port that is free)")
    given = parser.parse_args()
    if not (Path(given.folder) / "index.html").exists():
        parser.error(f"there is no book in {given.folder}: build it first")
    try:
        with serving(given.folder, given.port) as address, contextlib.suppress(KeyboardInterrupt):
            print(f"The book is at {address} (Ctrl+C stops it)", flush=True)
            webbrowser.open(address)
            threading.Event().wait()
    except OSError as error:
        parser.error(f"{error}; without --port a free one is taken")


if __name__ == "__main__":
    main()
