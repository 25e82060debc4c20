"""Echoes to a grid of range cells, of which one FFT makes the IF samples.

Eq. (1) at sample n, with nu = (n - N/2) / N, f_0 = f_c + B/2 the frequency there, and x = B tau the range in bins:

    s[n] = sum_k A_k exp(j 2 pi f_0 tau_k) exp(j 2 pi x_k nu_n)

Split x = g / h + z into a cell g of a grid h times finer than the bins and a remainder z, and develop the remainder's
phasor into powers of z (:mod:`shared.signal.sweep`):

    s[n] = sum_p q_p(nu_n) sum_g M_p[g] exp(j 2 pi g nu_n / h),      M_p[g] = sum_{k in g} A_k exp(j 2 pi f_0 tau_k)
    z_k^p

Each q_p is a sum of shifts by whole cells, q_p(nu) = D(nu) sum_j W_jp exp(j 2 pi j nu / h), so that one FFT serves all
moments:

    s[n] = D(nu_n) sum_g G[g] exp(j 2 pi g nu_n / h),      G[g] = sum_{j, p} W_jp M_p[g - j]

All channels share the cell of the array's centre. The moments of a path then lie in one contiguous range of memory, and
a path takes channels * terms multiply-adds. Paths are sorted by range, so that this range of memory stays in cache. The
error is that of the weights (:func:`shared.signal.sweep.shift_weights_error`), plus rounding.

Delays are evaluated in float64 for every TX, RX and chirp; the phase is reduced modulo one cycle before it is rounded.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float64, Integer
from numpy.typing import DTypeLike

from datafactory.paths.table import ScatteredPaths
from shared.physics.compiled import compiled, inlined
from shared.physics.cycles import phasor, phasor_like
from shared.physics.units import SPEED_OF_LIGHT
from shared.physics.vectors import aligned

CHUNK = 64
"""Paths whose phases are evaluated together: long enough to vectorise, short enough to stay in the first cache."""
LANES = 16
"""RX elements worked on together: a constant, so that the compiler keeps their moments in registers; 16 float32 fill
the widest ones."""
_FAST = {"contract", "nsz", "arcp"}


class Sensor(NamedTuple):
    """A block of elements.

    :param tx: [m]; ``rx`` of :func:`padded` [m]
    :param tx_centre, rx_centre: the arrays' centres [m], which choose the cell
    :param first_tx: index among the grid's TX of the first of ``tx``
    """

    tx: Float64[np.ndarray, "tx 3"]
    rx: Float64[np.ndarray, "3 padded_rx"]
    tx_centre: Float64[np.ndarray, " 3"]
    rx_centre: Float64[np.ndarray, " 3"]
    first_tx: int


class Sweep(NamedTuple):
    """What frame and sweep are.

    :param video_phase: 1.0 adds the residual video phase -mu tau^2 / 2 up to its part linear in the departure z from
        a cell, the exact kernel also its part quadratic in z
    :param oversampling: ``cells`` in a bin
    :param frame_s: length of a frame; ``mid_time``, ``beat_time`` when phases and ranges are those of mid-frame, or
        of a chirp [s], see :func:`datafactory.synthesis.motion.instants`
    """

    reference_hz: float
    bandwidth_hz: float
    slope_hz_per_s: float
    video_phase: float
    oversampling: float
    cells: int
    frame_s: float
    mid_time: float
    beat_time: float
    kappa: float


def columns(paths: ScatteredPaths, order: Integer[np.ndarray, " paths"]) -> Float64[np.ndarray, "16 paths"]:
    """The paths in this order, as the kernel reads them.

    Rows: TX point, RX point and length between at t = 0 [m], the rates of these seven [m/s], and the amplitude's real
    and imaginary part.
    """
    still = [*paths.tx_point.T, *paths.rx_point.T, paths.between_m]
    rates = [*paths.tx_velocity.T, *paths.rx_velocity.T, paths.between_rate_mps]
    table = np.empty((16, len(order)))
    for row, column in zip(table, [*still, *rates, paths.amplitude.real, paths.amplitude.imag], strict=True):
        np.take(column, order, out=row, mode="clip")  # the other modes copy ``out``
    return table


def padded(elements: Float64[np.ndarray, "elements 3"]) -> Float64[np.ndarray, "3 padded"]:
    """Coordinates of elements by rows, the last element repeated up to a multiple of LANES."""
    missing = -len(elements) % LANES
    return np.ascontiguousarray(np.concatenate([elements, np.repeat(elements[-1:], missing, axis=0)]).T)


def empty_moments(
    cells: int, tx_count: int, rx_count: int, terms: int, real: DTypeLike
) -> Float[np.ndarray, "{cells} {tx_count} panels {terms}*2*16"]:
    """Uninitialised moments of panels of LANES elements, real and imaginary parts apart."""
    return aligned((cells, tx_count, -(-rx_count // LANES), terms * 2 * LANES), real)


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _distances(count, x, y, z, point, distance):
    """Distances of the first ``count`` points x, y, z [B] to one."""
    for k in range(count):
        dx, dy, dz = x[k] - point[0], y[k] - point[1], z[k] - point[2]
        distance[k] = np.sqrt(dx * dx + dy * dy + dz * dz)


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _phasors(count, length, link, cycles_per_metre, constant, re, im):
    """Phasors of the first ``count`` lengths [B] plus ``link`` [m]."""
    for k in range(count):
        re[k], im[k] = phasor(cycles_per_metre[k] * (length[k] + link[k]) + constant[k])


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def rx_lengths(px, py, pz, x, y, z, length):
    """Lengths [E] of the leg from a point to the elements x, y, z [E]."""
    for e in range(len(x)):
        dx, dy, dz = px - x[e], py - y[e], pz - z[e]
        length[e] = np.sqrt(dx * dx + dy * dy + dz * dz)


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _rx_legs(length, beat_length, cycles_per_metre, bins_per_metre, offset, at, seen):
    """Phasor of these lengths [E] and range [bins] of those, from index ``at`` of re, im, shift in ``seen``.

    Indices are unsigned: numba's test for negative indices would prevent vectorisation.
    """
    re, im, shift = seen
    for first in range(0, len(length), LANES):
        for lane in range(LANES):
            e = np.uint64(first) + np.uint64(lane)
            to = np.uint64(at) + e
            re[to], im[to] = phasor_like(cycles_per_metre * length[e], re[to])
            shift[to] = bins_per_metre * beat_length[e] - offset


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _add_powers(one, other, rx_count, seen, powers, to, moments):
    """Add two paths of one TX to the moments of their common cell, from index ``to``, with one store for both.

    :param one, other: of each path re, im and range [bins] of the TX leg, and the index of its first RX leg
    :param powers: a tuple of ``terms`` entries; only its length is used, which the compiler knows
    """
    rx_re, rx_im, rx_shift = seen
    t_re, t_im, t_shift, at = one
    u_re, u_im, u_shift, other_at = other
    for panel in range(rx_count // LANES):
        first, second = np.uint64(at + panel * LANES), np.uint64(other_at + panel * LANES)
        into = np.uint64(to + panel * len(powers) * 2 * LANES)
        for lane in range(LANES):
            e, f = first + np.uint64(lane), second + np.uint64(lane)
            re, im = t_re * rx_re[e] - t_im * rx_im[e], t_re * rx_im[e] + t_im * rx_re[e]
            other_re, other_im = u_re * rx_re[f] - u_im * rx_im[f], u_re * rx_im[f] + u_im * rx_re[f]
            z, other_z = t_shift + rx_shift[e], u_shift + rx_shift[f]
            for p in range(len(powers)):
                moments[into + np.uint64(p * 2 * LANES + lane)] += re + other_re
                moments[into + np.uint64(p * 2 * LANES + LANES + lane)] += im + other_im
                re *= z
                im *= z
                other_re *= other_z
                other_im *= other_z


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def add_moments(table, sensor, sweep, powers, moments, used):
    """Add all paths at one instant to ``moments`` of :func:`empty_moments`.

    :param table: [16, K] of :func:`columns`
    :param sensor: a :class:`Sensor`; :param sweep: a :class:`Sweep`
    :param powers: a tuple of ``terms`` entries
    :param used: [cells] set where a path stands
    """
    tx, rx, time, beat_time, oversampling = sensor.tx, sensor.rx, sweep.mid_time, sweep.beat_time, sweep.oversampling
    cells, moment_tx = moments.shape[0], moments.shape[1]
    tx_count, rx_count, path_count = len(tx), rx.shape[1], table.shape[1]
    flat = moments.reshape(moments.size)
    one_tx = moments.shape[2] * moments.shape[3]
    # Rows of C-ordered arrays, by one index each: numba knows them as contiguous, which vectorisation needs.
    x, y, z = rx[0], rx[1], rx[2]
    now, then = np.empty((7, CHUNK)), np.empty((7, CHUNK))
    px, py, pz, qx, qy, qz, link = now[0], now[1], now[2], now[3], now[4], now[5], now[6]
    bx, by, bz, cx, cy, cz, beat_link = then[0], then[1], then[2], then[3], then[4], then[5], then[6]
    leg, beat_leg = np.empty(rx_count), np.empty(rx_count)
    length, rx_length, nearest = np.empty(CHUNK), np.empty(CHUNK), np.empty(CHUNK)
    tx_offset, rx_offset = np.empty(CHUNK), np.empty(CHUNK)
    frequency, constant = np.empty(CHUNK), np.empty(CHUNK)
    on_tx, on_rx = (tx_count, CHUNK), CHUNK * rx_count
    tx_re, tx_im, tx_shift = np.empty(on_tx), np.empty(on_tx), np.empty(on_tx)
    real = moments.dtype.type
    rx_re, rx_im = np.empty(on_rx, dtype=moments.dtype), np.empty(on_rx, dtype=moments.dtype)
    rx_shift = np.empty(on_rx, dtype=moments.dtype)
    bins_per_metre = sweep.bandwidth_hz / SPEED_OF_LIGHT
    seen = (rx_re, rx_im, rx_shift)
    for first in range(0, path_count, CHUNK):
        count = min(CHUNK, path_count - first)
        for row in range(7):
            start, rate, line, beat_line = table[row], table[7 + row], now[row], then[row]
            for b in range(count):
                line[b] = start[first + b] + rate[first + b] * time
            for b in range(count):
                beat_line[b] = start[first + b] + rate[first + b] * beat_time
        # Each loop uses few arrays: the compiler tests at most about eight pairs of arrays for overlap.
        _distances(count, bx, by, bz, sensor.tx_centre, length)
        _distances(count, cx, cy, cz, sensor.rx_centre, rx_length)
        for b in range(count):
            nearest[b] = np.floor(bins_per_metre * (length[b] + beat_link[b] + rx_length[b]) * oversampling + 0.5)
        for b in range(count):
            # Each leg has its own offset, so that both shifts are small before they are rounded to float32.
            rx_offset[b] = bins_per_metre * rx_length[b]
            tx_offset[b] = nearest[b] / oversampling - bins_per_metre * rx_length[b]
        for b in range(count):
            # tau^2 = tau_0 (2 tau - tau_0) + (z / B)^2 with tau_0 the cell's delay; the last term is in the weights.
            delay = nearest[b] / (oversampling * sweep.bandwidth_hz)
            frequency[b] = (sweep.reference_hz - sweep.video_phase * sweep.slope_hz_per_s * delay) / SPEED_OF_LIGHT
            constant[b] = 0.5 * sweep.video_phase * sweep.slope_hz_per_s * delay * delay
        for i in range(tx_count):
            t_re, t_im, t_shift = tx_re[i], tx_im[i], tx_shift[i]
            _distances(count, px, py, pz, tx[i], length)
            _phasors(count, length, link, frequency, constant, t_re, t_im)
            _distances(count, bx, by, bz, tx[i], length)
            for b in range(count):
                t_shift[b] = bins_per_metre * (length[b] + beat_link[b]) - tx_offset[b]
        a_re, a_im = table[14], table[15]
        for i in range(tx_count):
            t_re, t_im = tx_re[i], tx_im[i]
            for b in range(count):
                re, im = t_re[b], t_im[b]
                t_re[b] = re * a_re[first + b] - im * a_im[first + b]
                t_im[b] = re * a_im[first + b] + im * a_re[first + b]
        for b in range(count):
            rx_lengths(qx[b], qy[b], qz[b], x, y, z, leg)
            rx_lengths(cx[b], cy[b], cz[b], x, y, z, beat_leg)
            _rx_legs(leg, beat_leg, frequency[b], bins_per_metre, rx_offset[b], b * rx_count, seen)
        b = 0
        while b < count:
            # A path without a neighbour in its cell is paired with itself at amplitude 0.
            paired = b + 1 < count and nearest[b] == nearest[b + 1]
            f, weight = (b + 1, 1.0) if paired else (b, 0.0)
            cell = int(nearest[b]) % cells
            used[cell] = True
            for i in range(tx_count):
                _add_powers(
                    (real(tx_re[i, b]), real(tx_im[i, b]), real(tx_shift[i, b]), b * rx_count),
                    (real(weight * tx_re[i, f]), real(weight * tx_im[i, f]), real(tx_shift[i, f]), f * rx_count),
                    rx_count, seen, powers, (cell * moment_tx + sensor.first_tx + i) * one_tx, flat,
                )  # fmt: skip
            b += 2 if paired else 1


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _add_tap(weights, powers, at, moments, total):
    """Add the moments of one cell, from index ``at``, times ``weights`` [terms], to ``total`` [2 * LANES]."""
    first = np.uint64(at)
    for e in range(2 * LANES):
        value = total[e]
        for p in range(len(powers)):
            value += weights[p] * moments[first + np.uint64(p * 2 * LANES + e)]
        total[e] = value


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def add_to_grid(moments, used, weights, powers, phase, grid):
    """Add sum_{j, p} W_jp M_p[g - j], times ``phase``, to ``grid`` [cells, RX, TX] complex, cyclic in g.

    :param used: [cells] of :func:`add_moments`; the moments of others are zero
    :param weights: [taps, terms] of the moments' real type
    :param powers: a tuple of ``terms`` entries
    """
    cells, tx_count, panels, size = moments.shape
    flat = moments.reshape(moments.size)
    rx_count, taps = grid.shape[1], len(weights)
    total = np.empty(2 * LANES, dtype=moments.dtype)
    for g in range(cells):
        reached = False
        for j in range(taps):
            reached = reached or used[(g + taps // 2 - j) % cells]
        if not reached:
            continue
        for i in range(tx_count):
            for panel in range(panels):
                total[:] = 0.0
                for j in range(taps):
                    cell = (g + taps // 2 - j) % cells
                    _add_tap(weights[j], powers, ((cell * tx_count + i) * panels + panel) * size, flat, total)
                for e in range(min(LANES, rx_count - panel * LANES)):
                    grid[g, panel * LANES + e, i] += phase * complex(total[e], total[LANES + e])
