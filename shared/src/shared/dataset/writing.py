"""Files that are whole or not there.

Each is written beside its final name, flushed to the disk and renamed. One that goes to an object store is written on
this machine first and sent when it is whole. Everything that the packages write into a dataset, a run or a report goes
through :func:`atomic`.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from shared.dataset.locations import Location, RemotePath, sha256_of
from shared.dataset.stores import kept, objects_under, put, remove
from shared.physics.errors import InputError

PARTIAL = ".partial"
"""Suffix of a file that is being written. A process that is killed leaves such a file behind."""


@contextmanager
def atomic(path: Location) -> Iterator[Path]:
    """The name to write to, on this machine; at the end its file is flushed to the disk and renamed to ``path``, or
    sent there.

    A body that raises leaves ``path`` as it was and nothing beside it.

    :param path: of the final file; its folder exists
    :raises OSError: the disk is full or fails, or a store; the error names ``path``, which a write by itself does not
    """
    if isinstance(path, RemotePath):
        with _sent(path) as partial:
            yield partial
        return
    partial = path.with_name(path.name + PARTIAL)
    try:
        yield partial
        with partial.open("rb+") as handle:
            os.fsync(handle.fileno())
        partial.replace(path)
    except OSError as error:
        if error.filename not in (None, str(partial), partial):
            raise  # another file that the body reads
        reason = error.strerror or " ".join(str(error).split())
        raise OSError(error.errno or errno.EIO, reason, str(path)) from error
    finally:
        with suppress(OSError):
            partial.unlink()


@contextmanager
def _sent(path: RemotePath) -> Iterator[Path]:
    partial = scratch(path) / f"{os.getpid()}-{path.key.replace('/', '-')}{PARTIAL}"
    try:
        yield partial
        put(path, partial, sha256_of(partial))
    finally:
        with suppress(OSError):
            partial.unlink()


def scratch(path: RemotePath) -> Path:
    """The folder on this machine for what is on its way to a URI: the user's own, below ``TMPDIR``.

    It has one name for one URI, so that the next run finds what a killed one left.

    :raises OSError: a disk that cannot be written, a folder there that is somebody else's
    """
    of_user = Path(tempfile.gettempdir()) / f"sparseradar-{os.getuid() if hasattr(os, 'getuid') else 'user'}"
    folder = of_user / hashlib.sha256(path.origin.encode()).hexdigest()[:16]
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if hasattr(os, "getuid") and (of_user.is_symlink() or of_user.stat().st_uid != os.getuid()):
        raise OSError(errno.EPERM, "belongs to another user", str(of_user))
    return folder


def make_folder(folder: Location) -> None:
    """Make a folder and those above it; an object store needs none."""
    if isinstance(folder, Path):
        folder.mkdir(parents=True, exist_ok=True)


def require_folder(folder: Path, option: str, expected: str = "a folder") -> None:
    """Refuse a folder that cannot be made: see :func:`make_folder`.

    :raises InputError: where it or a folder above it would be there is a file
    """
    there = next(path for path in (folder, *folder.parents) if os.path.exists(path))
    if not os.path.isdir(there):
        raise InputError(option, f"{there} is a file", expected)


def remove_folder(folder: Location) -> None:
    """Remove a folder with all that is in it."""
    if isinstance(folder, Path):
        shutil.rmtree(folder)
        return
    remove(*(folder / name for name in list(objects_under(folder))))


def is_as_recorded(path: Location, size: int, sha256: str) -> bool:
    """Whether a file has this size [B] and SHA-256.

    A local file is read. Of an object the store is asked for its size and for the SHA-256 that its writer stated with
    it, see :mod:`shared.dataset.stores`; an object that something else wrote states none, and is read.
    """
    if isinstance(path, RemotePath):
        found = kept(path)
        if found is None or found.size != size:
            return False
        return (found.sha256 or sha256_of(path)) == sha256
    return path.is_file() and path.stat().st_size == size and sha256_of(path) == sha256


def remove_partial(folder: Location) -> None:
    """Remove what processes that were killed had begun to write into a folder and the folders in it."""
    if isinstance(folder, RemotePath):
        shutil.rmtree(scratch(folder), ignore_errors=True)
        return
    for stale in [*folder.glob(f"*{PARTIAL}"), *folder.glob(f"*/*{PARTIAL}")]:
        stale.unlink(missing_ok=True)


def require_new_file(out: Path, suffix: str) -> None:
    """Refuse an ``--out`` that a command may not write.

    :raises InputError: of another suffix, in no folder, or there already
    """
    if out.suffix != suffix or not out.parent.is_dir():
        raise InputError("--out", f"{out}", f"a {suffix} in a folder that is there")
    if out.exists():
        raise InputError("--out", f"{out} is there already", "a file that does not exist yet")


def write_bytes(path: Location, content: bytes | memoryview) -> None:
    """Write a file in one step, see :func:`atomic`."""
    with atomic(path) as partial:
        partial.write_bytes(content)


def write_text(path: Location, content: str) -> None:
    """Write a UTF-8 file with the line ends of ``content`` in one step, see :func:`atomic`."""
    write_bytes(path, content.encode())


def write_json(path: Location, document: Mapping[str, Any], sort_keys: bool = True) -> None:
    """Write a JSON object in one step, see :func:`atomic`: indented, with a line end after it.

    :param sort_keys: False keeps the keys in the mapping's order
    :raises ValueError: NaN or infinity, which JSON does not have
    """
    write_text(path, json.dumps(document, sort_keys=sort_keys, indent=1, allow_nan=False) + "\n")


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """A new folder to fill, beside ``path``; at the end it is renamed to ``path``.

    A body that raises leaves nothing behind.

    :param path: of the finished folder, which does not exist yet; the folders above it are made
    :raises OSError: the disk is full or fails
    """
    partial = path.with_name(path.name + PARTIAL)
    path.parent.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir()
    try:
        yield partial
        partial.rename(path)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
