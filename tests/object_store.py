"""An object store for tests: a small S3 server on this machine, over a folder whose entries are the buckets."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from pathlib import Path
from urllib.parse import parse_qs, unquote, urlsplit

from web_server import Web, web_server


class Store(Web):
    """As much of S3 as reading needs: HEAD and GET with ranges, and ListObjectsV2."""

    def _answer(self, with_body: bool) -> None:
        parts, query = urlsplit(self.path), parse_qs(urlsplit(self.path).query)
        place = self.root / unquote(parts.path).strip("/")
        if "list-type" in query:
            self._list(place, query.get("prefix", [""])[0])
        elif place.is_dir() and place.parent == self.root:
            self._send(HTTPStatus.OK, b"", {}, with_body)
        else:
            self._file(place, with_body)

    def _list(self, bucket: Path, prefix: str) -> None:
        keys = sorted(path.relative_to(bucket).as_posix() for path in bucket.rglob("*.*"))
        found = "".join(f"<Contents><Key>{k}</Key><Size>1</Size></Contents>" for k in keys if k.startswith(prefix))
        text = f"<ListBucketResult><IsTruncated>false</IsTruncated>{found}</ListBucketResult>"
        self._send(HTTPStatus.OK, text.encode(), {"Content-Type": "application/xml"}, True)


@contextmanager
def serve(root: Path) -> Iterator[str]:
    """Serve the folders of ``root`` as buckets; gives the query of a URI that leads here, ``s3://BUCKET/KEY?...``."""
    with web_server(root, Store) as (url, _):
        yield f"scheme=http&endpoint_override={url.removeprefix('http://')}&region=us-east-1"
