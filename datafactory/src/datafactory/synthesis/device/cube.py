"""The cube of sorted paths on the device, with the bounds of :mod:`datafactory.synthesis.cube`.

The exact kernel makes it of all paths that move: there is one kernel to hold to its bound, and a GPU has the room. It
evaluates every delay for every TX, RX and chirp, as that of :mod:`datafactory.synthesis.chirps` does: equations,
weights and reaches are those of the compiled kernel (:mod:`datafactory.synthesis.spread`), and with them the bound.
What differs is the order of sums."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Complex, Float64
from torch import Tensor

from datafactory.paths.table import PathTable
from datafactory.synthesis.chirps import OVERSAMPLING, exact_blocks, precision
from datafactory.synthesis.device.arrays import Echoes, back, batches, distances, moved, phasors, real_of, repeatable
from datafactory.synthesis.motion import Recording, centre
from datafactory.synthesis.sorting import FLOAT32_TOLERANCE, SortedPaths
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar
from shared.signal.sweep import reference_frequency_hz


def add_by_chirps(
    cube: Complex[Tensor, "chirps samples rx tx"],
    tables: Sequence[PathTable],
    recording: Recording,
    chirps: int,
    dtype: torch.dtype,
) -> None:
    """Add the first chirps of the IF signal to ``cube``; one alone is added to all.

    :param dtype: of the sums, torch.complex64 or torch.complex128
    """
    waveform, array, device = recording.waveform, recording.array, str(cube.device)
    parts, tx_centre = [part for table in tables for part in recording.parts_of(table, chirps)], centre(array.tx)
    after, lead = recording.instants
    echoes = [Echoes.of(part.paths, device) for part in parts]
    cells = OVERSAMPLING * waveform.samples
    # Sample n belongs to nu = (n - N // 2) / N, i.e. to output n - N // 2 of the FFT over the range cells.
    outputs = (torch.arange(waveform.samples, device=device) - waveform.samples // 2) % cells
    for rx_slice, gain, weights in exact_blocks(recording):
        rx, (taps, terms) = array.rx[rx_slice], weights.shape
        of_taps = moved(weights, device).to(dtype)
        for some in batches(chirps, cells * terms * len(rx) * len(array.tx), device):
            count = some.stop - some.start
            shape = count * cells, terms, len(rx), len(array.tx)
            moments = torch.zeros(shape, dtype=dtype, device=device)
            for part, of_part in zip(parts, echoes, strict=True):
                elements = array.tx[part.tx]
                for few in batches(len(of_part), count * terms * len(rx) * len(elements), device):
                    starts, into = part.start[some] + after, moments[..., part.tx]
                    _add_moments(into, of_part.take(few), starts, lead, elements, rx, tx_centre, recording.radar)
            grid = torch.zeros((count, cells, len(rx), len(array.tx)), dtype=dtype, device=device)
            by_cell = moments.reshape(count, cells, *shape[1:])
            for tap in range(taps):
                grid += torch.einsum("p,mgpra->mgra", of_taps[tap], by_cell).roll(tap - taps // 2, dims=1)
            signal = torch.fft.ifft(grid, dim=1, norm="forward")[:, outputs]
            signal *= moved(gain, device).to(real_of(dtype))[:, None, None]
            cube[some if chirps > 1 else slice(None), :, rx_slice] += signal


def _add_moments(
    moments: Complex[Tensor, "chirps_cells terms rx tx"],
    echoes: Echoes,
    time_s: Float64[np.ndarray, " chirps"],
    lead_s: float,
    tx: Float64[np.ndarray, "tx 3"],
    rx: Float64[np.ndarray, "rx 3"],
    tx_centre: Float64[np.ndarray, " 3"],
    radar: Radar,
) -> None:
    """Add A z^p of every path and chirp, p = 0, 1, ..., to its range cell's ``moments``.

    :param time_s: when phases are those of the scene [s]; ranges are those of ``lead_s`` later
    :param tx_centre: with the middle of ``rx`` it chooses the cell
    """
    waveform, device, dtype = radar.waveform, str(echoes.amplitude.device), moments.dtype
    tx_now, rx_now, between_now = echoes.at(moved(time_s, device))
    tx_then, rx_then, between_then = echoes.at(moved(time_s + lead_s, device))
    bins_per_metre = waveform.bandwidth_hz / SPEED_OF_LIGHT
    rx_length = distances(rx_then, centre(rx)[None])
    middle = distances(tx_then, tx_centre[None])[..., 0] + between_then + rx_length[..., 0]
    nearest = torch.floor(bins_per_metre * middle * OVERSAMPLING + 0.5)
    # tau^2 = tau_0 (2 tau - tau_0) + (z / B)^2 with tau_0 the cell's delay; the last term is in the weights.
    slope = waveform.slope_hz_per_s if waveform.residual_video_phase else 0.0
    delay = nearest / (OVERSAMPLING * waveform.bandwidth_hz)
    frequency = ((reference_frequency_hz(radar) - slope * delay) / SPEED_OF_LIGHT)[..., None]
    constant = (0.5 * slope * delay * delay)[..., None]
    tx_leg = distances(tx_now, tx) + between_now[..., None]
    amplitude = echoes.amplitude[:, None, None].to(dtype)
    tx_phasor = amplitude * phasors(frequency * tx_leg + constant, dtype)
    rx_phasor = phasors(frequency * distances(rx_now, rx), dtype)
    departure = bins_per_metre * (distances(tx_then, tx) + between_then[..., None] + rx_length)
    departure -= nearest[..., None] / OVERSAMPLING
    # Each leg's part is small before it is rounded.
    real = real_of(dtype)
    rx_shift = (bins_per_metre * (distances(rx_then, rx) - rx_length)).to(real)
    shift = departure.to(real)[:, :, None, :] + rx_shift[..., None]
    value = tx_phasor[:, :, None, :] * rx_phasor[..., None]
    powers = [value]
    for _ in range(moments.shape[1] - 1):
        powers.append(powers[-1] * shift)
    cells = OVERSAMPLING * waveform.samples
    cell = nearest.to(torch.int64) % cells + torch.arange(len(time_s), device=device) * cells
    moments.index_add_(0, cell.reshape(-1), torch.stack(powers, dim=2).flatten(0, 1))


def cube_on(device: str, paths: SortedPaths, recording: Recording) -> Complex[np.ndarray, "chirps samples channels"]:
    """The sum of all paths, as :func:`datafactory.synthesis.cube.cube_of_sorted` makes it.

    :param device: torch's name of it
    """
    waveform, array, tolerance = recording.waveform, recording.array, recording.tolerance
    wide = tolerance < FLOAT32_TOLERANCE
    shape = waveform.chirps, waveform.samples, len(array.rx_m), len(array.tx_m)
    moving = [paths.chirps, *(group.paths for group in paths.lines)]
    with repeatable():
        cube = torch.zeros(shape, dtype=torch.complex128 if wide else torch.complex64, device=device)
        for tables, chirps in (([paths.standing], 1), (moving, waveform.chirps)):
            if any(len(table) for table in tables):
                double = precision(tables, waveform, tolerance) == np.complex128
                dtype = torch.complex128 if double else torch.complex64
                add_by_chirps(cube, tables, recording, chirps, dtype)
        return back(cube.flatten(2))
