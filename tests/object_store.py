"""An object store for tests: a small S3 server on this machine, over a folder whose entries are the buckets."""

from __future__ import annotations

import http.server
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import parse_qs, unquote, urlsplit


class Store(http.server.BaseHTTPRequestHandler):
    """As much of S3 as reading needs: HEAD and GET with ranges, and ListObjectsV2."""

    root: Path

    def do_HEAD(self) -> None:
        self._object(with_body=False)

    def do_GET(self) -> None:
        parts = urlsplit(self.path)
        if "list-type" in parse_qs(parts.query):
            self._list(unquote(parts.path).strip("/"), parse_qs(parts.query))
        else:
            self._object(with_body=True)

    def _object(self, with_body: bool) -> None:
        path = self.root / unquote(urlsplit(self.path).path).strip("/")
        if not path.is_file():
            self._send(200 if path.is_dir() and path.parent == self.root else 404, b"", {})
            return
        content = path.read_bytes()
        if "Range" in self.headers:
            first, _, last = self.headers["Range"].removeprefix("bytes=").partition("-")
            part = content[int(first) : int(last) + 1]
            span = {"Content-Range": f"bytes {first}-{last}/{len(content)}"}
            self._send(206, part if with_body else b"", span, len(part))
            return
        self._send(200, content if with_body else b"", {}, len(content))

    def _list(self, bucket: str, query: dict[str, list[str]]) -> None:
        prefix = query.get("prefix", [""])[0]
        keys = sorted(p.relative_to(self.root / bucket).as_posix() for p in (self.root / bucket).rglob("*.*"))
        found = "".join(f"<Contents><Key>{k}</Key><Size>1</Size></Contents>" for k in keys if k.startswith(prefix))
        text = f"<ListBucketResult><IsTruncated>false</IsTruncated>{found}</ListBucketResult>"
        self._send(200, text.encode(), {"Content-Type": "application/xml"})

    def _send(self, status: int, body: bytes, headers: dict[str, str], length: int | None = None) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(body) if length is None else length))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *arguments: object) -> None:
        """Nothing: pytest's output is not this server's log."""


@contextmanager
def serve(root: Path) -> Iterator[str]:
    """Serve the folders of ``root`` as buckets; gives the query of a URI that leads here, ``s3://BUCKET/KEY?...``."""
    handler = type("Bound", (Store,), {"root": root})
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"scheme=http&endpoint_override=127.0.0.1:{server.server_port}&region=us-east-1"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
