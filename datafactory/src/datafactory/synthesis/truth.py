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

A path enters only where it is seen (:mod:`datafactory.synthesis.visibility`), with as many terms of the Doppler
polynomial as its own place and speed call for.

Limits: velocities are constant. The delay's third derivative within a frame is left out (2.4e-6 m at 3 m and 10 m/s).
Ranges are cyclic, as in the cube: row 0 is next to the last range bin, and an echo from beyond the unambiguous range
folds. ``tests/datafactory/synthesis/test_truth.py`` compares the image with the cube's own.
"""

from __future__ import annotations

from math import comb, factorial

import numpy as np
from jaxtyping import Complex64, Complex128, Float32, Float64, Int64

from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.mid_frame import BLOCK, MidFrame, at_mid_frame
from datafactory.synthesis.visibility import DOPPLER_REACH, ROW_REACH, seen_paths
from datafactory.synthesis.wave_model import EQUATION_1, WaveModel
from shared.physics.compiled import compiled
from shared.physics.cycles import phasor
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar
from shared.signal.imaging import DEFAULT_TERMS, WALK_REACH
from shared.signal.sweep import reference_frequency_hz, shift_polynomials, sweep_positions
from shared.signal.windows import hann

CELLS_PER_BIN = 2
"""Of the grid of range moments: a path is at most a quarter of a bin from its cell."""
SHIFT_TERMS = 5
"""Powers of the range remainder: -77 dB at the ends of the sweep for |z| <= 0.36 bins."""
DELTA_STEP = 1.0 / 16.0
"""Of the table's Doppler nodes [bins]; half of it is part of a path's departure, which sets its terms."""
CURVATURE_STEP = 1.0 / 32.0
"""Of the table's curvatures [cycles]: half of it turns the frame's edges, where Hann has no weight, by 0.025 rad."""
DOPPLER_ERROR = 3e-3
"""Bound on the Doppler polynomial's error, relative to the path's own amplitude: -50 dB."""
MAX_DOPPLER_TERMS = 10


def truth_moments(
    paths: PathTable,
    radar: Radar,
    doppler_cells: Int64[np.ndarray, " rows"],
    terms: int = DEFAULT_TERMS,
    model: WaveModel = EQUATION_1,
) -> Complex64[np.ndarray, "{terms} rows channels"]:
    """Sweep moments of the virtual sensor, each row in its own Doppler cell.

    :param paths: illuminated paths, amplitudes in sqrt(W)
    :param doppler_cells: index on the radar's velocity axis for each image row
    :param model: of motion; waves are spherical whatever it says of the input array
    :returns: what :func:`shared.signal.imaging.near_field_images` takes
    """
    array, waveform = radar.virtual_sensor, radar.waveform
    if len(array.tx_m) != 1:
        raise ValueError(f"the virtual sensor has {len(array.tx_m)} TX; expected 1")
    tx = array.tx[0]
    both = ScatteredPaths.concatenate([paths.scattered, paths.specular.as_scattered(tx)])
    mid = at_mid_frame(both, radar, tx, array.rx.mean(axis=0), model)
    # Neighbours in range share cells, and the cache.
    mid = mid.take(np.argsort(mid.range_bins % waveform.samples, kind="stable"))
    frame_s = waveform.chirps * waveform.chirp_interval_s
    path_terms = _doppler_terms(mid, waveform.chirps)
    doppler_terms = int(path_terms.max(initial=1))
    table = _doppler_table(mid.curvature, waveform.chirps, doppler_terms)
    mixing = _mixing_matrix(radar, terms, doppler_terms)  # (2 terms, offsets * SHIFT_TERMS * doppler_terms)
    cells = waveform.samples * CELLS_PER_BIN
    around_row = _around_row(waveform.samples)
    channels = array.channels
    blocks = [slice(first, min(first + BLOCK, channels)) for first in range(0, channels, BLOCK)]
    grids = [np.zeros((cells, SHIFT_TERMS * doppler_terms, 2, len(array.rx[block])), np.float32) for block in blocks]
    moments = np.zeros((terms, waveform.range_bins, channels), dtype=np.complex64)
    seen = seen_paths(mid, radar, doppler_cells)
    for cell in np.unique(doppler_cells):
        rows = np.flatnonzero(doppler_cells == cell)
        needed = np.zeros(cells, dtype=bool)
        needed[(rows[:, None] * CELLS_PER_BIN + around_row) % cells] = True
        frequency = float(cell - waveform.chirps // 2)
        chosen = np.flatnonzero(seen[cell])
        if not len(chosen):
            continue
        turn = np.exp(-2j * np.pi * frequency * (waveform.chirps // 2) / waveform.chirps).astype(np.complex64)
        for block, grid in zip(blocks, grids, strict=True):
            rx = array.rx[block]
            grid[needed] = 0.0
            _add_doppler_moments(
                chosen, path_terms, mid.rx_point, mid.rx_velocity, mid.tx_length, mid.tx_rate, mid.curvature,
                mid.amplitude,
                rx, 0.5 * (rx[0] + rx[-1]), frequency, float(waveform.chirps), frame_s,
                reference_frequency_hz(radar), waveform.bandwidth_hz, model.lead_s(radar),
                float(model.range_migration), needed, table, BINOMIAL, grid,
            )  # fmt: skip
            for row in rows:
                around = _cyclic_slice(grid, row * CELLS_PER_BIN + around_row).reshape(mixing.shape[1], -1)
                re_re, re_im, im_re, im_im = (
                    (mixing @ around).reshape(2, terms, 2, -1).transpose(0, 2, 1, 3).reshape(4, terms, -1)
                )
                moments[:, row, block] = turn * (re_re - im_im + 1j * (re_im + im_re))
    return moments


def _doppler_terms(mid: MidFrame, chirps: int) -> Int64[np.ndarray, " paths"]:
    """Terms of the Doppler polynomial of every path so that its remainder stays below DOPPLER_ERROR.

    With s the largest departure from the expansion point, the remainder of E terms is at most
    (2 pi s)^E / E! sum w |eta|^E / sum w.
    """
    if not np.any(mid.doppler) and not np.any(mid.rx_velocity):
        return np.ones(len(mid.doppler), dtype=np.int64)
    eta = np.abs(_frame_positions(chirps))
    window = hann(chirps) / hann(chirps).sum()
    departure = mid.departure + 0.5 * DELTA_STEP
    result = np.full(len(departure), MAX_DOPPLER_TERMS)
    for count in range(MAX_DOPPLER_TERMS - 1, 1, -1):
        result[(2.0 * np.pi * departure) ** count / factorial(count) * (window @ eta**count) < DOPPLER_ERROR] = count
    return result


def _frame_positions(chirps: int) -> Float64[np.ndarray, " {chirps}"]:
    return (np.arange(chirps) - chirps // 2) / chirps


def _doppler_table(
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
    window = hann(chirps) / hann(chirps).sum()
    table = np.empty((len(q), len(delta), terms), dtype=np.complex128)
    kernel = np.exp(2j * np.pi * delta[:, None] * eta)
    bend = window * np.exp(2j * np.pi * q[:, None] * eta**2)
    for e in range(terms):
        table[:, :, e] = (bend * (2j * np.pi * eta) ** e / factorial(e)) @ kernel.T
    return lowest, float(delta[0]), table


def _mixing_matrix(radar: Radar, terms: int, doppler_terms: int) -> Float32[np.ndarray, "2*{terms} inputs"]:
    """The matrix from the moments of the cells around a row, [offset, shift term, Doppler term], to its sweep moments.

    sum_n w_n / sum(w) walk_t(nu) shift_p(nu) nu^j exp(j 2 pi nu (cell - row)); first the real, then the imaginary
    parts.
    """
    samples = radar.waveform.samples
    nu = sweep_positions(samples)
    window = hann(samples) / hann(samples).sum()
    offset = _around_row(samples) / CELLS_PER_BIN
    walk = shift_polynomials(nu, WALK_REACH, terms) * window
    shift = shift_polynomials(nu, _shift_reach(radar), SHIFT_TERMS)
    powers = nu ** np.arange(doppler_terms)[:, None]
    kernel = np.exp(2j * np.pi * offset[:, None] * nu)
    mixing = np.einsum("tn,on,pn,jn->topj", walk, kernel, shift, powers, optimize=True).reshape(terms, -1)
    return np.concatenate([mixing.real, mixing.imag]).astype(np.float32)


def _around_row(samples: int) -> Int64[np.ndarray, " offsets"]:
    """Offsets from a row's own cell to the cells that contribute to it; on a short range axis each cell once."""
    cells = samples * CELLS_PER_BIN
    reach = min(ROW_REACH * CELLS_PER_BIN, cells // 2)
    return np.arange(-reach, reach + 1)[:cells]


def _cyclic_slice(
    grid: Float32[np.ndarray, "cells moments 2 rx"], cells: Int64[np.ndarray, " chosen"]
) -> Float32[np.ndarray, "chosen moments 2 rx"]:
    """The grid at consecutive cells, a view where they do not cross its ends."""
    first, last = int(cells[0]), int(cells[-1])
    return grid[first : last + 1] if first >= 0 and last < len(grid) else grid[cells % len(grid)]


def _shift_reach(radar: Radar) -> float:
    half_block = 0.5 * (BLOCK - 1) * SPEED_OF_LIGHT / (2.0 * radar.waveform.carrier_hz)
    return 0.5 / CELLS_PER_BIN + half_block * radar.waveform.bandwidth_hz / SPEED_OF_LIGHT


BINOMIAL = np.array(
    [[comb(e, j) for j in range(MAX_DOPPLER_TERMS)] for e in range(MAX_DOPPLER_TERMS)], dtype=np.float64
)


@compiled(nogil=True, error_model="numpy", fastmath={"contract", "nsz", "arcp", "reassoc"})
def _add_doppler_moments(
    chosen, path_terms, rx_point, rx_velocity, tx_length, tx_rate, curvature, amplitude,
    rx, rx_centre, frequency, chirps, frame_s,
    reference_hz, bandwidth_hz, lead, migration, needed, table_parts, binomial, grid,
):  # fmt: skip
    """Add the chosen paths' moments in one Doppler cell to ``grid`` [cells, SHIFT_TERMS * doppler terms, 2, RX].

    :param path_terms: [K] Doppler terms of each path
    :param lead: time by which ranges precede phases [s]; ``migration`` 1.0 for ranges that move within the frame
    """
    lowest_q, lowest_delta, table = table_parts
    doppler_terms = table.shape[2]
    count = len(rx)
    x, y, z = rx[:, 0].copy(), rx[:, 1].copy(), rx[:, 2].copy()
    re, im = np.empty(count), np.empty(count)
    depart = np.empty(count, dtype=np.float32)
    shift = np.empty(count, dtype=np.float32)
    b_re, b_im = np.empty(count, dtype=np.float32), np.empty(count, dtype=np.float32)
    a_re, a_im = np.empty(count, dtype=np.float32), np.empty(count, dtype=np.float32)
    per_metre = reference_hz / SPEED_OF_LIGHT
    bins_per_metre = bandwidth_hz / SPEED_OF_LIGHT
    for k in chosen:
        qx, qy, qz = rx_point[k]
        vx, vy, vz = rx_velocity[k]
        cx, cy, cz = qx - rx_centre[0], qy - rx_centre[1], qz - rx_centre[2]
        centre_leg = np.sqrt(cx * cx + cy * cy + cz * cz)
        centre_rate = (cx * vx + cy * vy + cz * vz) / max(centre_leg, 1e-9)
        total = per_metre * frame_s * (tx_rate[k] + centre_rate)
        delta = total - frequency
        delta -= chirps * np.floor(delta / chirps + 0.5)
        ranged = tx_length[k] + lead * tx_rate[k]
        cell = int(np.floor(bins_per_metre * (ranged + centre_leg + lead * centre_rate) * CELLS_PER_BIN + 0.5))
        slot = cell % len(needed)
        q = min(max(int(np.floor(curvature[k] / CURVATURE_STEP + 0.5)) - lowest_q, 0), table.shape[0] - 1)
        node = int(np.floor((delta - lowest_delta) / DELTA_STEP + 0.5))
        if not needed[slot] or node < 0 or node >= table.shape[1]:
            continue
        response = table[q, node]
        origin = total - delta + lowest_delta + node * DELTA_STEP
        kappa = np.float32(migration * total * bandwidth_hz / reference_hz)
        offset = cell / CELLS_PER_BIN - bins_per_metre * ranged
        k_re, k_im = amplitude[k].real, amplitude[k].imag
        for c in range(count):
            dx, dy, dz = qx - x[c], qy - y[c], qz - z[c]
            leg = np.sqrt(dx * dx + dy * dy + dz * dz)
            cosine, sine = phasor(per_metre * (tx_length[k] + leg))
            re[c] = cosine * k_re - sine * k_im
            im[c] = cosine * k_im + sine * k_re
            rate = (dx * vx + dy * vy + dz * vz) / leg
            shift[c] = bins_per_metre * (leg + lead * rate) - offset
            depart[c] = per_metre * frame_s * (tx_rate[k] + rate) - origin
        scale = np.float32(1.0)
        last = path_terms[k] - 1
        for j in range(last + 1):
            # kappa^j sum_e C(e, j) G_e d^(e - j), by Horner's rule
            top_re = np.float32(binomial[last, j] * response[last].real)
            top_im = np.float32(binomial[last, j] * response[last].imag)
            for c in range(count):
                b_re[c], b_im[c] = top_re, top_im
            for e in range(last - 1, j - 1, -1):
                g_re = np.float32(binomial[e, j] * response[e].real)
                g_im = np.float32(binomial[e, j] * response[e].imag)
                for c in range(count):
                    b_re[c] = b_re[c] * depart[c] + g_re
                    b_im[c] = b_im[c] * depart[c] + g_im
            for c in range(count):
                a_re[c] = scale * (b_re[c] * np.float32(re[c]) - b_im[c] * np.float32(im[c]))
                a_im[c] = scale * (b_re[c] * np.float32(im[c]) + b_im[c] * np.float32(re[c]))
            for p in range(SHIFT_TERMS):
                moment_re, moment_im = grid[slot, p * doppler_terms + j, 0], grid[slot, p * doppler_terms + j, 1]
                for c in range(count):
                    moment_re[c] += a_re[c]
                    moment_im[c] += a_im[c]
                    a_re[c] *= shift[c]
                    a_im[c] *= shift[c]
            scale *= kappa
