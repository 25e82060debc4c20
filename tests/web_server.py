"""A web server for tests that answers ranges, and as much of Hugging Face's hub as reading a dataset asks for."""

import http.server
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http import HTTPStatus
from pathlib import Path
from urllib.parse import unquote, urlsplit

COMMIT = "0123456789" * 4


class Web(http.server.BaseHTTPRequestHandler):
    """Files of a folder, and the routes of a hub whose datasets are its folders ``OWNER/NAME``."""

    root: Path
    ranges: bool = True
    denied: str = ""
    """What is answered by 403: a part of a path."""
    asked: list[str]
    """Paths that were asked for."""

    def do_HEAD(self) -> None:
        self._answer(with_body=False)

    def do_GET(self) -> None:
        self._answer(with_body=True)

    def _answer(self, with_body: bool) -> None:
        path = unquote(urlsplit(self.path).path).strip("/")
        self.asked.append(path)
        if self.denied and self.denied in path:
            self._send(HTTPStatus.FORBIDDEN, b"", {}, with_body)
        elif path.startswith("api/datasets/"):
            self._hub(path.split("/")[2:])
        else:
            self._file(self.root / path.removeprefix("datasets/").replace("/resolve/main/", "/"), with_body)

    def _hub(self, parts: list[str]) -> None:
        """``OWNER/NAME``, ``.../revision/main``, ``.../tree/main/FOLDER``."""
        folder = self.root / parts[0] / parts[1]
        if not folder.is_dir():
            self._send(HTTPStatus.NOT_FOUND, b"{}", {"X-Error-Code": "RepoNotFound"}, True)
        elif parts[2:3] == ["tree"]:
            found = folder.joinpath(*parts[4:])
            if not found.is_dir():
                self._send(HTTPStatus.NOT_FOUND, b"{}", {"X-Error-Code": "EntryNotFound"}, True)
                return
            entries = [self._entry(folder, path) for path in sorted(found.iterdir())]
            self._send(HTTPStatus.OK, json.dumps(entries).encode(), {"Content-Type": "application/json"}, True)
        else:
            about = {"id": "/".join(parts[:2]), "sha": COMMIT, "siblings": [], "private": False, "tags": []}
            self._send(HTTPStatus.OK, json.dumps(about).encode(), {"Content-Type": "application/json"}, True)

    def _entry(self, folder: Path, path: Path) -> dict[str, object]:
        size = path.stat().st_size if path.is_file() else 0
        kind = "file" if path.is_file() else "directory"
        return {"type": kind, "oid": COMMIT, "size": size, "path": path.relative_to(folder).as_posix()}

    def _file(self, path: Path, with_body: bool) -> None:
        if not path.is_file():
            self._send(HTTPStatus.NOT_FOUND, b"", {}, with_body)
            return
        content = path.read_bytes()
        asked = self.headers.get("Range", "")
        if not (self.ranges and asked):
            self._send(HTTPStatus.OK, content, {"Accept-Ranges": "bytes"} if self.ranges else {}, with_body)
            return
        first, _, last = asked.removeprefix("bytes=").partition("-")
        part = content[int(first) : int(last) + 1 if last else None]
        span = {"Content-Range": f"bytes {first}-{int(first) + len(part) - 1}/{len(content)}"}
        self._send(HTTPStatus.PARTIAL_CONTENT, part, span, with_body)

    def _send(self, status: HTTPStatus, body: bytes, headers: dict[str, str], with_body: bool) -> None:
        self.send_response(status)
        for name, value in {**headers, "Content-Length": str(len(body)), "X-Repo-Commit": COMMIT}.items():
            self.send_header(name, value)
        self.end_headers()
        if with_body:
            with suppress(ConnectionError):  # who asked saw that no part was answered
                self.wfile.write(body)

    def log_message(self, format: str, *arguments: object) -> None:
        """Nothing: pytest's output is not this server's log."""


@contextmanager
def web_server(root: Path) -> Iterator[tuple[str, type[Web]]]:
    """Serve a folder; gives the URL, and the handler whose class attributes decide how it answers."""
    handler = type("Bound", (Web,), {"root": root, "asked": []})
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", handler
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
