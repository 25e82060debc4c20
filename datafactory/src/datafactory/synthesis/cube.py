"""PathTable to radar cube: the IF signal of eq. (1)-(2) for every chirp, sample and channel.

Every path gets the cheapest kernel that keeps the tolerance (:mod:`datafactory.synthesis.sorting`). This is also the
one place that decides by device where cube and truth are made. Weights and error bounds are common to all. On ``"cpu"``
the loops are compiled by numba. On ``"cuda"`` they are torch's (:mod:`datafactory.synthesis.device`), which is imported
only then.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from jaxtyping import Complex, Complex64

from datafactory.defaults import CPU, CUDA, INSTALL_TORCH
from datafactory.paths.table import PathTable
from datafactory.synthesis.chirps import cube_by_chirps, precision
from datafactory.synthesis.frame_lines import add_along_lines
from datafactory.synthesis.motion import Recording
from datafactory.synthesis.sorting import FLOAT32_TOLERANCE, SortedPaths, sorted_paths
from datafactory.synthesis.truth import truth_moments
from shared.physics.errors import InputError
from shared.radar import Radar
from shared.radar.arrays import AntennaArray

SMALLEST_TOLERANCE = 1e-11
"""The rounding of phases of 1e5 cycles in float64."""


def cube_of_paths(
    paths: PathTable,
    radar: Radar,
    tolerance: float = 1e-6,
    array: AntennaArray | None = None,
    threads: int = 1,
    intra_chirp: bool = False,
) -> Complex[np.ndarray, "chirps samples channels"]:
    """Noise-free IF signal of illuminated paths (amplitudes in sqrt(W)).

    :param tolerance: bound on the relative L2 error against the float64 sum; complex64 down to 5e-7, else complex128
    :param array: another array than the radar's own, e.g. its virtual sensor
    :param threads: chirps, or samples, worked on at once
    :param intra_chirp: motion within the chirp (:mod:`datafactory.synthesis.motion`); otherwise eq. (1) and (2)
    :raises ValueError: a tolerance below 1e-11
    """
    if not tolerance >= SMALLEST_TOLERANCE:
        raise ValueError(f"tolerance {tolerance:g}; expected at least {SMALLEST_TOLERANCE:g}")
    radar = radar if array is None else radar.model_copy(update={"array": array})
    recording = Recording(radar, tolerance, intra_chirp)
    return cube_of_sorted(sorted_paths(paths, recording), recording, threads)


def cube_of_sorted(
    paths: SortedPaths, recording: Recording, threads: int
) -> Complex[np.ndarray, "chirps samples channels"]:
    """The sum of all kernels.

    :param threads: chirps, or samples, worked on at once
    """
    waveform, array, tolerance = recording.waveform, recording.array, recording.tolerance
    shape = waveform.chirps, waveform.samples, array.channels

    def exactly(table: PathTable, chirps: int) -> Complex[np.ndarray, "{chirps} samples channels"]:
        dtype = precision([table], waveform, tolerance)
        result = cube_by_chirps(table, recording, threads, chirps, dtype).reshape(chirps, *shape[1:])
        return result if tolerance < FLOAT32_TOLERANCE else result.astype(np.complex64, copy=False)

    moves = bool(len(paths.chirps))
    cube = exactly(paths.chirps, waveform.chirps) if moves else exactly(paths.standing, 1)
    if moves and len(paths.standing):
        cube += exactly(paths.standing, 1)
    elif not moves:
        cube = np.repeat(cube, waveform.chirps, axis=0)
    if paths.lines:
        by_channel = cube.reshape(*shape[:2], len(array.rx_m), len(array.tx_m))
        add_along_lines(by_channel, paths.lines, recording, threads)
    return cube


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

    def cube(paths: SortedPaths, recording: Recording, threads: int) -> Complex[np.ndarray, "chirps samples channels"]:
        return cube_on(device, paths, recording)

    return Kernels(cube, partial(truth_on, device))


@lru_cache(maxsize=1)
def synthesis_problem() -> str | None:
    """Why cube and truth cannot be made with CUDA, in words; None if they can. Asked once a process."""
    try:
        from datafactory.synthesis.device.arrays import cuda_problem
    except ImportError as error:
        return f"torch cannot be imported ({error})"
    return cuda_problem()
