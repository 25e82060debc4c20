"""Finished cells of a sweep on disk, so that a run which was killed goes on where it was.

A cell is the result of one (experiment, method, array, condition), a few arrays, and stands in one file of its own
whose name is a hash of all that the result depends on. A file is written beside its name, then renamed: there is no
half cell.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shared.dataset.documents import code_fingerprint, digest
from shared.dataset.writing import atomic
from shared.physics.errors import InputError
from trainer.captures.reading import read_npz

Values = Mapping[str, NDArray[Any]]
"""Named arrays, numbers among them as arrays without axes."""


def cell_name(family: str, *identity: str) -> str:
    """Name of a cell's file.

    :param family: of cells, before the hash
    :param identity: what one cell depends on: names of method and array, what was varied, a fingerprint of data,
        weights and settings. That of the code is added.
    """
    return f"{family}-{digest([family, *identity, code_fingerprint('shared', 'trainer')])[:24]}.npz"


class CellStore:
    """The finished cells of one output folder.

    :param directory: folder of the cells, made if it is not there
    :ivar computed: cells filled by this process
    :ivar kept: cells found finished
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.computed = 0
        self.kept = 0
        self._used: set[str] = set()
        directory.mkdir(parents=True, exist_ok=True)

    def finished(self, name: str) -> Values | None:
        """The arrays of a cell if it was finished before.

        :param name: see :func:`cell_name`
        :raises InputError: a file of the folder that is damaged
        """
        path = self.directory / name
        again = path.name in self._used
        self._used.add(path.name)
        if not path.is_file():
            return None
        self.kept += not again
        try:
            return read_npz(path)
        except InputError as error:
            raise InputError(
                path, f"damaged ({error})", "a finished cell; delete the file to compute it anew"
            ) from error

    def keep(self, name: str, computed: Values) -> Values:
        """The arrays of a cell that was computed, once they are on disk."""
        path = self.directory / name
        values = {name: np.asarray(value) for name, value in computed.items()}
        with atomic(path) as partial, partial.open("wb") as handle:
            np.savez(handle, allow_pickle=False, **values)
        self.computed += 1
        return values

    @property
    def unused(self) -> int:
        """Cells on disk that nothing has asked for: of other methods, settings or data."""
        return sum(path.name not in self._used for path in self.directory.glob("*.npz"))
