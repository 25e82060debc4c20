"""The decorator of every numba kernel: compiled code is kept on disk where that is possible.

numba looks for a folder that it can write: ``NUMBA_CACHE_DIR``, then ``__pycache__`` beside the source, then the user's
cache folder. Where there is none, as in a read-only installation, it refuses to make the function. Such a function is
compiled in every process instead.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numba


def compiled(cache: bool = True, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorate a function to be compiled by numba without Python objects.

    :param cache: keep the machine code on disk; False for functions that are only compiled into others
    :param options: of :func:`numba.njit`
    """

    def decorate(function: Callable[..., Any]) -> Any:
        kernel = inspect.unwrap(function)  # numba cannot compile the wrapper of a type checker
        if cache:
            try:
                return numba.njit(cache=True, **options)(kernel)
            except RuntimeError as error:
                if "cannot cache function" not in str(error):
                    raise
        return numba.njit(**options)(kernel)

    return decorate
