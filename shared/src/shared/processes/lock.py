"""One job a folder: a lock that a crash releases."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from shared.physics.errors import InputError


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
        folder = lock_file.parent
        raise InputError(
            option, f"another process is at work in {folder}", "to wait for it, or another folder"
        ) from None
    try:
        yield
    finally:
        lock_file.unlink(missing_ok=True)
        lock.release()
