"""Echoes to a grid of range cells and Doppler lines on the device, as :mod:`datafactory.synthesis.lines` has it.

The weights of lines and cells are those of the compiled kernel, and with them the bound. Here many paths are worked on
at once: values at the nodes, a matrix product for the weights of the lines, then one sum into the grid.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Complex64, Float32, Float64, Int64
from torch import Tensor

from datafactory.synthesis.device.arrays import batches, moved, phasors
from datafactory.synthesis.device.echoes import Echoes, distances
from datafactory.synthesis.frame_lines import Job
from datafactory.synthesis.motion import coupling, instants
from datafactory.synthesis.parts import centre
from datafactory.synthesis.slow_time import LineWeights, applied
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.signal.sweep import reference_frequency_hz


def spread(
    grid: Complex64[Tensor, "lines cells rx tx"],
    job: Job,
    chosen: Int64[np.ndarray, " chosen"],
    lines: Int64[np.ndarray, " lines"],
    weights: Float32[np.ndarray, "taps terms"],
    radar: Radar,
    array: AntennaArray,
    rx: Float64[np.ndarray, "rx 3"],
    intra_chirp: bool,
) -> None:
    """Add some paths of a job to the grid, which is cyclic in its cells.

    :param lines: the grid's, in spacings
    :param weights: of the range's shift
    """
    device, cells, tx = str(grid.device), grid.shape[1], array.tx[job.part.tx]
    of_lines, of_cells = _matrix(job.group.weights, device), _derivatives(weights, job.group.orders, device)
    echoes = Echoes.of(job.part.paths.take(chosen), device)
    anchor, bends = moved(job.anchor[chosen], device), moved(job.motion.bend[:, chosen], device)
    first = moved(np.searchsorted(lines, job.first[chosen]), device)
    line, tap = torch.arange(len(of_lines), device=device), torch.arange(len(weights), device=device)
    flat = grid.flatten(0, 1)[..., job.part.tx]
    start = float(job.part.start[radar.waveform.chirps // 2])
    for few in batches(len(chosen), len(line) * len(tap) * len(rx) * len(tx), device):
        nearest, shift, values = _seen(
            echoes.take(few), anchor[few], bends[:, few], job, cells, start, radar, array, rx, intra_chirp
        )
        line_weights = torch.einsum("ln,koncd->klocd", of_lines, values)
        powers = shift[..., None] ** torch.arange(weights.shape[1], device=device)
        cell_weights = torch.einsum("kcdp,ogp->kogcd", powers, of_cells)
        spread_out = line_weights[:, :, None, 0] * cell_weights[:, None, 0]
        for order in range(1, job.group.orders):
            spread_out += line_weights[:, :, None, order] * cell_weights[:, None, order]
        cell = (nearest[:, None] + tap - len(tap) // 2) % cells
        place = (first[few, None, None] + line[:, None]) * cells + cell[:, None]
        flat.index_add_(0, place.reshape(-1), spread_out.flatten(0, 2))


def _matrix(weights: LineWeights, device: str) -> Complex64[Tensor, "taps nodes"]:
    """What turns values at the nodes into weights of lines."""
    return moved(applied(weights, np.eye(len(weights.node), dtype=np.complex128)).astype(np.complex64), device)


def _derivatives(
    weights: Float32[np.ndarray, "taps terms"], orders: int, device: str
) -> Float32[Tensor, "{orders} taps terms"]:
    """Coefficients of the cells' weights as polynomials of the shift, of their derivatives and half of the second."""
    result = np.zeros((orders, *weights.shape), dtype=np.float32)
    result[0] = weights
    for order in range(1, orders):
        # The n-th derivative over n! has (p + 1) / n of the coefficient that the one before has a power higher.
        power = np.arange(1, weights.shape[1], dtype=np.float32)
        result[order, :, :-1] = result[order - 1, :, 1:] * power / order
    return moved(result, device)


def _seen(
    echoes: Echoes,
    anchor: Float64[Tensor, " paths"],
    bends: Float64[Tensor, "6 paths"],
    job: Job,
    cells: int,
    start_s: float,
    radar: Radar,
    array: AntennaArray,
    rx: Float64[np.ndarray, "rx 3"],
    intra_chirp: bool,
) -> tuple[
    Int64[Tensor, " paths"], Float32[Tensor, "paths rx tx"], Complex64[Tensor, "paths orders nodes rx tx"]
]:  # fmt: skip
    """Of every path the range cell, what the elements see beyond it [bins], and its values at the nodes.

    The values of the first order, then times e, then times e^2 - j g / pi.
    """
    waveform, device = radar.waveform, str(anchor.device)
    tx, tx_centre, rx_centre = array.tx[job.part.tx], centre(array.tx), centre(rx)
    after, lead = instants(radar, intra_chirp)
    mid_time = start_s + after
    then = echoes.at(torch.tensor([mid_time + lead], dtype=torch.float64, device=device))
    bins_per_metre, oversampling = waveform.bandwidth_hz / SPEED_OF_LIGHT, cells / waveform.samples
    rx_leg = distances(then.rx_point, rx_centre[None])
    # The bend's mean over the frame is a range like any other.
    mean = bends[1, :, None, None] / 12.0
    link = then.between[..., None]
    middle = bins_per_metre * (distances(then.tx_point, tx_centre[None]) + link + rx_leg) + mean
    nearest = torch.floor(middle * oversampling + 0.5)
    departure = bins_per_metre * (distances(then.tx_point, tx) + link + rx_leg) + mean - nearest / oversampling
    shift = departure[:, 0, None, :] + bins_per_metre * (distances(then.rx_point, rx) - rx_leg)[:, 0, :, None]

    eta = moved(job.group.weights.node, device)
    frame_s = waveform.chirps * waveform.chirp_interval_s
    now = echoes.at(mid_time + eta * frame_s)
    slope = waveform.slope_hz_per_s if waveform.residual_video_phase else 0.0
    delay = nearest / (oversampling * waveform.bandwidth_hz)
    frequency = (reference_frequency_hz(radar) - slope * delay) / SPEED_OF_LIGHT
    constant = 0.5 * slope * delay * delay - (anchor[:, None] * eta)[..., None]
    tx_cycles = frequency * (distances(now.tx_point, tx) + now.between[..., None]) + constant
    tx_value = echoes.amplitude[:, None, None] * phasors(tx_cycles, torch.complex128)
    rx_value = phasors(frequency * distances(now.rx_point, rx), torch.complex64)
    value = tx_value.to(torch.complex64)[:, :, None, :] * rx_value[..., None]

    orders, values, square = job.group.orders, [value], eta * eta - 1.0 / 12.0
    if orders > 1:
        e_1, e_2, e_3, g_1, g_2, g_3 = bends[:, :, None]
        bend = (eta * (e_1 + e_3 * eta * eta) + e_2 * square).to(torch.float32)[..., None, None]
        if orders > 2:
            scaling = (eta * (g_1 + eta * (g_2 + eta * g_3)) / torch.pi).to(torch.float32)[..., None, None]
            tilt, dish = _elements_apart(echoes, mid_time, lead, tx, rx, array, radar)
            shift = shift + dish / 12.0
            own = tilt[:, None] * eta[:, None, None] + dish[:, None] * square[:, None, None]
            bend = bend + own.to(torch.float32)
        values.append(value * bend)
        if orders > 2:
            values.append(value * torch.complex(bend * bend, (-scaling).expand_as(bend)))
    return nearest[:, 0, 0].to(torch.int64), shift.to(torch.float32), torch.stack(values, dim=1)


def _elements_apart(
    echoes: Echoes,
    mid_time: float,
    lead: float,
    tx: Float64[np.ndarray, "tx 3"],
    rx: Float64[np.ndarray, "rx 3"],
    array: AntennaArray,
    radar: Radar,
) -> tuple[Float64[Tensor, "paths rx tx"], Float64[Tensor, "paths rx tx"]]:
    """What every element's e has beyond that of the centres: coefficients of eta and of eta^2 - 1/12.

    :param lead: time by which ranges precede phases [s]
    """
    waveform = radar.waveform
    frame_s = waveform.chirps * waveform.chirp_interval_s
    per_rate = coupling(radar) * reference_frequency_hz(radar) / SPEED_OF_LIGHT * frame_s
    per_bend = 0.5 * frame_s * per_rate
    # The phase's part; where ranges precede phases, then the range's part, at its own time.
    parts = [(0.0, 0.0, -per_bend)]
    if lead > 0.0:
        parts = [(0.0, -per_rate, -2.0 * per_bend), (lead, per_rate, per_bend)]
    device = str(echoes.amplitude.device)
    tilt, dish = torch.zeros((2, len(echoes), len(rx), len(tx)), dtype=torch.float64, device=device)
    for later, of_rate, of_bend in parts:
        at = echoes.at(torch.tensor([mid_time + later], dtype=torch.float64, device=device))
        tx_rate, tx_bend = _rate_and_bend(at.tx_point[:, 0], echoes.tx_velocity, tx, centre(array.tx))
        rx_rate, rx_bend = _rate_and_bend(at.rx_point[:, 0], echoes.rx_velocity, rx, centre(rx))
        tilt = tilt + of_rate * (tx_rate[:, None, :] + rx_rate[:, :, None])
        dish = dish + of_bend * (tx_bend[:, None, :] + rx_bend[:, :, None])
    return tilt, dish


def _rate_and_bend(
    point: Float64[Tensor, "paths 3"],
    velocity: Float64[Tensor, "paths 3"],
    elements: Float64[np.ndarray, "elements 3"],
    middle: Float64[np.ndarray, " 3"],
) -> tuple[Float64[Tensor, "paths elements"], Float64[Tensor, "paths elements"]]:
    """First and second derivative of the length between moving points and elements, less those of the centre."""
    every = np.concatenate([middle[None], elements])
    apart = point[:, None] - moved(every, str(point.device))
    length = torch.linalg.vector_norm(apart, dim=-1).clamp_min(1e-9)
    rate = (apart @ velocity[:, :, None])[..., 0] / length
    bend = ((velocity**2).sum(dim=-1, keepdim=True) - rate**2) / length
    return rate[:, 1:] - rate[:, :1], bend[:, 1:] - bend[:, :1]
