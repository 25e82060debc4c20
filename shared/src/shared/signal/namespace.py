"""One implementation for two libraries: functions that use only what NumPy and torch both spell alike."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

Array = Any
"""A NumPy array or a torch tensor; what goes in comes out."""


def array_namespace(array: Array) -> Any:
    """The library that an array belongs to; torch is never imported for a NumPy array."""
    return np if isinstance(array, np.ndarray) else importlib.import_module(type(array).__module__.partition(".")[0])
