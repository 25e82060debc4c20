"""One job a folder: a lock that a crash releases."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from shared.physics.errors import InputError

LOCK = "lock"


@contextmanager
def one_job(folder: Path, lock_file: Path, option: str) -> Iterator[None]:
    """Hold a folder for this process alone.

    The system releases the lock with the process, however that ends. The file is removed at the end.

    :param lock_file: within the folder; its parent is there
    :param option: that named the folder, for the message
    :raises InputError: another process holds it
    """
    lock = FileLock(lock_file)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        raise InputError(
            option, f"another process is at work in {folder}", "to wait for it, or another folder"
        ) from None
    try:
        yield
    finally:
        lock_file.unlink(missing_ok=True)
        lock.release()


@contextmanager
def claimed(folder: Path, notes: Path, option: str, check: Callable[[], object]) -> Iterator[None]:
    """Hold a folder for one job, from before any work is done until it is over; the folder is made if need be.

    Folders that were made for this and that nothing came into are removed again.

    :param notes: folder within it for the lock, and for what the job keeps only while it lasts
    :param option: that named the folder, for the message
    :param check: raises where the folder holds what this job must not touch
    :raises InputError: a folder that cannot be made or written to, or that another process holds
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        _make_writable(folder, option)
        if not notes.exists():  # otherwise a job is at work or was killed: the lock says which
            check()
        notes.mkdir(exist_ok=True)
        with one_job(folder, notes / LOCK, option):
            check()
            yield
    finally:
        for path in (notes, *made):
            with suppress(OSError):  # something stands in it
                path.rmdir()


def _make_writable(folder: Path, option: str) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(option, f"{folder}: {error.strerror}", "a folder that can be written") from error
