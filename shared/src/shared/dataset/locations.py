"""Where a dataset lies: a local folder, or object storage through Arrow's own filesystems.

``s3://bucket/folder`` and ``gs://bucket/folder`` are read where they are, with the credentials that the environment
holds (as AWS and Google define it) and the query parameters that :meth:`pyarrow.fs.FileSystem.from_uri` documents, e.g.
``s3://bucket/folder?region=eu-central-1``, or ``?scheme=http&endpoint_override=localhost:9000`` for one's own store.
A local path stays a :class:`pathlib.Path`; a remote one offers the few of its operations that reading needs.
"""

from __future__ import annotations

import hashlib
import re
import textwrap
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit, urlunsplit

import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow.fs import FileSelector, FileSystem, FileType, LocalFileSystem

from shared.physics.errors import InputError, require_utf8

SCHEMES = ("file", "s3", "gs", "gcs")
GOOGLE_RETRY_SECONDS = 10
"""Arrow's own default repeats a request to Google's storage for a quarter of an hour."""
LONGEST_REASON = 300
"""Characters of a store's own message that are shown."""


@dataclass(frozen=True)
class RemotePath:
    """A file or folder of an Arrow filesystem.

    :param filesystem: that reads it
    :param key: the path within it, bucket first
    :param label: the URI for messages, without what may be a secret in it
    """

    filesystem: FileSystem = field(repr=False, compare=False)
    key: str
    label: str

    def __truediv__(self, name: str) -> RemotePath:
        return RemotePath(self.filesystem, f"{self.key.rstrip('/')}/{name}", f"{self.label.rstrip('/')}/{name}")

    def __str__(self) -> str:
        return self.label

    @property
    def name(self) -> str:
        """The last part of the path."""
        return self.key.rstrip("/").rpartition("/")[2]

    def size(self) -> int | None:
        """Bytes of the file, None if there is none.

        :raises InputError: a store that does not answer: no such bucket, no credentials, no network
        """
        try:
            info = self.filesystem.get_file_info(self.key)
        except (OSError, pa.ArrowException) as error:
            raise _unreachable(self.label, error) from error
        return info.size if info.type == FileType.File else None

    def read_bytes(self) -> bytes:
        """The whole file."""
        with self.filesystem.open_input_stream(self.key) as handle:
            return handle.read()

    def files(self) -> list[str]:
        """Names of the files in the folder, sorted; none if there is no such folder."""
        selector = FileSelector(self.key, allow_not_found=True)
        return sorted(info.base_name for info in self.filesystem.get_file_info(selector) if info.type == FileType.File)


Location = Path | RemotePath


def locate(path: Path | str | RemotePath) -> Location:
    """The place that a path or a URI names.

    :raises InputError: a scheme that is not known, no bucket, a store that does not answer
    """
    require_utf8(path)
    if not isinstance(path, str):
        return path
    scheme = re.match(r"([a-z][a-z0-9+.-]+)://", path, re.IGNORECASE)
    if scheme is None:
        return Path(path)
    if scheme[1].lower() not in SCHEMES:
        raise InputError(path, f"scheme {scheme[1]!r}", f"a local path, or one of {', '.join(SCHEMES)}://")
    parts = urlsplit(path)
    if parts.scheme != "file" and not parts.netloc:
        raise InputError(path, "names no bucket", f"{parts.scheme}://BUCKET/FOLDER")
    label = urlunsplit((parts.scheme, parts.netloc.rpartition("@")[2], parts.path, "", ""))
    if parts.scheme in ("gs", "gcs") and "retry_limit_seconds" not in parts.query:
        query = f"{parts.query}&" if parts.query else ""
        path = urlunsplit(parts._replace(query=f"{query}retry_limit_seconds={GOOGLE_RETRY_SECONDS}"))
    try:
        filesystem, key = FileSystem.from_uri(path)
    except (OSError, pa.ArrowException) as error:
        raise _unreachable(label, error) from error
    return Path(key) if isinstance(filesystem, LocalFileSystem) else RemotePath(filesystem, key, label)


def file_size(location: Location) -> int | None:
    """Bytes of a file, None if there is none."""
    if isinstance(location, RemotePath):
        return location.size()
    return location.stat().st_size if location.is_file() else None


def file_names(folder: Location) -> list[str]:
    """Names in a folder, sorted; none if there is no such folder."""
    if isinstance(folder, RemotePath):
        return folder.files()
    return sorted(entry.name for entry in folder.glob("*"))


def folder_name(location: Location) -> str:
    """The last part of a folder's path, also of ``.``."""
    return location.name if isinstance(location, RemotePath) else location.resolve().name


def sha256_of(location: Location) -> str:
    """SHA-256 of a file, in hexadecimal."""
    if isinstance(location, RemotePath):
        with location.filesystem.open_input_file(location.key) as handle:
            return hashlib.file_digest(handle, "sha256").hexdigest()
    with location.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def open_parquet(location: Location) -> pq.ParquetFile:
    """The Parquet file, the checksums of whose pages are verified; a remote one fetches the ranges of a row group's
    columns together."""
    if isinstance(location, RemotePath):
        key, filesystem = location.key, location.filesystem
        return pq.ParquetFile(key, filesystem=filesystem, pre_buffer=True, page_checksum_verification=True)
    return pq.ParquetFile(location, page_checksum_verification=True)


def _unreachable(label: str, error: Exception) -> InputError:
    # Google's library repeats its message over a thousand characters. The cause stands first.
    reason = textwrap.shorten(str(error), LONGEST_REASON, placeholder=" ...")
    return InputError(label, f"cannot be reached: {reason}", "a bucket that exists, and credentials that may read it")
