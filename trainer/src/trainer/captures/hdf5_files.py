"""Arrays of HDF5 files, MATLAB's version 7.3 among them.

The HDF5 library is C code that damaged files can crash: a process that read some with bytes exchanged (h5py 3.16) died.
It therefore reads in a process of its own with bounds on memory and processor time
(:mod:`trainer.captures.hdf5_process`), which writes what it finds as a .npz.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from shared.physics.errors import InputError
from trainer.captures.numpy_files import LARGEST_MEMBER, read_npz

SIGNATURE = b"\x89HDF\r\n\x1a\n"
BEGINS = (0, 512)
"""Bytes before the signature: MATLAB puts a text of 512 before it."""
SECONDS, SLOWEST = 20, 20e6
"""Processor time: the first, and a second for each of these bytes."""
MEMORY = 2 * LARGEST_MEMBER + 2 * 10**9
"""Bytes of the process: its arrays, once more while they are written, and what the libraries take."""


def is_hdf5(path: Path) -> bool:
    """Whether the file begins as HDF5 does."""
    with path.open("rb") as handle:
        head = handle.read(max(BEGINS) + len(SIGNATURE))
    return any(head[begin : begin + len(SIGNATURE)] == SIGNATURE for begin in BEGINS)


def read_hdf5(path: Path) -> dict[str, NDArray[Any]]:
    """The file's arrays of numbers by their full names; complex where they are pairs of "real" and "imag".

    MATLAB's come in MATLAB's order of axes.

    :raises InputError: missing, damaged, or with more than :data:`LARGEST_MEMBER` bytes of numbers
    """
    reader = Path(__file__).with_name("hdf5_process.py")
    with tempfile.TemporaryDirectory() as folder:
        found = Path(folder) / "arrays.npz"
        seconds = int(SECONDS + path.stat().st_size / SLOWEST)
        bounds = [str(bound) for bound in (LARGEST_MEMBER, MEMORY, seconds)]
        # -P: the reader's folder is no place to import from.
        command = [sys.executable, "-P", str(reader), str(path), str(found), *bounds]
        ended = subprocess.run(command, capture_output=True, check=False)
        if ended.returncode or not found.is_file():
            reason = ended.stderr.decode("utf-8", "replace").strip() if ended.returncode > 0 else ""
            reason = reason.splitlines()[-1] if reason else f"the HDF5 library ended with status {ended.returncode}"
            raise InputError(path, f"not readable as HDF5: {reason}", "a whole HDF5 or MATLAB 7.3 file")
        return read_npz(found)
