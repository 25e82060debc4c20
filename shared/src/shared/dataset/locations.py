"""Where a dataset lies: a local folder, object storage, a repository of Hugging Face, or a web server.

``s3://bucket/folder`` and ``gs://bucket/folder`` are read by Arrow, with the credentials that the environment holds (as
AWS and Google define it) and with the parameters of :data:`PARAMETERS`, e.g. ``s3://bucket/folder?region=eu-central-1``,
or ``?scheme=http&endpoint_override=localhost:9000`` for one's own store; :mod:`shared.dataset.writing` writes there.
``hf://datasets/OWNER/NAME`` and ``https://host/folder`` are read through :mod:`shared.dataset.web`.
A local path stays a :class:`pathlib.Path`; a remote one offers the few of its operations that a dataset needs. A URI
with credentials in it is refused: it would stand in the shell's history and in the list of processes.
"""

from __future__ import annotations

import hashlib
import re
import textwrap
from dataclasses import dataclass, field, replace
from pathlib import Path
from urllib.parse import SplitResult, parse_qsl, urlsplit, urlunsplit

import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow.fs import FileSelector, FileSystem, FileType, LocalFileSystem

from shared.physics.errors import InputError, require_utf8

PARAMETERS = {
    "file": (),
    "s3": ("region", "scheme", "endpoint_override", "tls_ca_file_path"),
    "gs": ("scheme", "endpoint_override", "retry_limit_seconds", "project_id"),
    "gcs": ("scheme", "endpoint_override", "retry_limit_seconds", "project_id"),
    "hf": (),
    "https": (),
    "http": (),
}
"""Schemes of a URI, and what may stand behind its question mark."""
CREDENTIALS = {
    "s3": "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY",
    "gs": "GOOGLE_APPLICATION_CREDENTIALS",
    "gcs": "GOOGLE_APPLICATION_CREDENTIALS",
    "hf": "HF_TOKEN, or hf auth login",
    "https": "~/.netrc",
    "http": "~/.netrc",
    "file": "none",
}
"""Where each kind of store's credentials are looked for."""
GOOGLE_RETRY_SECONDS = 10
"""Arrow's own default repeats a request to Google's storage for a quarter of an hour."""
LONGEST_REASON = 300
"""Characters of a store's own message that are shown."""


@dataclass(frozen=True)
class RemotePath:
    """A file or folder of an Arrow filesystem.

    :param filesystem: that reads it
    :param key: the path within it, bucket first
    :param label: the URI for messages, without its parameters
    :param origin: the URI that the user named, of this file or of a folder above it; "" for any filesystem of Arrow
    :param lists: whether a folder there says what is in it
    """

    filesystem: FileSystem = field(repr=False, compare=False)
    key: str
    label: str
    origin: str = field(default="", repr=False, compare=False)
    lists: bool = field(default=True, repr=False, compare=False)

    def __truediv__(self, name: str) -> RemotePath:
        return replace(self, key=f"{self.key.rstrip('/')}/{name}", label=f"{self.label.rstrip('/')}/{name}")

    @property
    def parent(self) -> RemotePath:
        """The folder that it is in."""
        return replace(self, key=self.key.rpartition("/")[0], label=self.label.rpartition("/")[0])

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
        if info.type != FileType.File:
            return None
        if info.size is None:
            raise InputError(self.label, "the server does not say how long it is", "one that states Content-Length")
        return int(info.size)

    def read_bytes(self) -> bytes:
        """The whole file."""
        with self.filesystem.open_input_stream(self.key) as handle:
            return handle.read()

    def files(self) -> list[str]:
        """Names of the files in the folder, sorted; none if there is no such folder, or where no folder lists."""
        if not self.lists:
            return []
        selector = FileSelector(self.key, allow_not_found=True)
        return sorted(info.base_name for info in self.filesystem.get_file_info(selector) if info.type == FileType.File)


Location = Path | RemotePath


def locate(path: Path | str | RemotePath) -> Location:
    """The place that a path or a URI names.

    :raises InputError: a scheme that is not known, no bucket, credentials or an unknown parameter in the URI, a store
        that does not answer
    """
    require_utf8(path)
    if not isinstance(path, str):
        if _was_uri(path):
            raise InputError(path, "a URI as a Path, which drops a slash of it", "the URI as text")
        if not isinstance(path, Path | RemotePath):
            raise InputError(repr(path), "no place of files", "a path, or a URI as text")
        return path
    if re.match(r"[a-z][a-z0-9+.-]+://", path, re.IGNORECASE) is None:
        return Path(path)
    parts = _checked(path)
    label = urlunsplit((parts.scheme, parts.netloc, parts.path, "", ""))
    if parts.scheme in ("hf", "https", "http"):
        from shared.dataset.web import web_filesystem

        filesystem, key = web_filesystem(parts, label)
        return RemotePath(filesystem, key, label.rstrip("/"), path, lists=parts.scheme == "hf")
    uri = path
    if parts.scheme in ("gs", "gcs") and "retry_limit_seconds" not in parts.query:
        query = f"{parts.query}&" if parts.query else ""
        uri = urlunsplit(parts._replace(query=f"{query}retry_limit_seconds={GOOGLE_RETRY_SECONDS}"))
    try:
        filesystem, key = FileSystem.from_uri(uri)
    except (OSError, pa.ArrowException) as error:
        raise _unreachable(label, error) from error
    return Path(key) if isinstance(filesystem, LocalFileSystem) else RemotePath(filesystem, key, label, path)


def _was_uri(path: object) -> bool:
    return isinstance(path, Path) and str(path).startswith(tuple(f"{scheme}:/" for scheme in PARAMETERS))


def _checked(uri: str) -> SplitResult:
    """The parts of a URI that holds no credentials. A message never shows a parameter's value."""
    try:
        parts = urlsplit(uri)
    except ValueError as error:
        raise InputError(uri.partition("?")[0].rpartition("@")[2], f"no URI: {error}", "SCHEME://PLACE") from None
    label = urlunsplit((parts.scheme, parts.netloc.rpartition("@")[2], parts.path, "", ""))
    allowed = PARAMETERS.get(parts.scheme)
    if allowed is None:
        raise InputError(label, f"scheme {parts.scheme!r}", f"a local path, or one of {', '.join(PARAMETERS)}://")
    if parts.scheme in ("s3", "gs", "gcs") and not parts.netloc:
        raise InputError(f"{parts.scheme}://", "names no bucket", f"{parts.scheme}://BUCKET/FOLDER")
    given = dict(parse_qsl(parts.query, keep_blank_values=True))
    anonymous = parts.scheme in ("gs", "gcs") and parts.netloc.startswith("anonymous@")
    if ("@" in parts.netloc and not anonymous) or "@" in given.get("endpoint_override", ""):
        raise InputError(label, "credentials in the URI", f"them in the environment: {CREDENTIALS[parts.scheme]}")
    for name in given:
        if name not in allowed:
            expected = f"one of {', '.join(allowed)}; credentials stand in the environment" if allowed else "none"
            raise InputError(label, f"parameter {name!r} of the URI", expected)
    return parts


def absolute(location: Location) -> Location:
    """The place from wherever one stands."""
    return location.absolute() if isinstance(location, Path) else location


def local(path: Path | str, option: str) -> Path:
    """The local folder that an option names.

    :raises InputError: a place elsewhere
    """
    # Of a command line that takes a Path: what was typed lost a slash.
    location = None if _was_uri(path) else locate(path)
    if not isinstance(location, Path):
        raise InputError(option, f"{location or path} is not on this machine", "a local folder")
    return location


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
    return InputError(label, f"cannot be reached: {reason}", "one that exists, and credentials that may read it")
