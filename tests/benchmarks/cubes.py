"""Cube synthesis against the direct sum and against itself at other settings."""

from __future__ import annotations

import numpy as np
from record import RELATIVE_L2, Record, timed
from workloads import EGO_SPEED_MPS, Workload, street

from datafactory.synthesis.chirps import cube_by_chirps
from datafactory.synthesis.motion import Recording
from datafactory.synthesis.sorting import sorted_paths


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
