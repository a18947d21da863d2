"""A web server for tests: it serves the files of a folder by ranges, counts the bytes, and fails as often as it is told to."""

import contextlib
import functools
import http.server
import threading
from pathlib import Path

import pytest


class Handler(http.server.SimpleHTTPRequestHandler):
    def do_GET(self):
        path = Path(self.translate_path(self.path))
        failures = self.server.failures.get(path.name, [])
        if failures or not path.is_file():
            self.send_error(failures.pop() if failures else 404)
            return
        part, wanted = path.read_bytes(), self.headers.get("Range")
        if wanted and self.server.has_ranges:
            begin, end = wanted.removeprefix("bytes=").split("-")
            size, part = len(part), part[int(begin) : int(end) + 1]
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {begin}-{int(begin) + len(part) - 1}/{size}")
        else:
            self.send_response(200)
        self.send_header("Accept-Ranges", "bytes")
        self.send_header("Content-Length", str(len(part)))
        self.end_headers()
        if self.command == "GET":
            self.server.served += len(part)
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                self.wfile.write(part)

    do_HEAD = do_GET

    def log_message(self, *_):
        pass


@contextlib.contextmanager
def serving(folder, failures):
    """A server, with its `url`. `failures` are the statuses that a file replies with before it is there, by its name."""
    pytest.importorskip("aiohttp", reason="HTTP is not tested: pip install fsspec aiohttp")
    pytest.importorskip("fsspec", reason="HTTP is not tested: pip install fsspec aiohttp")
    running = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Handler, directory=str(folder)))
    running.served, running.has_ranges, running.failures = 0, True, failures
    threading.Thread(target=running.serve_forever, daemon=True).start()
    running.url = f"http://127.0.0.1:{running.server_port}"
    yield running
    running.shutdown()
    running.server_close()
