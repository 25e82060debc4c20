"""Arrays of files from elsewhere: NumPy, MATLAB and HDF5.

SciPy, h5py and NumPy read them in a process of its own (:mod:`trainer.captures.reading_process`). Damaged files can
crash these libraries (SciPy 1.17 and h5py 3.16, a segmentation fault each), and promise arrays beyond all memory: there
that costs one line and not the command.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shared.physics.errors import InputError
from shared.radar.radar import LARGEST_ARRAY

SUFFIXES = (".npy", ".npz", ".mat", ".h5", ".hdf5")
READER = Path(__file__).with_name("reading_process.py")
SECONDS, SLOWEST = 20, 20e6
"""Processor time: the first, and a second for each of these bytes."""
MEMORY = 6 * LARGEST_ARRAY + 2 * 10**9
"""Bytes of the process: a cube in double precision, once more while it is made complex, and the libraries."""


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The file's arrays by their names; that of a .npy is called "array".

    Of .mat and HDF5 they are those of numbers; a structure's or group's are "structure/field". Pairs of "real" and
    "imag" are complex, and arrays of MATLAB 7.3 in MATLAB's order of axes.

    :raises InputError: missing, of another kind, damaged, with objects, or beyond :data:`MEMORY`
    """
    if not path.is_file() or path.suffix not in SUFFIXES:
        raise InputError(path, "no such file of arrays", f"one of {', '.join(SUFFIXES)}")
    with tempfile.TemporaryDirectory() as folder:
        found = Path(folder) / "arrays.npz"
        seconds = int(SECONDS + path.stat().st_size / SLOWEST)
        status, said = run_reader(str(path), str(found), str(MEMORY), str(seconds))
        if status:
            reason = said.decode("utf-8", "replace").strip() if status > 0 else ""
            reason = reason.splitlines()[-1] if reason else f"its library ended with status {status}"
            raise InputError(path, f"not readable: {reason}", f"a whole {path.suffix} file without objects")
        arrays = read_npz(found)
        return {str(name): arrays[f"arr_{number}"] for number, name in enumerate(arrays["names"])}


def run_reader(*arguments: str) -> tuple[int, bytes]:
    """(exit status, what was said on stderr) of :data:`READER`; a signal that ended it is a negative status."""
    # -P: the reader's folder is no place to import from.
    ended = subprocess.run([sys.executable, "-P", str(READER), *arguments], capture_output=True, check=False)
    return ended.returncode, ended.stderr


def read_npz(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of a .npz that this project wrote, read in this process.

    :raises InputError: missing, damaged, or with objects
    """
    try:
        with path.open("rb") as handle, np.load(handle, allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}
    except Exception as error:  # of a damaged file NumPy, zipfile and the decompressors raise all kinds
        raise InputError(path, f"not readable: {error}", "a whole .npz file without objects") from error
