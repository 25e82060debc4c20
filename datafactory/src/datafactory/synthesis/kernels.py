"""Where cube and truth are made: the one place that decides by device.

Weights and error bounds are common to both. On ``"cpu"`` the loops are compiled by numba. On ``"cuda"`` they
are torch's (:mod:`datafactory.synthesis.device`), which is imported only then.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from jaxtyping import Complex, Complex64

from datafactory.paths.defaults import CPU, CUDA, INSTALL_TORCH
from datafactory.synthesis.cube import cube_of_sorted
from datafactory.synthesis.sorting import SortedPaths
from datafactory.synthesis.truth import truth_moments
from shared.physics.errors import InputError
from shared.radar import Radar
from shared.radar.arrays import AntennaArray


@dataclass(frozen=True)
class Kernels:
    """What makes a frame's signals on one device.

    :param cube: as :func:`datafactory.synthesis.cube.cube_of_sorted`
    :param truth: as :func:`datafactory.synthesis.truth.truth_moments`
    """

    cube: Callable[..., Complex[np.ndarray, "chirps samples channels"]]
    truth: Callable[..., Complex64[np.ndarray, "terms rows channels"]]


ON_CPU = Kernels(cube_of_sorted, truth_moments)
"""The compiled kernels."""


def kernels_on(device: str) -> Kernels:
    """The kernels of a device, ``"cpu"`` or ``"cuda"``.

    :raises InputError: torch is missing, or sees no device
    """
    if device == CPU:
        return ON_CPU
    if (problem := synthesis_problem()) is not None:
        raise InputError("--device", f"{device}: {problem}", INSTALL_TORCH)
    return torch_kernels(CUDA)


def torch_kernels(device: str) -> Kernels:
    """torch's kernels on any device that it knows, ``"cpu"`` among them: for ``"cuda"``, and for its tests."""
    from datafactory.synthesis.device.cube import cube_on
    from datafactory.synthesis.device.truth import truth_on

    def cube(
        paths: SortedPaths, radar: Radar, tolerance: float, array: AntennaArray, threads: int, intra_chirp: bool
    ) -> Complex[np.ndarray, "chirps samples channels"]:
        return cube_on(device, paths, radar, tolerance, array, intra_chirp)

    return Kernels(cube, partial(truth_on, device))


@lru_cache(maxsize=1)
def synthesis_problem() -> str | None:
    """Why cube and truth cannot be made with CUDA, in words; None if they can. Asked once a process."""
    try:
        from datafactory.synthesis.device.arrays import cuda_problem
    except ImportError as error:
        return f"torch cannot be imported ({error})"
    return cuda_problem()
