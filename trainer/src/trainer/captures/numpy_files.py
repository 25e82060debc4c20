"""NumPy files from elsewhere: no code in them is run, and nothing is set aside before it is known to be there."""

from __future__ import annotations

import lzma
import math
import struct
import tokenize
import warnings
import zipfile
import zlib
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from shared.physics.errors import InputError
from shared.radar.radar import LARGEST_ARRAY

LARGEST_MEMBER = 3 * LARGEST_ARRAY
"""Bytes that an array of a .npz may unpack to: a cube in double precision, and what stands beside it."""

# What NumPy, zipfile and the decompressors raise for damaged files. RuntimeError: encrypted, or nested too deeply.
_DAMAGED = (
    *(OSError, ValueError, EOFError, KeyError, TypeError, SyntaxError, RuntimeError, OverflowError, MemoryError),
    *(struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error, lzma.LZMAError),
)


def read_npy(path: Path) -> NDArray[Any]:
    """The array of a .npy file.

    :raises InputError: missing, damaged, cut short, or with objects
    """
    try:
        with path.open("rb") as handle:
            return _array(handle, path.stat().st_size)
    except _DAMAGED as error:
        raise _not_readable(path, error) from error


def read_npz(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of a .npz file by their names.

    :raises InputError: missing, damaged, cut short, with objects, or with arrays of more than :data:`LARGEST_MEMBER`
    """
    try:
        with zipfile.ZipFile(path) as archive:
            return {item.filename.removesuffix(".npy"): _member(archive, item) for item in archive.infolist()}
    except _DAMAGED as error:
        raise _not_readable(path, error) from error


def _member(archive: zipfile.ZipFile, item: zipfile.ZipInfo) -> NDArray[Any]:
    if item.file_size > LARGEST_MEMBER:
        size, most = item.file_size / 1e9, LARGEST_MEMBER / 1e9
        raise ValueError(f"{item.filename} unpacks to {size:.3g} GB, more than {most:g}")
    with archive.open(item) as handle:
        return _array(handle, item.file_size)


def _array(handle: IO[bytes], size: int) -> NDArray[Any]:
    """The array of an open file of ``size`` bytes, at its begin."""
    read_header = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a header of Python 2
        version = npy.read_magic(handle)
        if version not in read_header:
            raise ValueError(f"format version {version}")
        shape, _, dtype = read_header[version](handle)
        if dtype.hasobject:
            raise ValueError("it holds objects, not numbers")
        promised, there = math.prod(shape) * dtype.itemsize, size - handle.tell()
        if promised != there:
            raise ValueError(f"its header promises {promised} bytes of numbers, there are {there}")
        handle.seek(0)
        return np.asarray(npy.read_array(handle, allow_pickle=False))


def _not_readable(path: Path, error: BaseException) -> InputError:
    reason = str(error) or type(error).__name__
    return InputError(path, f"not readable as NumPy: {reason}", "a whole .npy or .npz without objects")
