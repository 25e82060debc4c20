"""What stops a run that was started well."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class TrainingStopped(RuntimeError):
    """What cannot go on, in one line: a loss that is not finite with its frames, an export that is not the network."""


@contextmanager
def writing(path: Path) -> Iterator[Path]:
    """A name beside ``path`` to write to, renamed to it at the end: the file is whole or not there at all.

    :raises OSError: the disk is full or fails; it names the file, which a write by itself does not
    """
    partial = path.with_name(path.name + ".partial")
    try:
        yield partial
        partial.replace(path)
    except OSError as error:
        reason = error.strerror or " ".join(str(error).split())
        raise OSError(error.errno or errno.EIO, reason, str(path)) from error
    finally:
        partial.unlink(missing_ok=True)
