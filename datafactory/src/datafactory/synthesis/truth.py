"""The truth: the virtual sensor's image of the same paths, each row in the Doppler cell that the input selected.

The virtual sensor's cube (256 channels x 128 chirps) is never computed. An image row needs one Doppler cell only, and a
path contributes only to rows near its range. With eta = (m - M/2) / M the position in the frame, nu that in the sweep,
and the delay developed around mid-frame (tau_c there, Doppler f_c in bins, curvature q in cycles), element c receives
from path k

    A exp(j 2 pi (f_0 + B nu) tau_c) exp(j 2 pi ((1 + nu B / f_0) f_c eta + q eta^2))

and the Doppler filter of cell m turns the second factor into G(f_c - m + f_c kappa nu, q) with kappa = B / f_0 and so
f_c kappa, the range migration in bins over the frame, and

    G(delta, q) = sum_m w_m exp(j 2 pi (delta eta_m + q eta_m^2)) / sum_m w_m.

G is tabulated with its derivatives. Over a block of neighbouring elements f_c varies little, so that G is a polynomial
in (f_c - f) + f_c kappa nu. The factor of the range remainder is a polynomial in z (:mod:`shared.signal.sweep`). For
each path and Doppler cell a few moments per element are added to a grid of range cells. The cells around each row then
give the row.

A path enters only where it is seen (:mod:`datafactory.synthesis.mid_frame`), with as many terms of the Doppler
polynomial as its own place and speed call for, and where it crosses many range bins, with the sweep in bands, each with
its own f_c (1 + kappa nu_b) to develop around (:mod:`datafactory.synthesis.expansions`).

Limits: velocities are constant. The delay's third derivative within a frame is left out (2.4e-6 m at 3 m and 10 m/s).
Ranges are cyclic, as in the cube: row 0 is next to the last range bin, and an echo from beyond the unambiguous range
folds. ``tests/datafactory/synthesis/test_truth.py`` compares the image with the cube's own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Complex64, Complex128, Float32, Int64

from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.doppler_moments import (
    BINOMIAL,
    BLOCK,
    CELLS_PER_BIN,
    SHIFT_TERMS,
    Frame,
    add_doppler_moments,
)
from datafactory.synthesis.expansions import Expansions, doppler_table
from datafactory.synthesis.mid_frame import ROW_REACH, MidFrame, at_mid_frame, seen_paths
from datafactory.synthesis.motion import coupling, instants
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar
from shared.radar.waveform import Waveform
from shared.signal.imaging import DEFAULT_TERMS, walk_reach
from shared.signal.sweep import reference_frequency_hz, shift_polynomials, sweep_positions
from shared.signal.windows import unit_hann


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
    mid, cells = truth_plan(paths, radar, doppler_cells, terms, intra_chirp)
    table = doppler_table(mid.curvature, waveform.chirps, max((cell.doppler_terms for cell in cells), default=1))
    moments = np.zeros((terms, waveform.range_bins, array.channels), dtype=np.complex64)
    workspace = np.empty(waveform.samples * CELLS_PER_BIN * SHIFT_TERMS * table[2].shape[2] * 2 * BLOCK, np.float32)
    for cell in cells:
        _add_rows(moments, cell, mid.take(cell.chosen), table, radar, intra_chirp, workspace)
    return moments


@dataclass(frozen=True)
class DopplerCell:
    """A Doppler cell in which rows stand, in a band of the sweep, and paths that are seen there.

    :param frequency: [bins]; :param nu: place in the sweep, the band's centre
    :param chosen: the paths; ``path_terms`` Doppler terms of each, ``doppler_terms`` the most; ``by_element``
        whether every element has its own point of expansion
    :param around: offsets from a row to the range cells that it draws on, ``needed`` those of all rows
    :param mixing: from the moments around a row to the row
    """

    frequency: float
    nu: float
    rows: Int64[np.ndarray, " rows"]
    chosen: Int64[np.ndarray, " chosen"]
    path_terms: Int64[np.ndarray, " chosen"]
    doppler_terms: int
    by_element: Bool[np.ndarray, " chosen"]
    around: Int64[np.ndarray, " offsets"]
    needed: Bool[np.ndarray, " cells"]
    mixing: Float32[np.ndarray, "outputs inputs"]


def truth_plan(
    paths: PathTable,
    radar: Radar,
    doppler_cells: Int64[np.ndarray, " rows"],
    terms: int = DEFAULT_TERMS,
    intra_chirp: bool = False,
) -> tuple[MidFrame, list[DopplerCell]]:
    """The paths that are seen somewhere, and the Doppler cells in which some are seen.

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
    used, expansions = np.unique(doppler_cells), Expansions.of(mid, waveform)
    smeared = np.where(expansions.bands > 1, 0.5 * mid.migration, 0.0)
    seen = seen_paths(mid, smeared, radar, doppler_cells)[used]
    anywhere = seen.any(axis=0)
    mid, seen = mid.take(np.flatnonzero(anywhere)), np.compress(anywhere, seen, axis=1)
    expansions, smeared, cells = expansions.take(anywhere), smeared[anywhere], waveform.samples * CELLS_PER_BIN
    result, reach = list[DopplerCell](), walk_reach(radar)
    for index, in_this_one in zip(used, seen, strict=True):
        rows = np.flatnonzero(doppler_cells == index)
        for bands, chosen, path_terms in expansions.groups(np.flatnonzero(in_this_one)):
            by_element, smear = expansions.by_element[chosen], math.ceil(smeared[chosen].max())
            frequency, count = float(index - waveform.chirps // 2), int(path_terms.max())
            around, needed = _around_row(waveform.samples, smear), np.zeros(cells, dtype=bool)
            needed[(rows[:, None] * CELLS_PER_BIN + around) % cells] = True
            for band in range(bands):
                nu, mixing = _mixing_matrix(waveform, reach, terms, count, smear, bands, band)
                result.append(
                    DopplerCell(frequency, nu, rows, chosen, path_terms, count, by_element, around, needed, mixing)
                )
    return mid, result


def _add_rows(
    moments: Complex64[np.ndarray, "terms rows channels"],
    cell: DopplerCell,
    mid: MidFrame,
    table: tuple[int, float, Complex128[np.ndarray, "q delta doppler_terms"]],
    radar: Radar,
    intra_chirp: bool,
    workspace: Float32[np.ndarray, " most"],
) -> None:
    """Add to ``moments`` in the rows of a Doppler cell, block by block.

    :param mid: the paths that are seen in it, which stand together in memory for all blocks
    :param workspace: for any cell's grid
    """
    waveform, terms, array = radar.waveform, len(moments), radar.virtual_sensor
    _, lead = instants(radar, intra_chirp)
    frame = Frame(
        cell.frequency, cell.nu, float(waveform.chirps), waveform.chirps * waveform.chirp_interval_s,
        reference_frequency_hz(radar), waveform.bandwidth_hz, lead, coupling(radar),
    )  # fmt: skip
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
        add_doppler_moments(
            mid, cell.path_terms, cell.by_element, (elements, centre), frame, cell.needed, table, BINOMIAL, grid
        )
        for row, product in zip(cell.rows, products, strict=True):
            around = _cyclic_slice(grid, row * CELLS_PER_BIN + cell.around).reshape(cell.mixing.shape[1], -1)
            np.matmul(cell.mixing, around, out=product)
        (re_re, re_im), (im_re, im_im) = products.reshape(-1, 2, terms, 2, BLOCK)[..., : len(rx)].transpose(
            1, 3, 2, 0, 4
        )
        moments[:, cell.rows, block] += turn * (re_re - im_im + 1j * (re_im + im_re))


@lru_cache(maxsize=64)
def _mixing_matrix(
    waveform: Waveform, reach: float, terms: int, doppler_terms: int, smear: int, bands: int, band: int
) -> tuple[float, Float32[np.ndarray, "2*{terms} inputs"]]:
    """The centre nu_b of a band of the sweep, and the matrix from the moments of the cells around a row, [offset,
    Doppler term, shift term], to its sweep moments.

    sum_n w_n / sum(w) walk_t(nu) shift_p(nu) (nu - nu_b)^j exp(j 2 pi nu (cell - row)), n of the band; first the real,
    then the imaginary parts.
    """
    samples = waveform.samples
    nu, centre = sweep_positions(samples), (band + 0.5) / bands - 0.5
    window = np.where(np.floor((nu + 0.5) * bands) == band, unit_hann(samples), 0.0)
    offset = _around_row(samples, smear) / CELLS_PER_BIN
    walk = shift_polynomials(nu, reach, terms) * window
    shift = shift_polynomials(nu, _shift_reach(waveform), SHIFT_TERMS)
    powers = (nu - centre) ** np.arange(doppler_terms)[:, None]
    kernel = np.exp(2j * np.pi * offset[:, None] * nu)
    mixing = np.einsum("tn,on,pn,jn->tojp", walk, kernel, shift, powers, optimize=True).reshape(terms, -1)
    matrix = np.concatenate([mixing.real, mixing.imag]).astype(np.float32)
    matrix.setflags(write=False)
    return centre, matrix


def _around_row(samples: int, smear: int) -> Int64[np.ndarray, " offsets"]:
    """Offsets from a row's own cell to the cells that contribute to it; on a short range axis each cell once.

    :param smear: range bins to either side over which migration spreads an echo
    """
    cells = samples * CELLS_PER_BIN
    reach = min((ROW_REACH + smear) * CELLS_PER_BIN, cells // 2)
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
