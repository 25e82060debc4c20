"""Files that are whole or not there: each is written beside its final name, flushed to the disk and renamed.

Everything that the packages write into a dataset, a run or a report goes through :func:`atomic`.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

PARTIAL = ".partial"
"""Suffix of a file that is being written. A process that is killed leaves such a file behind."""


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """The name to write to, beside ``path``; at the end its file is flushed to the disk and renamed to ``path``.

    A body that raises leaves ``path`` as it was and nothing beside it.

    :param path: of the final file; its folder exists
    :raises OSError: the disk is full or fails; the error names ``path``, which a write by itself does not
    """
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


def remove_partial(folder: Path) -> None:
    """Remove what processes that were killed had begun to write into a folder and the folders in it."""
    for stale in [*folder.glob(f"*{PARTIAL}"), *folder.glob(f"*/*{PARTIAL}")]:
        stale.unlink(missing_ok=True)


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write a file in one step, see :func:`atomic`."""
    with atomic(path) as partial:
        partial.write_bytes(content)


def write_text(path: Path, content: str) -> None:
    """Write a UTF-8 file with the line ends of ``content`` in one step, see :func:`atomic`."""
    write_bytes(path, content.encode())


def write_json(path: Path, document: Mapping[str, Any], sort_keys: bool = True) -> None:
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
