"""The cube of sorted paths on the device, with the bounds of :mod:`datafactory.synthesis.cube`.

The exact kernel makes it of all paths that move: there is one kernel to hold to its bound, and a GPU has the room.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Complex

from datafactory.synthesis.chirps import precision
from datafactory.synthesis.device.arrays import back, repeatable
from datafactory.synthesis.device.chirps import add_by_chirps
from datafactory.synthesis.sorting import FLOAT32_TOLERANCE, SortedPaths
from shared.radar import Radar
from shared.radar.arrays import AntennaArray


def cube_on(
    device: str, paths: SortedPaths, radar: Radar, tolerance: float, array: AntennaArray, intra_chirp: bool
) -> Complex[np.ndarray, "chirps samples channels"]:
    """The sum of all paths, as :func:`datafactory.synthesis.cube.cube_of_sorted` makes it.

    :param device: torch's name of it
    """
    waveform = radar.waveform
    wide = tolerance < FLOAT32_TOLERANCE
    shape = waveform.chirps, waveform.samples, len(array.rx_m), len(array.tx_m)
    moving = [paths.chirps, *(group.paths for group in paths.lines)]
    with repeatable():
        cube = torch.zeros(shape, dtype=torch.complex128 if wide else torch.complex64, device=device)
        for tables, chirps in (([paths.standing], 1), (moving, waveform.chirps)):
            if any(len(table) for table in tables):
                double = precision(tables, waveform, tolerance) == np.complex128
                dtype = torch.complex128 if double else torch.complex64
                add_by_chirps(cube, tables, radar, tolerance, array, intra_chirp, chirps, dtype)
        return back(cube.flatten(2))
