"""The truth's moments on the device: the loop of :mod:`datafactory.synthesis.doppler_moments`, all elements at once.

Which paths are seen, the table of Doppler responses and the matrix of the rows are those of
:mod:`datafactory.synthesis.truth`, and with them the bounds. Every path gets the Doppler terms of the cell's most
demanding one, which is at least as exact.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Complex64, Complex128, Float32, Float64, Int64
from torch import Tensor

from datafactory.paths.table import PathTable
from datafactory.synthesis.device.arrays import back, batches, distances, moved, phasors, repeatable
from datafactory.synthesis.doppler_moments import (
    BINOMIAL,
    BLOCK,
    CELLS_PER_BIN,
    CURVATURE_STEP,
    DELTA_STEP,
    SHIFT_TERMS,
)
from datafactory.synthesis.expansions import doppler_table
from datafactory.synthesis.mid_frame import MidFrame
from datafactory.synthesis.motion import coupling, instants
from datafactory.synthesis.truth import DopplerCell, truth_plan
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar
from shared.signal.sweep import reference_frequency_hz

Elements = tuple[Float64[np.ndarray, "padded 3"], Float64[np.ndarray, "blocks 3"]]
"""The virtual sensor's RX in blocks, the last filled up with its last element, and the centre of each block [m]."""
Table = tuple[int, float, Complex128[Tensor, "q delta doppler_terms"]]
"""Doppler responses and their derivatives, see :func:`datafactory.synthesis.expansions.doppler_table`."""


def _in_blocks(rx: Float64[np.ndarray, "rx 3"]) -> Elements:
    starts = range(0, len(rx), BLOCK)
    centre = np.array([0.5 * (rx[first] + rx[min(first + BLOCK, len(rx)) - 1]) for first in starts])
    return np.concatenate([rx, np.repeat(rx[-1:], -len(rx) % BLOCK, axis=0)]), centre


def truth_on(
    device: str,
    paths: PathTable,
    radar: Radar,
    doppler_cells: Int64[np.ndarray, " rows"],
    terms: int,
    intra_chirp: bool,
) -> Complex64[np.ndarray, "{terms} rows channels"]:
    """Sweep moments of the virtual sensor, as :func:`datafactory.synthesis.truth.truth_moments` makes them.

    :param device: torch's name of it
    """
    waveform, rx = radar.waveform, radar.virtual_sensor.rx
    mid, cells = truth_plan(paths, radar, doppler_cells, terms, intra_chirp)
    most = max((cell.doppler_terms for cell in cells), default=1)
    lowest_q, lowest_delta, responses = doppler_table(mid.curvature, waveform.chirps, most)
    elements = _in_blocks(rx)
    with repeatable():
        table = lowest_q, lowest_delta, moved(responses, device)
        moments = torch.zeros((terms, waveform.range_bins, len(elements[0])), dtype=torch.complex64, device=device)
        for cell in cells:
            grid = _grid_of(cell, mid.take(cell.chosen), elements, table, radar, intra_chirp, device)
            _add_rows(moments, cell, grid, waveform.chirps)
        return back(moments[:, :, : len(rx)])


def _grid_of(
    cell: DopplerCell,
    mid: MidFrame,
    elements: Elements,
    table: Table,
    radar: Radar,
    intra_chirp: bool,
    device: str,
) -> Complex64[Tensor, "needed_cells blocks moments block"]:
    """Moments of a Doppler cell's paths, in the range cells that its rows draw on, in their order."""
    blocks = len(elements[1])
    needed = moved(cell.needed, device)
    at = torch.cumsum(needed, dim=0) - 1
    shape = int(cell.needed.sum()), blocks, SHIFT_TERMS * cell.doppler_terms, BLOCK
    grid = torch.zeros(shape, dtype=torch.complex64, device=device)
    for few in batches(len(mid.amplitude), blocks * shape[2] * BLOCK, device):
        slot, kept, values = _moments(
            mid.take(np.arange(few.start, few.stop)), cell, elements, table, radar, intra_chirp
        )
        kept &= needed[slot]
        block = torch.arange(blocks, device=device).expand_as(slot)
        place = at[slot[kept]] * blocks + block[kept]
        grid.flatten(0, 1).index_add_(0, place, values[kept])
    return grid


def _moments(
    mid: MidFrame, cell: DopplerCell, elements: Elements, table: Table, radar: Radar, intra_chirp: bool
) -> tuple[
    Int64[Tensor, "paths blocks"], Bool[Tensor, "paths blocks"], Complex64[Tensor, "paths blocks moments block"]
]:  # fmt: skip
    """Of every path and block the range cell, whether the table reaches it, and its moments."""
    (rx, centre), (lowest_q, lowest_delta, responses) = elements, table
    waveform, device = radar.waveform, str(responses.device)
    frame_s = waveform.chirps * waveform.chirp_interval_s
    _, lead = instants(radar, intra_chirp)
    cycles_per_metre = reference_frequency_hz(radar) / SPEED_OF_LIGHT
    bins_per_metre = waveform.bandwidth_hz / SPEED_OF_LIGHT
    point, velocity = moved(mid.rx_point, device), moved(mid.rx_velocity, device)
    tx_length, tx_rate = moved(mid.tx_length, device)[:, None], moved(mid.tx_rate, device)[:, None]

    centre_leg, centre_rate = _legs(point, velocity, centre)
    total = cycles_per_metre * frame_s * (tx_rate + centre_rate)
    scaled = 1.0 + coupling(radar) * cell.nu
    delta = scaled * total - cell.frequency
    delta -= waveform.chirps * torch.floor(delta / waveform.chirps + 0.5)
    ranged = tx_length + lead * tx_rate
    range_cell = torch.floor(bins_per_metre * (ranged + centre_leg + lead * centre_rate) * CELLS_PER_BIN + 0.5)
    slot = range_cell.to(torch.int64) % len(cell.needed)
    node = torch.floor((delta - lowest_delta) / DELTA_STEP + 0.5)
    origin = scaled * total - delta + lowest_delta + node * DELTA_STEP

    leg, rate = (part.unflatten(1, (-1, BLOCK)) for part in _legs(point, velocity, rx))
    amplitude = moved(mid.amplitude, device).to(torch.complex64)[:, None, None]
    echo = amplitude * phasors(cycles_per_metre * (tx_length[..., None] + leg), torch.complex64)
    offset = range_cell / CELLS_PER_BIN - bins_per_metre * ranged
    shift = (bins_per_metre * (leg + lead * rate) - offset[..., None]).to(torch.float32)
    depart = scaled * cycles_per_metre * frame_s * (tx_rate[..., None] + rate) - origin[..., None]
    node = node[..., None].to(torch.int64)
    if cell.by_element.any():  # each element of every path at the node nearest to it
        away = torch.floor(depart / DELTA_STEP + 0.5)
        node, depart = node + away.to(torch.int64), depart - away * DELTA_STEP
        period = round(waveform.chirps / DELTA_STEP)  # of few chirps the table holds more than one
        node = node + period * (node < 0) - period * (node >= responses.shape[1])
    inside = (node >= 0) & (node < responses.shape[1])
    curvature = torch.floor(moved(mid.curvature, device) / CURVATURE_STEP + 0.5).to(torch.int64) - lowest_q
    at = curvature.clamp(0, len(responses) - 1)[:, None, None], node.clamp(0, responses.shape[1] - 1)
    response = responses[at] * inside[..., None]
    migration = (coupling(radar) * total).to(torch.float32)[..., None]
    by_doppler = _doppler_factors(response, depart.to(torch.float32), migration, cell.doppler_terms)
    powers = [by_doppler * echo[:, :, None]]
    for _ in range(SHIFT_TERMS - 1):
        powers.append(powers[-1] * shift[:, :, None])
    return slot, inside.any(dim=2), torch.stack(powers, dim=3).flatten(2, 3)


def _doppler_factors(
    response: Complex128[Tensor, "paths blocks points doppler_terms"],
    depart: Float32[Tensor, "paths blocks block"],
    migration: Float32[Tensor, "paths blocks 1"],
    terms: int,
) -> Complex64[Tensor, "paths blocks {terms} block"]:
    """migration^j sum_e C(e, j) G_e d^(e - j) for every j, by Horner's rule."""
    factors, scale = [], torch.ones_like(migration)
    for power in range(terms):
        factor = torch.zeros_like(depart, dtype=torch.complex64)
        for e in range(terms - 1, power - 1, -1):
            factor = factor * depart + (BINOMIAL[e, power] * response[..., e]).to(torch.complex64)
        factors.append(scale * factor)
        scale = scale * migration
    return torch.stack(factors, dim=2)


def _legs(
    point: Float64[Tensor, "paths 3"], velocity: Float64[Tensor, "paths 3"], elements: Float64[np.ndarray, "elements 3"]
) -> tuple[Float64[Tensor, "paths elements"], Float64[Tensor, "paths elements"]]:
    """Lengths between points and elements [m], and their rates [m/s]."""
    length = distances(point[:, None], elements)[:, 0]
    along = (point * velocity).sum(dim=-1, keepdim=True) - velocity @ moved(elements, str(point.device)).T
    return length, along / length.clamp_min(1e-9)


def _add_rows(
    moments: Complex64[Tensor, "terms rows padded"],
    cell: DopplerCell,
    grid: Complex64[Tensor, "needed_cells blocks moments block"],
    chirps: int,
) -> None:
    """Add to the rows of a Doppler cell from the moments around them."""
    device, terms, elements = str(grid.device), moments.shape[0], moments.shape[2]
    at = np.cumsum(cell.needed) - 1
    around = at[(cell.rows[:, None] * CELLS_PER_BIN + cell.around) % len(cell.needed)]
    turn = np.exp(-2j * np.pi * cell.frequency * (chirps // 2) / chirps)
    mixing = moved((turn * (cell.mixing[:terms] + 1j * cell.mixing[terms:])).astype(np.complex64), device)
    rows, chosen = moved(cell.rows, device), moved(around, device)
    for some in batches(len(rows), mixing.shape[1] * elements, device):
        drawn = grid[chosen[some]].permute(0, 1, 3, 2, 4).flatten(3, 4).flatten(1, 2)
        moments[:, rows[some]] += (mixing @ drawn).transpose(0, 1)
