"""The process that reads an HDF5 file: arguments are the file, the .npz to write, and bounds on bytes and seconds.

It is run as a file of its own, and imports nothing of this project: see :mod:`trainer.captures.hdf5_files`.
"""

from __future__ import annotations

import resource
import sys
from typing import Any

import h5py
import numpy as np

REFUSED = 3
"""Exit status where the library, or a bound, said no; the reason stands on stderr."""


def arrays_of(path: str, most: int) -> dict[str, Any]:
    """The arrays of numbers by their full names; complex where they are pairs of "real" and "imag".

    :param most: bytes of all together
    """
    arrays: dict[str, Any] = {}

    def look(name: str, item: object) -> None:
        nonlocal most
        if not isinstance(item, h5py.Dataset) or item.shape is None:
            return
        pair = item.dtype.names == ("real", "imag")
        if not pair and item.dtype.kind not in "iufc":
            return
        most -= item.size * item.dtype.itemsize
        if most < 0:
            raise ValueError(f"more than there is room for, with {name}")
        values = item[()]
        if pair:
            values = values["real"] + 1j * values["imag"]
        arrays[name] = values.T if "MATLAB_class" in item.attrs else values

    with h5py.File(path, "r") as file:
        file.visititems(look)
    return arrays


def main(path: str, found: str, most: str, memory: str, seconds: str) -> int:
    """Exit status."""
    resource.setrlimit(resource.RLIMIT_AS, (int(memory), int(memory)))
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds)))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        np.savez(found, allow_pickle=False, **arrays_of(path, int(most)))
    except Exception as error:  # of a damaged file h5py raises all kinds
        print(str(error) or type(error).__name__, file=sys.stderr)
        return REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
