"""An S3 server on this machine, moto's, that can be told to fail.

Run as a program it serves on the port given, with buckets that it is told to make. ``POST /fault`` makes the requests
fail whose method and path contain the words given, from the n-th on, with the status given::

    {"method": "PUT", "path": "part-00001", "after": 0, "status": 500, "times": 1000}

With ``"done": true`` what is asked for is done, and the answer lost.
"""

import http.client
import json
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

BUCKET = "bucket"
KEY, SECRET = "AKIDOFTHETESTS", "ASecretThatNobodyMayFindAnywhere"


def set_credentials(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of the environment; a request is tried twice."""
    for name, value in (("AWS_ACCESS_KEY_ID", KEY), ("AWS_SECRET_ACCESS_KEY", SECRET), ("AWS_MAX_ATTEMPTS", "2")):
        monkeypatch.setenv(name, value)


@dataclass
class Server:
    """A running server, and how its objects are seen without any of our code.

    :param options: query of a URI that leads here, ``s3://bucket/KEY?...``
    """

    port: int
    process: subprocess.Popen[bytes]
    options: str = field(init=False)

    def __post_init__(self) -> None:
        self.options = f"scheme=http&endpoint_override=127.0.0.1:{self.port}&region=us-east-1"

    def uri(self, folder: str, bucket: str = BUCKET) -> str:
        return f"s3://{bucket}/{folder}?{self.options}"

    def request(self, method: str, path: str, body: bytes = b"") -> bytes:
        url = f"http://127.0.0.1:{self.port}{path}"
        headers = {
            "Authorization": "AWS4-HMAC-SHA256 Credential=me/20260101/us-east-1/s3/aws4_request",  # unchecked
            "Content-Type": "application/octet-stream",
        }
        with urllib.request.urlopen(urllib.request.Request(url, body or None, headers, method=method)) as answer:
            return answer.read()

    def upload(self, folder: Path, key: str) -> str:
        """The URI of a copy of a local folder."""
        for path in folder.rglob("*.*"):
            self.request("PUT", f"/{BUCKET}/{key}/{path.relative_to(folder).as_posix()}", path.read_bytes())
        return self.uri(key)

    def objects(self, prefix: str = "") -> dict[str, bytes]:
        """Content by key."""
        return {key: self.request("GET", f"/{BUCKET}/{key}") for key in self.keys(prefix)}

    def keys(self, prefix: str = "") -> list[str]:
        listed = self.request("GET", f"/{BUCKET}?list-type=2&prefix={prefix}").decode()
        return [part.partition("</Key>")[0] for part in listed.split("<Key>")[1:]]

    def unfinished(self) -> int:
        """Uploads whose parts were not completed."""
        return self.request("GET", f"/{BUCKET}?uploads").decode().count("<UploadId>")

    def fail(self, **fault: Any) -> None:
        """See the module."""
        self.request("POST", "/fault", json.dumps(fault).encode())

    def mend(self) -> None:
        self.request("POST", "/fault", b"{}")


@contextmanager
def s3_server() -> Iterator[Server]:
    """A server with the bucket ``bucket``."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    process = subprocess.Popen([sys.executable, __file__, str(port)], stderr=subprocess.DEVNULL)
    try:
        server = Server(port, process)
        for _ in range(600):
            try:
                server.request("PUT", f"/{BUCKET}")
                break
            except (urllib.error.URLError, http.client.HTTPException):
                assert process.poll() is None, "the server ended"
                time.sleep(0.1)
        yield server
    finally:
        process.kill()
        process.wait()


def _serve(port: int) -> None:
    from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app
    from werkzeug.serving import make_server

    store = DomainDispatcherApplication(create_backend_app)
    fault: dict[str, Any] = {}

    def application(environ: dict[str, Any], start: Callable[..., Any]) -> Iterable[bytes]:
        method, path = environ["REQUEST_METHOD"], environ["PATH_INFO"]
        if path == "/fault":
            fault.clear()
            fault.update(json.loads(environ["wsgi.input"].read(int(environ["CONTENT_LENGTH"]))))
            start("200 OK", [])
            return [b""]
        if fault and fault["method"] in method and fault["path"] in path:
            if fault.get("after", 0) > 0:
                fault["after"] -= 1
            elif fault.get("times", 1_000_000) > 0:
                fault["times"] = fault.get("times", 1_000_000) - 1
                if fault.get("done"):
                    list(store(environ, lambda *_: None))
                else:
                    environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
                code = {403: "AccessDenied", 500: "InternalError"}[fault["status"]]
                start(f"{fault['status']} {code}", [("Content-Type", "application/xml")])
                return [f"<Error><Code>{code}</Code><Message>made to fail</Message></Error>".encode()]
        return store(environ, start)

    make_server("127.0.0.1", port, application, threaded=True).serve_forever()


if __name__ == "__main__":
    _serve(int(sys.argv[1]))
