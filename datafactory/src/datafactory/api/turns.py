"""What traces takes turns in a process, which has one tracer.

Mitsuba's kept scenes are moved from pose to pose in place, Sionna's solver is given each frame's rays through its
modules, Dr.Jit and BLAS have one number of threads. Two threads that made frames at once gave each other's echoes, and
nothing failed. A run in one process keeps one core busy as it is, and a run with workers all that it may have.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import wraps
from typing import TypeVar

A = TypeVar("A")
R = TypeVar("R")

_TURN = threading.RLock()
"""Held by the thread that is at work; a callback of its run may ask for more."""


def in_turn(function: Callable[[A], R]) -> Callable[[A], R]:
    """Let a function begin once no other such function is at work in another thread."""

    @wraps(function)
    def called(asked: A) -> R:
        with _TURN:
            return function(asked)

    return called
