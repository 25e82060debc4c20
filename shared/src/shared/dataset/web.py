"""Places that are read through fsspec: repositories of Hugging Face and plain web servers.

A web server gives no list of a folder's files; the manifest names the shards. It has to answer ranges. A Hugging Face
URI is ``hf://datasets/OWNER/NAME[@REVISION][/FOLDER]``.
"""

from __future__ import annotations

import errno
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any
from urllib.parse import SplitResult

import pyarrow as pa
from pyarrow.fs import FileInfo, FileSystem, FileType, FSSpecHandler, PyFileSystem

from shared.physics.errors import InputError

THIS_MACHINE = ("localhost", "127.0.0.1", "::1")
"""Hosts that are read without encryption: a manifest and its checksums that came in the clear prove nothing."""
LONGEST_REASON = 200
"""Characters of a server's own message that are shown."""


def web_filesystem(parts: SplitResult, label: str) -> tuple[FileSystem, str]:
    """The filesystem of a URI, and the path in it.

    :param parts: of a URI without credentials
    :param label: the URI for messages
    :raises InputError: no data set of Hugging Face, a host that would be read in the clear, a package that is missing
    """
    if parts.scheme == "hf":
        path = f"{parts.netloc}{parts.path}".strip("/")
        if parts.netloc != "datasets" or path.count("/") < 2:
            raise InputError(label, "names no dataset", "hf://datasets/OWNER/NAME or a folder in it")
        try:
            from huggingface_hub import HfFileSystem
        except ImportError:
            raise _missing(label, "huggingface_hub") from None
        return PyFileSystem(Reader(HfFileSystem())), path
    if not parts.hostname:
        raise InputError(label, "names no host", f"{parts.scheme}://HOST/FOLDER")
    if parts.scheme == "http" and parts.hostname not in THIS_MACHINE:
        raise InputError(label, "would be read in the clear", "https://; http:// only of this machine")
    try:
        from fsspec.implementations.http import HTTPFileSystem
    except ImportError:  # or aiohttp, which it needs
        raise _missing(label, "fsspec and aiohttp") from None
    # trust_env: proxies of the environment, and the user's ~/.netrc.
    return PyFileSystem(Reader(HTTPFileSystem(client_kwargs={"trust_env": True}))), label.rstrip("/")


def _missing(label: str, packages: str) -> InputError:
    return InputError(label, f"needs {packages}", "pip install 'sparseradar-shared[hf]'")


class Reader(FSSpecHandler):
    """Arrow's view of an fsspec filesystem that is only read; what its libraries raise becomes an :class:`OSError`."""

    def get_file_info(self, paths: Sequence[str]) -> list[FileInfo]:
        with _as_os_error():
            return [self._info(path) for path in paths]

    def _info(self, path: str) -> FileInfo:
        try:
            return self._create_file_info(path, self.fs.info(path))
        except FileNotFoundError as error:
            # fsspec takes a server that does not answer, or refuses, for a file that is not there.
            if error.__cause__ is None or isinstance(error.__cause__, FileNotFoundError) or _says_not_found(error):
                return FileInfo(path, FileType.NotFound)
            raise error.__cause__ from None

    def open_input_file(self, path: str) -> pa.PythonFile:
        """The file; reading one that is missing raises."""
        with _as_os_error():
            return pa.PythonFile(_File(self.fs.open(path, mode="rb")), mode="r")

    open_input_stream = open_input_file


class _File:
    """A file of fsspec that fails as files do."""

    def __init__(self, file: Any) -> None:
        self._file = file

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def read(self, size: int = -1) -> bytes:
        with _as_os_error():
            return bytes(self._file.read(size))

    def seek(self, offset: int, whence: int = 0) -> int:
        with _as_os_error():
            return int(self._file.seek(offset, whence))


def _says_not_found(error: FileNotFoundError) -> bool:
    """Whether the answer behind it was 404 or 410."""
    cause = error.__cause__
    status = getattr(cause, "status", None) or getattr(getattr(cause, "response", None), "status_code", None)
    return status in (404, 410)


@contextmanager
def _as_os_error() -> Iterator[None]:
    try:
        yield
    except (OSError, pa.ArrowException):
        raise
    except Exception as error:  # of aiohttp, httpx, fsspec: what they raise is no common type
        reason = textwrap.shorten(str(error) or type(error).__name__, LONGEST_REASON, placeholder=" ...")
        raise OSError(errno.EIO, reason) from error
