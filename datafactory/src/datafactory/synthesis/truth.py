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

A path enters only where it is seen. Of the paths within ROW_REACH bins of a row and DOPPLER_REACH of its Doppler cell
(beyond, Hann's skirts lie below -74 and -64 dB), those that are weakest there and hold together less than NEGLECTED_DB
of the row's power are left out of it. A path that no row of a Doppler cell wants is not evaluated for this cell. Each
path has as many terms of the Doppler polynomial as its own place and speed call for.

Limits: velocities are constant. The delay's third derivative within a frame is left out (2.4e-6 m at 3 m and 10 m/s).
Ranges are cyclic, as in the cube: row 0 is next to the last range bin, and an echo from beyond the unambiguous range
folds. ``tests/datafactory/synthesis/test_truth.py`` compares the image with the cube's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb, factorial

import numpy as np
from jaxtyping import Bool, Complex64, Complex128, Float32, Float64, Int64

from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.wave_model import EQUATION_1, WaveModel
from shared.physics.compiled import compiled
from shared.physics.cycles import phasor
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar
from shared.signal.imaging import DEFAULT_TERMS, WALK_REACH
from shared.signal.sweep import reference_frequency_hz, shift_polynomials, sweep_positions
from shared.signal.windows import hann

CELLS_PER_BIN = 2
BLOCK = 32
"""Elements that share a path's range cell and Doppler expansion."""
SHIFT_TERMS = 5
"""Powers of the range remainder: -77 dB at the ends of the sweep for |z| <= 0.36 bins."""
ROW_REACH = 12
DOPPLER_REACH = 8.0
DELTA_STEP = 1.0 / 16.0
CURVATURE_STEP = 1.0 / 32.0
DOPPLER_ERROR = 3e-3
"""Bound on the Doppler polynomial's error, relative to the path's own amplitude: -50 dB."""
MAX_DOPPLER_TERMS = 10
NEGLECTED_DB = -65.0
"""Power of the paths that are left out of a row, over that of all, incoherently summed: 15 dB below the terms' errors.
On munich at 2.5 m/s half of the pairs of path and Doppler cell remain; at -50 dB, a quarter fewer."""
NEGLECTED, LEVELS = 10.0 ** (NEGLECTED_DB / 10.0), 140
"""The same as a ratio; levels of 1 dB that are told apart."""


@dataclass(frozen=True)
class MidFrame:
    """Paths at mid-frame, as seen by one TX: the input of the kernel.

    :param rx_point: [m]; ``rx_velocity`` [m/s]
    :param tx_length, tx_rate: length before the RX leg [m] and its rate [m/s]
    :param curvature: q [cycles], seen from the array's centre
    :param doppler: f [bins], unwrapped, seen from the array's centre
    :param range_bins: x = B tau seen from the array's centre, at the time of the beat frequency
    :param amplitude: [sqrt(W)]
    :param departure: largest distance of an element's Doppler from the point of expansion, with migration [bins]
    """

    rx_point: Float64[np.ndarray, "paths 3"]
    rx_velocity: Float64[np.ndarray, "paths 3"]
    tx_length: Float64[np.ndarray, " paths"]
    tx_rate: Float64[np.ndarray, " paths"]
    curvature: Float64[np.ndarray, " paths"]
    doppler: Float64[np.ndarray, " paths"]
    range_bins: Float64[np.ndarray, " paths"]
    amplitude: Complex128[np.ndarray, " paths"]
    departure: Float64[np.ndarray, " paths"]

    def take(self, index: Int64[np.ndarray, " chosen"]) -> MidFrame:
        """The paths at these indices."""
        return MidFrame(**{name: getattr(self, name)[index] for name in self.__dataclass_fields__})


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
    mid = _at_mid_frame(both, radar, tx, array.rx.mean(axis=0), model)
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
    seen = _seen(mid, radar, doppler_cells)
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


def _at_mid_frame(
    paths: ScatteredPaths,
    radar: Radar,
    tx: Float64[np.ndarray, " 3"],
    centre: Float64[np.ndarray, " 3"],
    model: WaveModel,
) -> MidFrame:
    waveform = radar.waveform
    time = model.phase_time_s(waveform.chirps // 2 * waveform.chirp_interval_s, radar)
    frame_s = waveform.chirps * waveform.chirp_interval_s
    tx_vector = paths.tx_point + paths.tx_velocity * time - tx
    rx_point = paths.rx_point + paths.rx_velocity * time
    tx_leg, tx_rate, tx_bend = _derivatives(tx_vector, paths.tx_velocity)
    rx_leg, rx_rate, rx_bend = _derivatives(rx_point - centre, paths.rx_velocity)
    tx_length = tx_leg + paths.between_m + paths.between_rate_mps * time
    tx_rate = tx_rate + paths.between_rate_mps
    cycles_per_metre = reference_frequency_hz(radar) / SPEED_OF_LIGHT
    doppler = cycles_per_metre * (tx_rate + rx_rate) * frame_s
    return MidFrame(
        rx_point=rx_point,
        rx_velocity=paths.rx_velocity,
        tx_length=tx_length,
        tx_rate=tx_rate,
        curvature=0.5 * cycles_per_metre * (tx_bend + rx_bend) * frame_s**2,
        doppler=doppler,
        range_bins=waveform.bandwidth_hz
        / SPEED_OF_LIGHT
        * (tx_length + rx_leg + model.lead_s(radar) * (tx_rate + rx_rate)),
        amplitude=paths.amplitude,
        departure=_departure(rx_point, paths.rx_velocity, doppler, radar, frame_s),
    )


def _derivatives(
    vector: Float64[np.ndarray, "paths 3"], velocity: Float64[np.ndarray, "paths 3"]
) -> tuple[Float64[np.ndarray, " paths"], Float64[np.ndarray, " paths"], Float64[np.ndarray, " paths"]]:
    """Length of a moving vector and its first two time derivatives."""
    length = np.maximum(np.linalg.norm(vector, axis=1), 1e-9)
    rate = np.einsum("ki,ki->k", vector, velocity) / length
    return length, rate, (np.einsum("ki,ki->k", velocity, velocity) - rate**2) / length


def _departure(
    rx_point: Float64[np.ndarray, "paths 3"],
    rx_velocity: Float64[np.ndarray, "paths 3"],
    doppler: Float64[np.ndarray, " paths"],
    radar: Radar,
    frame_s: float,
) -> Float64[np.ndarray, " paths"]:
    """Largest distance of an element's Doppler from its block's, and the Doppler that migration adds [bins]."""
    distance = np.maximum(np.linalg.norm(rx_point, axis=1), 0.5)
    speed = np.linalg.norm(rx_velocity, axis=1)
    half_block = 0.5 * BLOCK * SPEED_OF_LIGHT / (2.0 * radar.waveform.carrier_hz)
    spread = reference_frequency_hz(radar) / SPEED_OF_LIGHT * speed * half_block / distance * frame_s
    # Hann gives the sweep's ends no weight: its standard deviation of nu is 0.18, and twice that holds 96 % of the
    # weight.
    return spread + 0.36 * np.abs(doppler) * radar.waveform.bandwidth_hz / reference_frequency_hz(radar)


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


def _seen(mid: MidFrame, radar: Radar, doppler_cells: Int64[np.ndarray, " rows"]) -> Bool[np.ndarray, "chirps paths"]:
    """For each Doppler cell the paths that are seen in one of its rows.

    :param mid: paths in the order of their folded range
    """
    waveform = radar.waveform
    seen = np.zeros((waveform.chirps, len(mid.amplitude)), dtype=bool)
    # An element may see a path nearer to the cell than the centre does, and curvature widens its line.
    slack = mid.departure + np.abs(mid.curvature)
    _mark_seen(
        mid.range_bins % waveform.samples, mid.doppler, slack, np.abs(mid.amplitude) ** 2, doppler_cells,
        min(float(ROW_REACH), 0.5 * waveform.samples), float(waveform.samples), seen,
    )  # fmt: skip
    return seen


@compiled(cache=False, inline="always", error_model="numpy")
def _hann_power(bins):
    """Power of the Hann window's response this far from its peak, the envelope of the sidelobes beyond 1.5 bins.

    Harris, Proc. IEEE 66, 51 (1978): sin(pi x) / (pi x (1 - x^2)), here its main lobe to 1.5 bins as the power of a
    cosine, which is right at 0 and 1 and at most 1.4 dB off.
    """
    if bins < 1.5:
        return np.cos(0.25 * np.pi * bins) ** 4
    return 1.0 / (np.pi * bins * (bins * bins - 1.0)) ** 2


@compiled(nogil=True, error_model="numpy")
def _mark_seen(bins, doppler, slack, power, doppler_cells, reach, samples, seen):
    """Mark in ``seen`` [chirps, paths] what each row sees in its Doppler cell.

    A row's paths are counted in levels of 1 dB below the row's power. From the weakest on, levels are left out while
    they hold together less than NEGLECTED_DB.
    """
    chirps, count = seen.shape
    part, held = np.empty(count), np.empty(LEVELS)
    for row in range(len(doppler_cells)):
        cell = doppler_cells[row]
        frequency = cell - chirps // 2
        total = 0.0
        # Cyclic: what lies beyond one end of the axis stands at the other.
        first = np.searchsorted(bins, (row - reach) % samples)
        size = 0
        while size < count:
            k = (first + size) % count
            offset = bins[k] - row
            offset = abs(offset - samples * np.floor(offset / samples + 0.5))
            if offset > reach:
                break
            delta = doppler[k] - frequency
            delta = abs(delta - chirps * np.floor(delta / chirps + 0.5))
            part[size] = 0.0
            if delta <= DOPPLER_REACH:
                part[size] = power[k] * _hann_power(offset) * _hann_power(max(delta - slack[k], 0.0))
            total += part[size]
            size += 1
        if total <= 0.0:
            continue
        held[:] = 0.0
        for index in range(size):
            if part[index] > 0.0:
                level = min(int(10.0 * np.log10(total / part[index])), LEVELS - 1)
                held[level] += part[index]
        least, left_out = LEVELS, 0.0
        while least > 1 and left_out + held[least - 1] <= NEGLECTED * total:
            least -= 1
            left_out += held[least]
        for index in range(size):
            if part[index] > 0.0 and min(int(10.0 * np.log10(total / part[index])), LEVELS - 1) < least:
                seen[cell, (first + index) % count] = True


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
