"""Arrays of numbers in MATLAB files, versions 5 to 7.

SciPy reads them too, but a damaged file ends its process (1.17, a segmentation fault within a thousand of them). The
format: The MathWorks, "MAT-File Format", 2019. A header of 128 bytes, then elements: a tag with type and length, the
data, zeros up to the next multiple of 8. An array is an element of elements: flags, lengths, name, real part, imaginary
part. A file of version 7 packs each array with zlib.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shared.physics.errors import InputError

HEADER = 128
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Element types with numbers, as NumPy names them."""
ARRAY, COMPRESSED = 14, 15
"""Element types that hold others."""
NUMERIC_CLASSES = range(6, 16)
"""Classes of arrays of numbers: double, single, and the integers."""
COMPLEX = 0x0800
"""Flag of an array with an imaginary part."""
LARGEST = 2**28
"""Bytes that a packed array may have."""


def read_complex_arrays(path: Path) -> dict[str, NDArray[np.complex128]]:
    """The file's complex arrays by their names; what else it holds is passed over.

    :raises InputError: missing, damaged, cut short, or of another version
    """
    return {name: values for name, values in read_arrays(path).items() if np.iscomplexobj(values)}


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The file's arrays of numbers by their names, complex128 or of the kind they are stored as; no cells, no text.

    :raises InputError: missing, damaged, cut short, or of another version
    """
    try:
        content = path.read_bytes()
        order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
        if order is None or content[124:126] not in (b"\x00\x01", b"\x01\x00"):
            raise ValueError("no header of version 5 to 7")
        arrays: dict[str, NDArray[Any]] = {}
        for kind, data in _elements(content[HEADER:], order):
            if kind == COMPRESSED:
                ((kind, data),) = _elements(_unpacked(data), order)
            if kind == ARRAY:
                arrays.update(_array(data, order))
    except (OSError, ValueError, struct.error, zlib.error, OverflowError, MemoryError) as error:
        reason = str(error) or type(error).__name__
        raise InputError(path, f"not readable: {reason}", "a whole MATLAB file of version 5 to 7") from error
    return arrays


def _unpacked(data: bytes) -> bytes:
    unpacking = zlib.decompressobj()
    content = unpacking.decompress(data, LARGEST)
    if unpacking.unconsumed_tail:
        raise ValueError(f"an array of more than {LARGEST} bytes")
    if not unpacking.eof:
        raise ValueError("a packed array that was cut short")
    return content


def _elements(content: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """(type, data) of the elements that follow each other."""
    place = 0
    while place < len(content):
        kind, size = struct.unpack_from(f"{order}II", content, place)
        start = place + 8
        if kind >> 16:  # up to four bytes, within the tag
            kind, size, start = kind & 0xFFFF, kind >> 16, place + 4
            if size > 4:
                raise ValueError(f"a short element of {size} bytes")
        if start + size > len(content):
            raise ValueError(f"an element of {size} bytes, of which {len(content) - start} are there")
        yield kind, content[start : start + size]
        end = start + size
        place = end if kind == COMPRESSED else (end + 7) // 8 * 8


def _array(data: bytes, order: str) -> dict[str, NDArray[Any]]:
    """The array by its name; nothing where it is not of numbers."""
    parts = list(_elements(data, order))
    if len(parts) < 4:
        return {}
    flags = int(_numbers(parts[0], order)[0])
    if flags & 0xFF not in NUMERIC_CLASSES or (flags & COMPLEX and len(parts) < 5):
        return {}
    lengths = [int(length) for length in _numbers(parts[1], order)]
    name = parts[2][1].decode("ascii", errors="replace")
    if not flags & COMPLEX:
        if not parts[3][1] and 0 in lengths:
            return {}
        real = _numbers(parts[3], order)
        if min(lengths, default=0) < 0 or len(real) != math.prod(lengths):
            raise ValueError(f"an array of lengths {lengths} with {len(real)} numbers")
        return {name: real.reshape(lengths, order="F")}
    with np.errstate(invalid="ignore"):  # of numbers that are none, NumPy warns as it makes them wider
        real, imaginary = (_numbers(part, order).astype(np.float64) for part in parts[3:5])
    if min(lengths, default=0) < 0 or not len(real) == len(imaginary) == math.prod(lengths):
        raise ValueError(f"an array of lengths {lengths} with {len(real)} real and {len(imaginary)} imaginary parts")
    return {name: (real + 1j * imaginary).reshape(lengths, order="F")}


def _numbers(part: tuple[int, bytes], order: str) -> NDArray[Any]:
    kind, data = part
    if kind not in NUMBERS or len(data) % int(NUMBERS[kind][1:]) or not data:
        raise ValueError(f"{len(data)} bytes of element type {kind}, which are no numbers")
    return np.frombuffer(data, f"{order}{NUMBERS[kind]}")
