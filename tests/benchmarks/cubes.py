"""Cube synthesis against the direct sum, FINUFFT, itself at other settings, and the machine's limits."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
from machine import copy_bytes_per_second, gemm_flops_per_second
from record import RELATIVE_L2, Record, Timing, relative_l2, timed
from references import direct_sum, nufft_sum
from workloads import EGO_SPEED_MPS, SEED, Workload, by_range, street

from datafactory.synthesis.chirps import OVERSAMPLING, cube_by_chirps, terms_for
from datafactory.synthesis.cube import cube_of_paths
from datafactory.synthesis.parts import BLOCK_REACH_BINS
from datafactory.synthesis.sorting import sorted_paths
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar

NUFFT_TOLERANCE = 1e-6
NUFFT = "FINUFFT 1D type 1, float64, 1e-6, delays and phases compiled and included, paths sorted beforehand"
STATIC_DIRECT_CHANNELS = 2
BYTES_PER_PATH = 8 * (4 * 3 + 2 + 2)
"""Four vectors, the length between and its rate, and the amplitude, in float64."""


def _ours(work: Workload, tolerance: str = "1e-6", threads: int = 1) -> str:
    waveform, channels = work.radar.waveform, work.radar.array.channels
    size = f"{work.size.paths} paths x {channels} channels x {waveform.chirps} chirps x {waveform.samples} samples"
    return f"cube_of_paths, {size}, tolerance {tolerance}, {threads} thread{'s' if threads > 1 else ''}"


def moving_vs_direct(work: Workload) -> Record:
    """The moving cube against eq. (1) summed in float64, and its peak memory in a process of its own."""
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
        details={"measured_reference_seconds": direct_time.seconds, "peak_memory_mb": peak_memory_mb(work.size.paths)},
    )


def peak_memory_mb(paths: int) -> float:
    """Largest resident size [MB] of a process that does nothing but make the moving cube."""
    script = Path(__file__).with_name("peak_memory.py")
    done = subprocess.run([sys.executable, str(script), str(paths)], capture_output=True, text=True, check=True)
    return float(done.stdout)


def moving_vs_finufft(work: Workload) -> Record:
    """The moving cube against one NUFFT per channel and chirp."""
    elapsed, cube = work.cube
    pairs = work.sample(work.size.nufft_samples)
    radar, paths = work.radar, by_range(work.paths)
    nufft_sum(paths, radar, radar.array, *pairs[0], NUFFT_TOLERANCE)

    def sums():
        return [nufft_sum(paths, radar, radar.array, *pair, NUFFT_TOLERANCE) for pair in pairs]

    nufft_time, results = timed(sums, 3)
    transform_seconds = sum(transform for _, transform in results)
    scale = work.channel_chirps / len(pairs)
    ours = np.stack([cube[chirp, :, channel] for channel, chirp in pairs])
    return Record(
        name="cube_moving_vs_finufft",
        ours=_ours(work),
        ours_time=elapsed,
        reference=f"{NUFFT}, {len(pairs)} of {work.channel_chirps} channel-chirps, scaled; 1 thread",
        reference_time=nufft_time.scaled(scale),
        error=relative_l2(ours, np.stack([signal for signal, _ in results])),
        error_unit=RELATIVE_L2,
        details={
            "measured_reference_seconds": nufft_time.seconds,
            "transforms_alone_cpu_seconds": transform_seconds * scale,
            "transforms_alone_cpu_ratio": transform_seconds * scale / elapsed.cpu_seconds,
        },
    )


def static_vs_finufft(work: Workload) -> Record:
    """One chirp of the virtual sensor, nothing moving, against one NUFFT per channel."""
    radar = Radar(waveform=work.radar.waveform.model_copy(update={"chirps": 1}))
    array, paths = work.sensor, street(work.size.paths, 0.0)
    cube_of_paths(street(32, 0.0), radar, array=array)
    elapsed, cube = timed(lambda: cube_of_paths(paths, radar, array=array), max(work.size.repeats, 3))
    ordered = by_range(paths)
    nufft_sum(ordered, radar, array, 0, 0, NUFFT_TOLERANCE)

    def sums():
        return [nufft_sum(ordered, radar, array, channel, 0, NUFFT_TOLERANCE) for channel in range(array.channels)]

    nufft_time, results = timed(sums, 1)
    transform_seconds = sum(transform for _, transform in results)
    chosen = np.random.default_rng(SEED).choice(array.channels, STATIC_DIRECT_CHANNELS, replace=False)
    reference = np.stack([direct_sum(paths, radar, array, int(channel), 0) for channel in chosen])
    return Record(
        name="cube_static_vs_finufft",
        ours=f"cube_of_paths, {work.size.paths} paths x {array.channels} channels x 1 chirp, tolerance 1e-6, 1 thread",
        ours_time=elapsed,
        reference=f"{NUFFT}, all {array.channels} channels; 1 thread",
        reference_time=nufft_time,
        error=relative_l2(cube[0][:, chosen].T, reference),
        error_unit=f"{RELATIVE_L2} against the float64 sum on {STATIC_DIRECT_CHANNELS} channels",
        details={
            "transforms_alone_cpu_seconds": transform_seconds,
            "transforms_alone_cpu_ratio": transform_seconds / elapsed.cpu_seconds,
        },
    )


def two_threads_vs_one(work: Workload) -> Record:
    """The moving cube on two threads."""
    elapsed, cube = work.cube_at(1e-6, threads=2)
    one_time, one = work.cube
    return Record(
        name="cube_two_threads_vs_one",
        ours=_ours(work, threads=2),
        ours_time=elapsed,
        reference="the same on 1 thread",
        reference_time=one_time,
        error=relative_l2(cube, one),
        error_unit=RELATIVE_L2,
    )


def tolerance_1e_3(work: Workload) -> Record:
    """What a looser tolerance saves."""
    return _tolerance_record(work, "1e-3")


def tolerance_1e_9(work: Workload) -> Record:
    """What complex128 costs."""
    return _tolerance_record(work, "1e-9")


def _tolerance_record(work: Workload, tolerance: str) -> Record:
    elapsed, cube = work.cube_at(float(tolerance))
    return Record(
        name=f"cube_tolerance_{tolerance}_vs_1e-6",
        ours=f"{_ours(work, tolerance)}, {cube.dtype}",
        ours_time=elapsed,
        reference="the same at 1e-6, complex64",
        reference_time=work.cube[0],
        error=work.error_against_direct(cube),
        error_unit=f"{RELATIVE_L2} against the float64 sum on {work.size.direct_samples} channel-chirps",
    )


def vs_chirps_1e_6(work: Workload) -> Record:
    """All kernels, each path in the cheapest, beside the exact one for all."""
    return _kernel_record(work, "1e-6")


def vs_chirps_1e_4(work: Workload) -> Record:
    """The same at a looser tolerance."""
    return _kernel_record(work, "1e-4")


def _kernel_record(work: Workload, tolerance: str) -> Record:
    radar, chirps = work.radar, work.radar.waveform.chirps

    def by_chirps(paths):
        return cube_by_chirps(paths, radar, float(tolerance), radar.array, 1, False, chirps, np.complex64)

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
        details=sorted_paths(work.paths, radar, float(tolerance), radar.array, intra_chirp=False).counts(),
    )


def _terms(work: Workload) -> int:
    """Moments a path and channel at 1e-6, when all RX form one block."""
    array, bandwidth_hz = work.radar.array, work.radar.waveform.bandwidth_hz
    reach = [0.5 * float(np.ptp(part, axis=0).max()) * bandwidth_hz / SPEED_OF_LIGHT for part in (array.tx, array.rx)]
    if reach[1] > BLOCK_REACH_BINS:
        raise ValueError(f"the RX reach {reach[1]:.3f} bins; expected one block of at most {BLOCK_REACH_BINS}")
    return terms_for(0.5 / OVERSAMPLING + sum(reach), 1e-6, work.radar.waveform.samples)


def vs_gemm_limit(work: Workload) -> Record:
    """The moving cube's counted operations at the rate of a complex matrix product: a bound no product can beat."""
    elapsed, cube = work.cube
    terms, cells = _terms(work), OVERSAMPLING * work.radar.waveform.samples
    # A multiplication and an addition for each real part of each moment; 5 N log2 N operations for each channel's FFT.
    moments = 2.0 * 2.0 * terms * work.size.paths * work.channel_chirps
    transforms = 5.0 * cells * math.log2(cells) * work.channel_chirps
    rate = gemm_flops_per_second(work.size.gemm)
    limit = (moments + transforms) / rate
    return Record(
        name="cube_vs_gemm_limit",
        ours=_ours(work),
        ours_time=elapsed,
        reference="moments and FFTs, operations counted, at the rate of a complex64 matrix product; 1 thread",
        reference_time=Timing(limit, limit),
        error=work.error_against_direct(cube),
        error_unit=f"{RELATIVE_L2} against the float64 sum on {work.size.direct_samples} channel-chirps",
        details={"moment_gflop": moments / 1e9, "fft_gflop": transforms / 1e9, "gemm_gflops": rate / 1e9},
    )


def vs_copy_limit(work: Workload) -> Record:
    """The bytes that the moving cube must move through memory at the rate of a copy."""
    elapsed, cube = work.cube
    waveform = work.radar.waveform
    grid = 8.0 * OVERSAMPLING * waveform.samples * _terms(work) * work.channel_chirps
    table = float(BYTES_PER_PATH * work.size.paths * waveform.chirps)
    moved = table + 2.0 * grid + cube.nbytes
    rate = copy_bytes_per_second(work.size.copy_mb)
    return Record(
        name="cube_vs_copy_limit",
        ours=_ours(work),
        ours_time=elapsed,
        reference="paths read every chirp, moments written and read, cube written, at the rate of a copy; 1 thread",
        reference_time=Timing(moved / rate, moved / rate),
        error=work.error_against_direct(cube),
        error_unit=f"{RELATIVE_L2} against the float64 sum on {work.size.direct_samples} channel-chirps",
        details={"moved_gb": moved / 1e9, "copy_gb_per_second": rate / 1e9},
    )
