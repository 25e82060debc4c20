"""The folder that a command writes into: its own, from before it reads any data until it ends."""

from __future__ import annotations

import errno
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from shared.physics.errors import InputError
from shared.processes.lock import claimed

JOB = ".job"
"""Folder of the lock and of what worker processes are given; it is there only while a command is at work."""


@contextmanager
def output_folder(out: Path, resume: bool, remedy: str = "an empty or new folder") -> Iterator[Path]:
    """Hold the folder for one command; yields the place for what worker processes are given.

    :param resume: the folder may hold something
    :param remedy: what to do about a folder that is not empty
    :raises InputError: a folder that cannot be written, that another process works in, or that is not empty
    """

    def check() -> None:
        if not resume and any(item.name != JOB for item in out.iterdir()):
            raise InputError("--out", f"{out} is not empty", remedy)

    with claimed(out, out / JOB, "--out", check):
        workers = out / JOB / "workers"
        shutil.rmtree(workers, ignore_errors=True)  # of a command that was killed
        try:
            yield workers
        except OSError as error:
            if error.filename is not None:
                raise
            # What a library writes, TensorBoard for one, does not say where.
            reason = error.strerror or " ".join(str(error).split())
            raise OSError(error.errno or errno.EIO, reason, str(out)) from error
