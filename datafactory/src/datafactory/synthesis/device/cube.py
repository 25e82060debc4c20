"""The cube of sorted paths on the device: the kernels of :mod:`datafactory.synthesis.cube`, with the same bounds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Complex, Complex64, Float32, Int64
from torch import Tensor

from datafactory.synthesis.chirps import precision
from datafactory.synthesis.device.arrays import back, batches, moved, phasors, repeatable
from datafactory.synthesis.device.chirps import add_by_chirps
from datafactory.synthesis.device.lines import spread
from datafactory.synthesis.frame_lines import block_plans, turns
from datafactory.synthesis.motion import coupling
from datafactory.synthesis.slow_time import LINE_OVERSAMPLING, line_gain
from datafactory.synthesis.sorting import FLOAT32_TOLERANCE, PathsAlongLines, SortedPaths
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.signal.sweep import sweep_positions

GRID_BYTES = 1e9
"""Of the grid of lines that is held at a time."""
_TORCH = {np.complex64: torch.complex64, np.complex128: torch.complex128}


def cube_on(
    device: str, paths: SortedPaths, radar: Radar, tolerance: float, array: AntennaArray, intra_chirp: bool
) -> Complex[np.ndarray, "chirps samples channels"]:
    """The sum of all kernels, as :func:`datafactory.synthesis.cube.cube_of_sorted` makes it.

    :param device: torch's name of it
    """
    waveform = radar.waveform
    wide = tolerance < FLOAT32_TOLERANCE
    shape = waveform.chirps, waveform.samples, len(array.rx_m), len(array.tx_m)
    with repeatable():
        cube = torch.zeros(shape, dtype=torch.complex128 if wide else torch.complex64, device=device)
        for table, chirps in ((paths.standing, 1), (paths.chirps, waveform.chirps)):
            if len(table):
                dtype = _TORCH[precision(table, waveform, tolerance)]
                add_by_chirps(cube, table, radar, tolerance, array, intra_chirp, chirps, dtype)
        if paths.lines:
            _add_along_lines(cube, paths.lines, radar, array, tolerance, intra_chirp)
        return back(cube.flatten(2))


def _add_along_lines(
    cube: Complex64[Tensor, "chirps samples rx tx"],
    groups: Sequence[PathsAlongLines],
    radar: Radar,
    array: AntennaArray,
    tolerance: float,
    intra_chirp: bool,
) -> None:
    """Add the paths of groups, as :func:`datafactory.synthesis.frame_lines.add_along_lines` does."""
    device, gain_taps = str(cube.device), groups[0].weights.gain_taps
    for plan in block_plans(groups, radar, array, tolerance, intra_chirp):
        rx = array.rx[plan.rx]
        line_bytes = plan.cells * len(rx) * len(array.tx_m) * 8
        for lines, chosen in turns(plan.jobs, max(int(GRID_BYTES / line_bytes), 1)):
            shape = len(lines), plan.cells, len(rx), len(array.tx_m)
            grid = torch.zeros(shape, dtype=torch.complex64, device=device)
            for job, some in chosen:
                spread(grid, job, some, lines, plan.weights, radar, array, rx, intra_chirp)
            fast_time = _fast_time(grid, plan.gain)
            _add_chirps(cube[:, :, plan.rx], fast_time, lines, gain_taps, radar)


def _fast_time(
    grid: Complex64[Tensor, "lines cells rx tx"], gain: Float32[np.ndarray, " samples"]
) -> Complex64[Tensor, "samples lines rx tx"]:
    """F_l[n] of every line."""
    samples, cells = len(gain), grid.shape[1]
    # Sample n belongs to nu = (n - N // 2) / N, i.e. to output n - N // 2 of the FFT over the range cells.
    outputs = (torch.arange(samples, device=grid.device) - samples // 2) % cells
    spectrum = torch.fft.ifft(grid, dim=1, norm="forward")[:, outputs].transpose(0, 1)
    return spectrum * moved(gain, str(grid.device))[:, None, None, None]


def _add_chirps(
    cube: Complex64[Tensor, "chirps samples rx tx"],
    fast_time: Complex64[Tensor, "samples lines rx tx"],
    lines: Int64[np.ndarray, " lines"],
    gain_taps: int,
    radar: Radar,
) -> None:
    """Add all chirps of every sample: s[m, n] = gain(eta') sum_l F_l[n] exp(j 2 pi f_l eta')."""
    waveform, device = radar.waveform, str(cube.device)
    eta = (np.arange(waveform.chirps) - waveform.chirps // 2) / waveform.chirps
    scale = 1.0 + coupling(radar) * sweep_positions(waveform.samples)
    frequency = moved(lines / LINE_OVERSAMPLING, device)
    channels = fast_time.shape[2] * fast_time.shape[3]
    for some in batches(waveform.samples, waveform.chirps * (len(lines) + channels), device):
        scaled = scale[some, None] * eta
        gain = moved(line_gain(scaled.ravel(), gain_taps).astype(np.float32), device).reshape(scaled.shape)
        rows = phasors(moved(scaled, device)[..., None] * frequency, torch.complex64) * gain[..., None]
        product = rows @ fast_time[some].flatten(2)
        cube[:, some] += product.transpose(0, 1).reshape(cube[:, some].shape)
