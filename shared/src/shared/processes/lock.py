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
def claimed(folder: Path, notes: Path, option: str, check: Callable[[], object]) -> Iterator[None]:
    """Hold a folder for one job, from before any work is done until it is over; the folder is made if need be.

    Folders that were made for this and that nothing came into are removed again.

    :param notes: folder within it for the lock, and for what the job keeps only while it lasts
    :param option: that named the folder, for the message
    :param check: raises where the folder holds what this job must not touch
    :raises InputError: a folder that cannot be made or written to, or that another process holds
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    lock = FileLock(notes / LOCK)  # the system releases it with the process, however that ends
    try:
        _make_writable(folder, option)
        if not notes.exists():  # otherwise a job is at work or was killed: the lock says which
            check()
        notes.mkdir(exist_ok=True)
        try:
            lock.acquire(blocking=False)
        except Timeout:
            problem = f"another process is at work in {folder}"
            raise InputError(option, problem, "to wait for it, or another folder") from None
        try:
            check()
            yield
        finally:
            (notes / LOCK).unlink(missing_ok=True)
            lock.release()
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
