"""One implementation for two libraries: functions that use only what NumPy and torch both spell alike."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

Array = Any
"""A NumPy array or a torch tensor; what goes in comes out."""


def array_namespace(array: Array) -> Any:
    """The library that an array belongs to; torch is never imported for a NumPy array."""
    return np if isinstance(array, np.ndarray) else importlib.import_module(type(array).__module__.partition(".")[0])


@contextmanager
def one_thread(library: Any) -> Iterator[None]:
    """LAPACK on one thread: on small matrices two cost more than they save.

    Where another process has one of two cores, 1890 inverses of 18 x 18 take torch 0.03 to 1.5 s with two threads,
    which wait for each other at every matrix, and 0.014 s with one.
    """
    if not hasattr(library, "set_num_threads"):
        yield
        return
    threads = library.get_num_threads()
    library.set_num_threads(1)
    try:
        yield
    finally:
        library.set_num_threads(threads)
