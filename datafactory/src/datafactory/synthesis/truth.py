"""The truth: the virtual sensor's image of the same paths, each row in the Doppler cell that the input selected.

The virtual sensor's cube (256 channels x 128 chirps) is never computed. An image row needs one Doppler cell only, and a
path contributes only to rows near its range. With eta = (m - M/2) / M the position in the frame, nu that in the sweep,
and the delay developed around mid-frame (tau_c there, Doppler f_c in bins, curvature q in cycles), element c receives
from path k

    A exp(j 2 pi (f_0 + B nu) tau_c) exp(j 2 pi ((1 + nu B / f_0) f_c eta + q eta^2))

and the Doppler filter of cell m turns the second factor into G(f_c - m + kappa nu, q) with kappa = f_c B / f_0, the
range migration in bins over the frame, and

    G(delta, q) = sum_m w_m exp(j 2 pi (delta eta_m + q eta_m^2)) / sum_m w_m.

G is tabulated with its derivatives. Over a block of neighbouring elements f_c varies little, so that G is a polynomial
in (f_c - f) + kappa nu. The factor of the range remainder is a polynomial in z (:mod:`shared.signal.sweep`). For each
path and Doppler cell a few moments per element are added to a grid of range cells. The cells around each row then give
the row.

A path enters only where it is seen (:mod:`datafactory.synthesis.mid_frame`), with as many terms of the Doppler
polynomial as its own place and speed call for.

Limits: velocities are constant. The delay's third derivative within a frame is left out (2.4e-6 m at 3 m and 10 m/s).
Ranges are cyclic, as in the cube: row 0 is next to the last range bin, and an echo from beyond the unambiguous range
folds. ``tests/datafactory/synthesis/test_truth.py`` compares the image with the cube's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import factorial

import numpy as np
from jaxtyping import Bool, Complex64, Complex128, Float32, Float64, Int64

from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.doppler_moments import (
    BINOMIAL,
    BLOCK,
    CELLS_PER_BIN,
    CURVATURE_STEP,
    DELTA_STEP,
    MAX_DOPPLER_TERMS,
    SHIFT_TERMS,
    Frame,
    add_doppler_moments,
)
from datafactory.synthesis.mid_frame import DOPPLER_REACH, ROW_REACH, MidFrame, at_mid_frame, seen_paths
from datafactory.synthesis.motion import coupling, instants
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar
from shared.radar.waveform import Waveform
from shared.signal.imaging import DEFAULT_TERMS, WALK_REACH
from shared.signal.sweep import reference_frequency_hz, shift_polynomials, sweep_positions
from shared.signal.windows import unit_hann

DOPPLER_ERROR = 1e-2
"""Bound on the Doppler polynomial's error, relative to the path's own amplitude. It is reached by the element farthest
from its block's centre and the path farthest from its node alone: with 3e-3 eight munich frames were not nearer to the
reference, and a fifth dearer."""


def truth_moments(
    paths: PathTable,
    radar: Radar,
    doppler_cells: Int64[np.ndarray, " rows"],
    terms: int = DEFAULT_TERMS,
    intra_chirp: bool = False,
) -> Complex64[np.ndarray, "{terms} rows channels"]:
    """Sweep moments of the virtual sensor, each row in its own Doppler cell.

    :param paths: illuminated paths, amplitudes in sqrt(W)
    :param doppler_cells: index on the radar's velocity axis for each image row
    :param intra_chirp: motion within the chirp
    :returns: what :func:`shared.signal.imaging.near_field_images` takes
    """
    array, waveform = radar.virtual_sensor, radar.waveform
    mid, path_terms, cells = truth_plan(paths, radar, doppler_cells, terms, intra_chirp)
    table = doppler_table(mid.curvature, waveform.chirps, int(path_terms.max(initial=1)))
    moments = np.zeros((terms, waveform.range_bins, array.channels), dtype=np.complex64)
    workspace = np.empty(waveform.samples * CELLS_PER_BIN * SHIFT_TERMS * table[2].shape[2] * 2 * BLOCK, np.float32)
    for cell in cells:
        _fill_rows(moments, cell, mid.take(cell.chosen), path_terms[cell.chosen], table, radar, intra_chirp, workspace)
    return moments


@dataclass(frozen=True)
class DopplerCell:
    """A Doppler cell in which rows stand.

    :param frequency: [bins]
    :param chosen: paths that are seen in it; ``needed`` range cells that its rows draw on
    :param doppler_terms: as many as the paths chosen call for
    :param mixing: from the moments around a row to the row
    """

    frequency: float
    rows: Int64[np.ndarray, " rows"]
    chosen: Int64[np.ndarray, " chosen"]
    needed: Bool[np.ndarray, " cells"]
    doppler_terms: int
    mixing: Float32[np.ndarray, "outputs inputs"]


def truth_plan(
    paths: PathTable,
    radar: Radar,
    doppler_cells: Int64[np.ndarray, " rows"],
    terms: int = DEFAULT_TERMS,
    intra_chirp: bool = False,
) -> tuple[MidFrame, Int64[np.ndarray, " paths"], list[DopplerCell]]:
    """The paths that are seen somewhere, the Doppler terms of each, and the Doppler cells in which some are seen.

    Arguments as in :func:`truth_moments`.
    """
    waveform, array = radar.waveform, radar.virtual_sensor
    if len(array.tx_m) != 1:
        raise ValueError(f"the virtual sensor has {len(array.tx_m)} TX; expected 1")
    tx = array.tx[0]
    both = ScatteredPaths.joined([paths.scattered, paths.specular.as_scattered(tx)])
    mid = at_mid_frame(both, radar, tx, array.rx.mean(axis=0), intra_chirp)
    # Neighbours in range share cells, and the cache.
    mid = mid.take(np.argsort(mid.range_bins % waveform.samples, kind="stable"))
    used = np.unique(doppler_cells)
    seen = seen_paths(mid, radar, doppler_cells)[used]
    anywhere = seen.any(axis=0)
    mid, seen = mid.take(np.flatnonzero(anywhere)), np.compress(anywhere, seen, axis=1)
    path_terms = _doppler_terms(mid, waveform.chirps)
    cells, around = waveform.samples * CELLS_PER_BIN, around_row(waveform.samples)
    result, mixing = list[DopplerCell](), dict[int, Float32[np.ndarray, "outputs inputs"]]()
    for index, in_this_one in zip(used, seen, strict=True):
        chosen = np.flatnonzero(in_this_one)
        if not len(chosen):
            continue
        rows = np.flatnonzero(doppler_cells == index)
        needed = np.zeros(cells, dtype=bool)
        needed[(rows[:, None] * CELLS_PER_BIN + around) % cells] = True
        count = int(path_terms[chosen].max())
        if count not in mixing:
            mixing[count] = _mixing_matrix(waveform, terms, count)
        result.append(DopplerCell(float(index - waveform.chirps // 2), rows, chosen, needed, count, mixing[count]))
    return mid, path_terms, result


def _fill_rows(
    moments: Complex64[np.ndarray, "terms rows channels"],
    cell: DopplerCell,
    mid: MidFrame,
    path_terms: Int64[np.ndarray, " paths"],
    table: tuple[int, float, Complex128[np.ndarray, "q delta doppler_terms"]],
    radar: Radar,
    intra_chirp: bool,
    workspace: Float32[np.ndarray, " most"],
) -> None:
    """Fill ``moments`` in the rows of a Doppler cell, block by block.

    :param mid, path_terms: of the paths that are seen in it, which stand together in memory for all blocks
    :param workspace: for any cell's grid
    """
    waveform, terms, array = radar.waveform, len(moments), radar.virtual_sensor
    _, lead = instants(radar, intra_chirp)
    frame = Frame(
        cell.frequency, float(waveform.chirps), waveform.chirps * waveform.chirp_interval_s,
        reference_frequency_hz(radar), waveform.bandwidth_hz, lead, coupling(radar),
    )  # fmt: skip
    offsets = around_row(waveform.samples)
    shape = len(cell.needed), cell.doppler_terms * SHIFT_TERMS * 2 * BLOCK
    grid = workspace[: int(np.prod(shape))].reshape(shape)
    products = np.empty((len(cell.rows), 2 * terms, 2 * BLOCK), dtype=np.float32)
    turn = np.exp(-2j * np.pi * cell.frequency * (waveform.chirps // 2) / waveform.chirps).astype(np.complex64)
    all_rx = array.rx
    for first in range(0, array.channels, BLOCK):
        block = slice(first, min(first + BLOCK, array.channels))
        rx = all_rx[block]
        centre = 0.5 * (rx[0] + rx[-1])
        elements = np.concatenate([rx, np.repeat(rx[-1:], BLOCK - len(rx), axis=0)]) - centre
        grid[cell.needed] = 0.0
        add_doppler_moments(mid, path_terms, (elements, centre), frame, cell.needed, table, BINOMIAL, grid)
        for row, product in zip(cell.rows, products, strict=True):
            around = _cyclic_slice(grid, row * CELLS_PER_BIN + offsets).reshape(cell.mixing.shape[1], -1)
            np.matmul(cell.mixing, around, out=product)
        (re_re, re_im), (im_re, im_im) = products.reshape(-1, 2, terms, 2, BLOCK)[..., : len(rx)].transpose(
            1, 3, 2, 0, 4
        )
        moments[:, cell.rows, block] = turn * (re_re - im_im + 1j * (re_im + im_re))


def _doppler_terms(mid: MidFrame, chirps: int) -> Int64[np.ndarray, " paths"]:
    """Terms of the Doppler polynomial of every path so that its remainder stays below DOPPLER_ERROR.

    With s the largest departure from the expansion point, the remainder of E terms is at most
    (2 pi s)^E / E! sum w |eta|^E / sum w.
    """
    if not np.any(mid.doppler) and not np.any(mid.rx_velocity):
        return np.ones(len(mid.doppler), dtype=np.int64)
    eta = np.abs(_frame_positions(chirps))
    window = unit_hann(chirps)
    departure = mid.departure + 0.5 * DELTA_STEP
    result = np.full(len(departure), MAX_DOPPLER_TERMS)
    for count in range(MAX_DOPPLER_TERMS - 1, 1, -1):
        result[(2.0 * np.pi * departure) ** count / factorial(count) * (window @ eta**count) < DOPPLER_ERROR] = count
    return result


def _frame_positions(chirps: int) -> Float64[np.ndarray, " {chirps}"]:
    return (np.arange(chirps) - chirps // 2) / chirps


def doppler_table(
    curvature: Float64[np.ndarray, " paths"], chirps: int, terms: int
) -> tuple[int, float, Complex128[np.ndarray, "q delta {terms}"]]:
    """First curvature index, first delta, and G with its derivatives over their factorials."""
    lowest = int(np.rint(curvature.min(initial=0.0) / CURVATURE_STEP))
    highest = int(np.rint(curvature.max(initial=0.0) / CURVATURE_STEP))
    # Beyond 16 cycles an echo covers the whole Doppler axis; that needs a target that fast nearer than a metre.
    lowest, highest = max(lowest, -512), min(highest, 512)
    q = CURVATURE_STEP * np.arange(lowest, highest + 1)
    delta = np.arange(-DOPPLER_REACH - 1.0, DOPPLER_REACH + 1.0 + DELTA_STEP, DELTA_STEP)
    eta = _frame_positions(chirps)
    window = unit_hann(chirps)
    table = np.empty((len(q), len(delta), terms), dtype=np.complex128)
    kernel = np.exp(2j * np.pi * delta[:, None] * eta)
    bend = window * np.exp(2j * np.pi * q[:, None] * eta**2)
    for e in range(terms):
        table[:, :, e] = (bend * (2j * np.pi * eta) ** e / factorial(e)) @ kernel.T
    return lowest, float(delta[0]), table


@lru_cache(maxsize=2 * MAX_DOPPLER_TERMS)
def _mixing_matrix(waveform: Waveform, terms: int, doppler_terms: int) -> Float32[np.ndarray, "2*{terms} inputs"]:
    """The matrix from the moments of the cells around a row, [offset, Doppler term, shift term], to its sweep moments.

    sum_n w_n / sum(w) walk_t(nu) shift_p(nu) nu^j exp(j 2 pi nu (cell - row)); first the real, then the imaginary
    parts.
    """
    samples = waveform.samples
    nu = sweep_positions(samples)
    window = unit_hann(samples)
    offset = around_row(samples) / CELLS_PER_BIN
    walk = shift_polynomials(nu, WALK_REACH, terms) * window
    shift = shift_polynomials(nu, _shift_reach(waveform), SHIFT_TERMS)
    powers = nu ** np.arange(doppler_terms)[:, None]
    kernel = np.exp(2j * np.pi * offset[:, None] * nu)
    mixing = np.einsum("tn,on,pn,jn->tojp", walk, kernel, shift, powers, optimize=True).reshape(terms, -1)
    matrix = np.concatenate([mixing.real, mixing.imag]).astype(np.float32)
    matrix.setflags(write=False)
    return matrix


def around_row(samples: int) -> Int64[np.ndarray, " offsets"]:
    """Offsets from a row's own cell to the cells that contribute to it; on a short range axis each cell once."""
    cells = samples * CELLS_PER_BIN
    reach = min(ROW_REACH * CELLS_PER_BIN, cells // 2)
    return np.arange(-reach, reach + 1)[:cells]


def _cyclic_slice(
    grid: Float32[np.ndarray, "cells moments"], cells: Int64[np.ndarray, " chosen"]
) -> Float32[np.ndarray, "chosen moments"]:
    """The grid at consecutive cells, a view where they do not cross its ends."""
    first, last = int(cells[0]), int(cells[-1])
    return grid[first : last + 1] if first >= 0 and last < len(grid) else grid[cells % len(grid)]


def _shift_reach(waveform: Waveform) -> float:
    half_block = 0.5 * (BLOCK - 1) * SPEED_OF_LIGHT / (2.0 * waveform.carrier_hz)
    return 0.5 / CELLS_PER_BIN + half_block * waveform.bandwidth_hz / SPEED_OF_LIGHT
