"""Serve a built book on this machine: ``python -m pfedu.live.serve _build/html``."""

import argparse
import contextlib
import functools
import gzip
import http.server
import io
import threading
import webbrowser
from pathlib import Path

_PACKED = {".html", ".css", ".js", ".json", ".svg", ".mjs"}


@functools.lru_cache(maxsize=512)
def _packed(path, _changed):
    return gzip.compress(Path(path).read_bytes(), 6, mtime=0)


class _Handler(http.server.SimpleHTTPRequestHandler):
    extensions_map = http.server.SimpleHTTPRequestHandler.extensions_map | {
        ".js": "text/javascript",
        ".wasm": "application/wasm",
    }

    def send_head(self):
        """Text goes compressed, as from any web host."""
        path = Path(self.translate_path(self.path))
        takes = "gzip" in self.headers.get("Accept-Encoding", "") and "If-Modified-Since" not in self.headers
        if not (takes and path.suffix in _PACKED and path.is_file()):
            return super().send_head()
        body = _packed(str(path), path.stat().st_mtime_ns)
        self.send_response(http.HTTPStatus.OK)
        self.send_header("Content-Type", self.guess_type(str(path)))
        self.send_header("Content-Encoding", "gzip")
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Last-Modified", self.date_time_string(path.stat().st_mtime))
        self.end_headers()
        return io.BytesIO(body)

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
