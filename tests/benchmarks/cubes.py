"""Cube and truth against the direct sum, against themselves at other settings, and by torch's kernels.

torch's are on the processor always, on a GPU where there is one.
"""

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from oracles import relative_error
from record import RELATIVE_L2, NotInstalledError, Record, timed
from workloads import EGO_SPEED_MPS, Workload, street

from datafactory.paths.backend import cuda_device
from datafactory.paths.table import PathTable
from datafactory.synthesis.chirps import cube_by_chirps
from datafactory.synthesis.cube import ON_CPU, Kernels, synthesis_problem, torch_kernels
from datafactory.synthesis.motion import Recording
from datafactory.synthesis.sorting import sorted_paths
from shared.signal.imaging import DEFAULT_TERMS
from shared.signal.spectrum import range_doppler, select_doppler


def _ours(work: Workload, tolerance: str = "1e-6") -> str:
    waveform, channels = work.radar.waveform, work.radar.array.channels
    size = f"{work.size.paths} paths x {channels} channels x {waveform.chirps} chirps x {waveform.samples} samples"
    return f"cube_of_paths, {size}, tolerance {tolerance}, 1 thread"


def moving_vs_direct(work: Workload) -> Record:
    """The moving cube against eq. (1) summed in float64."""
    elapsed, cube = work.cube
    direct_time, reference = work.direct
    return Record(
        name="cube_moving_vs_direct",
        ours=_ours(work),
        ours_time=elapsed,
        reference=f"float64 direct sum, {len(reference)} of {work.channel_chirps} channel-chirps, scaled; 1 thread",
        reference_time=direct_time.scaled(work.channel_chirps / len(reference)),
        error=work.error_against_direct(cube),
        error_unit=RELATIVE_L2,
        details={"measured_reference_seconds": direct_time.seconds},
    )


def vs_chirps(work: Workload, tolerance: str) -> Record:
    """All kernels, each path in the cheapest, beside the exact one for all."""
    chirps, recording = work.radar.waveform.chirps, Recording(work.radar, float(tolerance), intra_chirp=False)

    def by_chirps(paths):
        return cube_by_chirps(paths, recording, 1, chirps, np.complex64)

    by_chirps(street(32, EGO_SPEED_MPS))
    elapsed, cube = work.cube_at(float(tolerance))
    reference_time, _ = timed(lambda: by_chirps(work.paths), work.size.repeats)
    return Record(
        name=f"cube_vs_chirps_{tolerance}",
        ours=_ours(work, tolerance),
        ours_time=elapsed,
        reference="cube_by_chirps for every path, the same tolerance; 1 thread",
        reference_time=reference_time,
        error=work.error_against_direct(cube),
        error_unit=f"{RELATIVE_L2} against the float64 sum on {work.size.direct_samples} channel-chirps",
        details=sorted_paths(work.paths, recording).counts(),
    )


TOLERANCE = 1e-3
"""Of the frames of a run."""
Make = Callable[[Kernels, PathTable], NDArray[np.complexfloating]]


def _kernels(device: str) -> tuple[Kernels, str]:
    """torch's kernels, and where they run, in words.

    :raises NotInstalledError: there is no such device
    """
    if device == "cpu":
        torch.set_num_threads(1)
        return torch_kernels(device), f"torch {torch.__version__} on 1 thread"
    if (problem := synthesis_problem()) is not None:
        raise NotInstalledError(f"no CUDA device: {problem}")
    return torch_kernels(device), f"torch {torch.__version__} on {cuda_device().name}"


def cube_on(work: Workload, device: str) -> Record:
    """The moving cube of torch, copied back from a GPU."""

    def make(made_by: Kernels, table: PathTable) -> NDArray[np.complexfloating]:
        recording = Recording(work.radar, TOLERANCE, intra_chirp=False)
        return made_by.cube(sorted_paths(table, recording), recording, 1)

    return _record("cube", f"{work.size.paths} paths, tolerance {TOLERANCE:g}, sorting included", make, work, device)


def truth_on(work: Workload, device: str) -> Record:
    """The moving truth of torch, copied back from a GPU."""
    cells = select_doppler(range_doppler(work.cube[1], work.radar), 0.0, 1).cells[0]

    def make(made_by: Kernels, table: PathTable) -> NDArray[np.complexfloating]:
        return made_by.truth(table, work.radar, cells, DEFAULT_TERMS, intra_chirp=False)

    what = f"{work.size.paths} paths x {work.sensor.channels} channels, a cell a row"
    return _record("truth", what, make, work, device)


def _record(name: str, what: str, make: Make, work: Workload, device: str) -> Record:
    """torch's kernels on a device beside the compiled ones, each compiled before it is timed."""
    kernels, where = _kernels(device)
    for made_by in (kernels, ON_CPU):
        make(made_by, street(32, EGO_SPEED_MPS))
    elapsed, made = timed(lambda: make(kernels, work.paths), work.size.repeats)
    reference_time, reference = timed(lambda: make(ON_CPU, work.paths), work.size.repeats)
    return Record(
        name=f"{name}_on_{'torch' if device == 'cpu' else device}_vs_compiled",
        ours=f"{where}, {what}",
        ours_time=elapsed,
        reference="the compiled kernels, the same; 1 thread",
        reference_time=reference_time,
        error=relative_error(made, reference),
        error_unit=RELATIVE_L2,
    )
