"""One job a folder, local or remote.

A local folder is held by a lock that the system releases with the process. In an object store an object stands for the
lock: it is written on the condition that there is none, and written anew every :data:`BEAT_S` while its job lives.
A claim that has not been written for :data:`LEASE_S`, by the store's clock, is that of a job that was killed, and so is
one of a process of this machine that is gone. Who finds it takes it over, on the condition that it is still the same.

A job that was cut off from the store for longer than that, and goes on, may have a second one beside it. Both make the
same objects: a run is only taken up with the arguments that it was begun with.
"""

from __future__ import annotations

import json
import os
import platform
import tempfile
import threading
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from shared.dataset.locations import Location, RemotePath
from shared.dataset.stores import kept, put_if, remove
from shared.physics.errors import InputError

LOCK = "lock"
BEAT_S = 15.0
LEASE_S = 60.0


@contextmanager
def claimed(folder: Location, notes: Location, option: str, check: Callable[[], object]) -> Iterator[None]:
    """Hold a folder for one job, from before any work is done until it is over; a local one is made if need be.

    Folders that were made for this and that nothing came into are removed again.

    :param notes: folder within it for the lock, and for what the job keeps only while it lasts
    :param option: that named the folder, for the message
    :param check: raises where the folder holds what this job must not touch
    :raises InputError: a folder that cannot be made or written to, or that another process holds
    """
    if isinstance(folder, Path):
        assert isinstance(notes, Path)
        with _claimed_here(folder, notes, option, check):
            yield
        return
    assert isinstance(notes, RemotePath)
    lock = notes / LOCK
    try:
        if kept(lock) is None:  # otherwise a job is at work or was killed: the lock says which
            check()
        claim = _acquired(folder, lock, option)
    except OSError as error:
        raise InputError(option, f"{error.filename}: {error.strerror}", "a folder that can be written") from None
    try:
        check()
        yield
    finally:
        claim.end()


@contextmanager
def _claimed_here(folder: Path, notes: Path, option: str, check: Callable[[], object]) -> Iterator[None]:
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


class _Claim:
    """A lock that is written anew until the job ends."""

    def __init__(self, lock: RemotePath, tag: str) -> None:
        self._lock, self._tag, self._ours = lock, tag, True
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._beat, daemon=True)
        self._thread.start()

    def _beat(self) -> None:
        while not self._over.wait(BEAT_S):
            with suppress(OSError):  # the store is away: the next beat may find it
                tag = put_if(self._lock, _signature(), self._tag)
                if tag is None:
                    self._ours = False
                    return
                self._tag = tag

    def end(self) -> None:
        """Give the folder back."""
        self._over.set()
        self._thread.join()
        if self._ours:
            with suppress(OSError):
                remove(self._lock)


def _acquired(folder: RemotePath, lock: RemotePath, option: str) -> _Claim:
    if tag := put_if(lock, _signature(), None):
        return _Claim(lock, tag)
    found, holder = kept(lock), _holder(lock)
    age = 0.0 if found is None else _age(lock, found.modified.timestamp())
    free = found is None or age > LEASE_S or _is_gone(holder)  # None: given back meanwhile
    if free and (tag := put_if(lock, _signature(), found.tag if found else None)):
        return _Claim(lock, tag)
    problem = f"another process is at work in {folder}, {holder.get('host')} {holder.get('pid')}, seen {age:.0f} s ago"
    expected = f"to wait for it, or until it was not seen for {LEASE_S:.0f} s, or another folder"
    raise InputError(option, problem, expected)


def _signature() -> bytes:
    """Who holds a claim; never the same twice, so that the object's tag changes with every beat."""
    made = {"host": platform.node(), "pid": os.getpid(), "machine": _machine(), "beat": uuid.uuid4().hex}
    return json.dumps(made).encode()


def _holder(lock: RemotePath) -> dict[str, object]:
    try:
        holder = json.loads(lock.read_bytes())
    except (ValueError, OSError):
        return {}
    return holder if isinstance(holder, dict) else {}


def _age(lock: RemotePath, written: float) -> float:
    """Seconds since a lock was written; both times are the store's, whose clock need not be this machine's."""
    probe = lock.parent / f"clock-{uuid.uuid4().hex}"
    put_if(probe, b"", None)
    try:
        found = kept(probe)
        return 0.0 if found is None else found.modified.timestamp() - written
    finally:
        remove(probe)


def _machine() -> str:
    """This boot and namespace of process numbers, "" where the system does not tell: numbers mean nothing elsewhere."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {os.readlink('/proc/self/ns/pid')}"
    except OSError:
        return ""


def _is_gone(holder: dict[str, object]) -> bool:
    """Whether the holder was a process here that is no more."""
    pid = holder.get("pid")
    if not _machine() or holder.get("machine") != _machine() or not isinstance(pid, int):
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    except OSError:
        return False
    return False
