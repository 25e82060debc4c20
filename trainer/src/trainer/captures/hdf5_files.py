"""Arrays of HDF5 files, MATLAB's version 7.3 among them.

The HDF5 library (tried: h5py 3.16) crashes or hangs on some damaged files, among a few thousand of them. It therefore
reads in a process of its own, with bounds on its memory and time: this module, run with the names of two files. What it
finds it writes as a .npz, which the caller reads.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shared.physics.errors import InputError
from trainer.captures.numpy_files import LARGEST_MEMBER, read_npz

SIGNATURE = b"\x89HDF\r\n\x1a\n"
BEGINS = (0, 512)
"""Bytes before the signature: MATLAB puts a text of 512 before it."""
SECONDS = 20
SLOWEST = 20e6
"""Bytes a second that are read at least, after :data:`SECONDS`."""
MEMORY = 2 * LARGEST_MEMBER + 2 * 10**9
"""Bytes of the process: its arrays, once more while they are written, and what the libraries take."""
NOTHING_MORE, REFUSED = 0, 3


def is_hdf5(path: Path) -> bool:
    """Whether the file begins as HDF5 does."""
    with path.open("rb") as handle:
        head = handle.read(max(BEGINS) + len(SIGNATURE))
    return any(head[begin : begin + len(SIGNATURE)] == SIGNATURE for begin in BEGINS)


def read_hdf5(path: Path) -> dict[str, NDArray[Any]]:
    """The file's arrays of numbers by their full names; complex where they are pairs of "real" and "imag".

    MATLAB's come in MATLAB's order of axes.

    :raises InputError: missing, damaged, or with an array of more than :data:`LARGEST_MEMBER` bytes
    """
    with tempfile.TemporaryDirectory() as folder:
        found = Path(folder) / "arrays.npz"
        command = [sys.executable, "-m", __name__, str(path), str(found)]
        limit = SECONDS + path.stat().st_size / SLOWEST
        try:
            ended = subprocess.run(command, capture_output=True, text=True, timeout=limit, check=False)
        except subprocess.TimeoutExpired as error:
            raise _not_readable(path, f"not read within {limit:.0f} s") from error
        if ended.returncode == REFUSED:
            raise _not_readable(path, ended.stderr.strip())
        if ended.returncode != NOTHING_MORE or not found.is_file():
            raise _not_readable(path, f"the HDF5 library ended with status {ended.returncode}")
        return read_npz(found)


def _not_readable(path: Path, reason: str) -> InputError:
    return InputError(path, f"not readable as HDF5: {reason}", "a whole HDF5 or MATLAB 7.3 file")


def _main(path: str, found: str) -> int:
    import h5py

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    arrays: dict[str, NDArray[Any]] = {}
    left = LARGEST_MEMBER

    def look(name: str, item: object) -> None:
        nonlocal left
        if not isinstance(item, h5py.Dataset) or item.shape is None:
            return
        kind, pair = item.dtype.kind, item.dtype.names == ("real", "imag")
        if not pair and kind not in "iufc":
            return
        left -= item.size * item.dtype.itemsize
        if left < 0:
            raise ValueError(f"arrays of more than {LARGEST_MEMBER / 1e9:g} GB, with {name}")
        values = item[()]
        if pair:
            values = values["real"] + 1j * values["imag"]
        arrays[name] = values.T if "MATLAB_class" in item.attrs else values

    try:
        with h5py.File(path, "r") as file:
            file.visititems(look)
        np.savez(found, allow_pickle=False, **arrays)
    except Exception as error:  # of a damaged file h5py raises all kinds
        print(str(error) or type(error).__name__, file=sys.stderr)
        return REFUSED
    return NOTHING_MORE


if __name__ == "__main__":
    sys.exit(_main(sys.argv[1], sys.argv[2]))
