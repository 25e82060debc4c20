"""The process that reads a file of arrays: arguments are the file, the .npz to write, and bounds on bytes and seconds.

It is run as a file of its own, and imports nothing of this project: see :mod:`trainer.captures.reading`.
"""

from __future__ import annotations

import resource
import sys
from typing import Any

import numpy as np

REFUSED = 3
"""Exit status where the library, or a bound, said no; the last line on stderr is the reason."""


def arrays_of(path: str) -> dict[str, Any]:
    """The arrays by their names. Only the library that is needed is imported: each takes some 0.2 s."""
    if path.endswith((".npy", ".npz")):
        loaded = np.load(path, allow_pickle=False)
        return {"array": loaded} if isinstance(loaded, np.ndarray) else dict(loaded)
    import h5py

    if not path.endswith(".mat") or h5py.is_hdf5(path):  # MATLAB's version 7.3 is HDF5
        return of_hdf5(path)
    import scipy.io

    arrays: dict[str, Any] = {}
    for name, values in scipy.io.loadmat(path).items():
        of_structure(name, values, arrays)
    return arrays


def of_structure(name: str, values: object, arrays: dict[str, Any]) -> None:
    """Put the arrays of numbers of a MATLAB variable into ``arrays``, by the names that they have in HDF5."""
    if not isinstance(values, np.ndarray):
        return
    if is_numeric(values):
        arrays[name] = values
    elif values.dtype.names and values.size == 1:  # a structure; of an array of them no field is one array
        for field in values.dtype.names:
            of_structure(f"{name}/{field}", values[field].flat[0], arrays)


def of_hdf5(path: str) -> dict[str, Any]:
    """The arrays of numbers by their full names; complex where they are pairs of "real" and "imag"."""
    import h5py

    arrays: dict[str, Any] = {}

    def look(name: str, item: object) -> None:
        if not isinstance(item, h5py.Dataset) or item.shape is None:
            return
        pair = item.dtype.names == ("real", "imag")
        if not pair and not is_numeric(item):
            return
        values = item[()]
        if pair:
            values = values["real"] + 1j * values["imag"]
        arrays[name] = values.T if "MATLAB_class" in item.attrs else values

    with h5py.File(path, "r") as file:
        file.visititems(look)
    return arrays


def is_numeric(values: Any) -> bool:
    """Whether these are integers, real or complex numbers."""
    return values.dtype.kind in "iufc"


def main(path: str, found: str, memory: str, seconds: str) -> int:
    """Exit status."""
    resource.setrlimit(resource.RLIMIT_AS, (int(memory), int(memory)))
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds)))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        arrays = arrays_of(path)
        # Apart from their names, of which any is allowed, "file" too.
        np.savez(found, *arrays.values(), names=np.array(list(arrays), dtype=str), allow_pickle=False)
    except Exception as error:  # of a damaged file the libraries raise all kinds
        print(" ".join(f"{error}".split()) or type(error).__name__, file=sys.stderr, end="")
        return REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
