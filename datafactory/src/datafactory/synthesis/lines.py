"""Echoes to a grid of range cells and Doppler lines: a path is spread once a frame instead of once a chirp.

With nu the position in the sweep, eta that in the frame and eta' = (1 + nu kappa) eta, the grid's atoms are
exp(j 2 pi (g nu / h + f_l eta')): range cell g, h of them in a bin, and Doppler line l. An atom leaves of a path

    exp(j 2 pi z nu) exp(j 2 pi s(eta')) (1 + (j 2 pi nu) e + (j 2 pi nu)^2 (e^2 - j g / pi) / 2 + ...),

with z the range beyond the cell [bins], s the phase that the line leaves, and e(eta') and g(eta') what a delay that
curves has (docs/notes/synthesis.md derives them). As many *orders* as a path calls for are separable terms. The first
factor is the polynomial in z of :mod:`datafactory.synthesis.spread`; (j 2 pi nu)^n times it is its n-th derivative by
z. The rest is known at a few instants of the frame, where the delay of the arrays' centres is evaluated exactly, and
:mod:`datafactory.synthesis.slow_time` turns its values there into weights of lines. What is left out is part of the
path's error (:mod:`datafactory.synthesis.motion`).

An element c has the phase of the centres, one of its own at mid-frame, which is evaluated exactly, and in between

    d_c eta + q_c eta^2 + c_c eta^3,

with d, q and c from the derivatives of its length at mid-frame. Its factor exp(j 2 pi d_c eta) is a polynomial in d_c
(:func:`shared.signal.sweep.shift_polynomials`), so that a line's weight is one as well, whose coefficients all elements
share. *Close* paths have many terms, q_c to second and c_c to first order; others have few, and neither q_c nor c_c.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64

from datafactory.synthesis.spread import LANES
from shared.physics.compiled import compiled, inlined
from shared.physics.cycles import phasor, phasor_like
from shared.physics.units import SPEED_OF_LIGHT

_FAST = {"contract", "nsz", "arcp"}
CHUNK = 64
"""Paths whose centres are worked on together."""
_RE, _IM, _BINS, _D, _Q, _C = (LANES * n for n in range(6))
"""Where the parts of what elements see of a path stand in one array, so that the compiler sees that they do not
overlap: the phasor at mid-frame; range [bins], d, q and c [cycles] beyond the centre's."""


class Paths(NamedTuple):
    """Paths to be spread.

    :param table: of :func:`datafactory.synthesis.spread.columns`
    :param anchor: f_l between the two middle lines [cycles a frame]
    :param row: the grid's row of the first line
    :param bends: coefficients of e and g, see :class:`datafactory.synthesis.motion.Motion`
    """

    table: Float64[np.ndarray, "16 paths"]
    anchor: Float64[np.ndarray, " paths"]
    row: np.ndarray
    bends: Float64[np.ndarray, "6 paths"]


class Weights(NamedTuple):
    """What turns paths into cells and lines.

    :param node: positions in the frame
    :param lines: a line's coefficients of powers of d, re and im, from re and im at the nodes, of
        :func:`datafactory.synthesis.slow_time.element_weights`
    :param cells: of the range's shift
    """

    node: Float64[np.ndarray, " nodes"]
    lines: Float64[np.ndarray, "coefficients values"]
    cells: Float32[np.ndarray, "taps terms"]


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _legs(paths, end, time, element, result):
    """Length, rate, second and third derivative [4, CHUNK] between moving points and an element.

    :param paths: [16, CHUNK] as the table; ``end`` is 0 for the leg of the TX, 3 for that of the RX
    """
    x0, y0, z0, vx, vy, vz = paths[end], paths[end + 1], paths[end + 2], paths[end + 7], paths[end + 8], paths[end + 9]
    length, rate, bend, jerk = result[0], result[1], result[2], result[3]
    for b in range(CHUNK):
        dx, dy = x0[b] + vx[b] * time - element[0], y0[b] + vy[b] * time - element[1]
        dz = z0[b] + vz[b] * time - element[2]
        length[b] = max(np.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
        rate[b] = (dx * vx[b] + dy * vy[b] + dz * vz[b]) / length[b]
    for b in range(CHUNK):
        square = vx[b] * vx[b] + vy[b] * vy[b] + vz[b] * vz[b]
        bend[b] = (square - rate[b] * rate[b]) / length[b]
        jerk[b] = -3.0 * rate[b] * bend[b] / length[b]


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _lengths(paths, end, time, centre, result):
    """Lengths [CHUNK] between moving points and the centre."""
    x0, y0, z0, vx, vy, vz = paths[end], paths[end + 1], paths[end + 2], paths[end + 7], paths[end + 8], paths[end + 9]
    for b in range(CHUNK):
        dx, dy = x0[b] + vx[b] * time - centre[0], y0[b] + vy[b] * time - centre[1]
        dz = z0[b] + vz[b] * time - centre[2]
        result[b] = np.sqrt(dx * dx + dy * dy + dz * dz)


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _node_values(cycles, eta, bends, coupled, at, close, orders, values):
    """re and im [CHUNK] at a node, rows ``at`` and ``at`` + 1 of values [orders, 1 or 4, 2 * nodes, CHUNK].

    Of all elements, and if ``close`` of their q, of q^2 and of their c.

    :param coupled: kappa, and the lead of ranges before phases in frames
    """
    kappa, lead = coupled
    square, own_e = 2.0 * np.pi * eta * eta, kappa * (2.0 * lead * eta - (eta * eta - 1.0 / 12.0))
    re, im = values[0, 0, at], values[0, 0, at + 1]
    for b in range(CHUNK):
        re[b], im[b] = phasor(cycles[b])
    for order in range(len(orders)):
        to_re, to_im = values[order, 0, at], values[order, 0, at + 1]
        for b in range(CHUNK):
            v_re, v_im, own = 1.0, 0.0, 0.0
            if order > 0:
                e = eta * (bends[0, b] + bends[2, b] * eta * eta) + bends[1, b] * (eta * eta - 1.0 / 12.0)
                v_re, own = e, own_e
                if order > 1:
                    g = eta * (bends[3, b] + eta * (bends[4, b] + eta * bends[5, b])) / np.pi
                    v_re, v_im, own = e * e, -g, 2.0 * e * own_e
            x, y = re[b], im[b]
            if len(close) > 1:
                # j 2 pi eta^2 with what e has of an element, half the square of both, j 2 pi eta^3.
                q_re, q_im = own - square * v_im, square * v_re
                p_re, p_im = -0.5 * square * square * v_re, square * own - 0.5 * square * square * v_im
                if order > 1:
                    p_re += own_e * own_e
                c_re, c_im = -square * eta * v_im, square * eta * v_re
                values[order, 1, at, b], values[order, 1, at + 1, b] = q_re * x - q_im * y, q_re * y + q_im * x
                values[order, 2, at, b], values[order, 2, at + 1, b] = p_re * x - p_im * y, p_re * y + p_im * x
                values[order, 3, at, b], values[order, 3, at + 1, b] = c_re * x - c_im * y, c_re * y + c_im * x
            if order > 0:
                to_re[b], to_im[b] = v_re * x - v_im * y, v_re * y + v_im * x


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _rx_seen(place, point, velocity, leg, scales, close, work, seen):
    """What a panel of RX sees of a leg.

    :param place: [3 * LANES] of the elements [m]
    :param point, velocity, leg: of the leg's end, and the centre's length and derivatives, which are taken off
    :param scales: cycles and bins of a metre, length of a frame [s]
    :param work: [3 * LANES] float64
    """
    x, y, z = point
    vx, vy, vz = velocity
    cycles, bins, frame_s = scales
    length_0, rate_0, bend_0, jerk_0 = leg
    for lane in range(LANES):
        dx, dy, dz = x - place[lane], y - place[LANES + lane], z - place[2 * LANES + lane]
        length = max(np.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
        inverse = 1.0 / length
        work[lane], work[LANES + lane] = length, inverse
        work[2 * LANES + lane] = (dx * vx + dy * vy + dz * vz) * inverse
    for lane in range(LANES):
        length, rate = work[lane], work[2 * LANES + lane]
        seen[_RE + lane], seen[_IM + lane] = phasor_like(cycles * length, seen[lane])
        seen[_BINS + lane] = bins * (length - length_0)
        seen[_D + lane] = cycles * frame_s * (rate - rate_0)
    if len(close) > 1:
        square = vx * vx + vy * vy + vz * vz
        for lane in range(LANES):
            inverse, rate = work[LANES + lane], work[2 * LANES + lane]
            bend = (square - rate * rate) * inverse
            seen[_Q + lane] = 0.5 * cycles * frame_s**2 * (bend - bend_0)
            seen[_C + lane] = cycles * frame_s**3 / 6.0 * (-3.0 * rate * bend * inverse - jerk_0)


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _channels(rx_seen, tx_seen, kappa, lead, close, seen):
    """TX and RX together: the product of their phasors, the sums of all else; the range is that of the beat."""
    t_re, t_im, t_bins, t_d, t_q, t_c = tx_seen
    for lane in range(LANES):
        re, im = rx_seen[_RE + lane], rx_seen[_IM + lane]
        seen[_RE + lane], seen[_IM + lane] = t_re * re - t_im * im, t_re * im + t_im * re
        d = t_d + rx_seen[_D + lane]
        z = t_bins + rx_seen[_BINS + lane] + kappa * lead * d
        if len(close) > 1:
            q, c = t_q + rx_seen[_Q + lane], t_c + rx_seen[_C + lane]
            seen[_Q + lane], seen[_C + lane] = q, c
            z += kappa * (q * (lead * lead - np.float32(1.0 / 12.0)) + c * lead * lead * lead)
        seen[_BINS + lane], seen[_D + lane] = z, d


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _cell_taps(seen, weights, cells, powers, orders, taps):
    """Weights of all cells, their derivatives by the shift and half of the second ones, [orders, cells, LANES]."""
    for g in range(len(cells)):
        for lane in range(LANES):
            z, to = seen[_BINS + lane], np.uint64(g * LANES + lane)
            first = np.uint64(g * len(powers))
            value, slope, bend = weights[first + np.uint64(len(powers) - 1)], np.float32(0.0), np.float32(0.0)
            for p in range(len(powers) - 1):
                if len(orders) > 2:
                    bend = bend * z + slope
                if len(orders) > 1:
                    slope = slope * z + value
                value = value * z + weights[first + np.uint64(len(powers) - 2 - p)]
            taps[to] = value
            if len(orders) > 1:
                taps[to + np.uint64(len(cells) * LANES)] = slope
            if len(orders) > 2:
                taps[to + np.uint64(2 * len(cells) * LANES)] = bend


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _polynomial(coefficients, at, d, terms):
    """re and im of a polynomial in d, whose coefficients begin at index ``at``."""
    one, last = np.uint64(1), at + np.uint64(2 * len(terms) - 2)
    re, im = coefficients[last], coefficients[last + one]
    for p in range(len(terms) - 1):
        here = last - np.uint64(2 * p + 2)
        re, im = re * d + coefficients[here], im * d + coefficients[here + one]
    return re, im


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _line_taps(seen, coefficients, part, step, terms, close, to, taps):
    """A line's weight with one number of orders, re and im of LANES from index ``to``.

    :param part: where the coefficients of this path and line begin; ``step`` from there to those of q, q^2, c
    """
    for lane in range(LANES):
        d, a_re, a_im = seen[_D + lane], seen[_RE + lane], seen[_IM + lane]
        x, y = _polynomial(coefficients, np.uint64(part), d, terms)
        if len(close) > 1:
            u, v = _polynomial(coefficients, np.uint64(part + step), d, terms)
            x, y = x + seen[_Q + lane] * u, y + seen[_Q + lane] * v
        taps[np.uint64(to + lane)] = x * a_re - y * a_im
        taps[np.uint64(to + LANES + lane)] = x * a_im + y * a_re
    if len(close) > 1:
        for lane in range(LANES):
            d, q, c = seen[_D + lane], seen[_Q + lane], seen[_C + lane]
            a_re, a_im = seen[_RE + lane], seen[_IM + lane]
            u, v = _polynomial(coefficients, np.uint64(part + 2 * step), d, terms)
            x, y = _polynomial(coefficients, np.uint64(part + 3 * step), d, terms)
            x, y = q * q * u + c * x, q * q * v + c * y
            taps[np.uint64(to + lane)] += x * a_re - y * a_im
            taps[np.uint64(to + LANES + lane)] += x * a_im + y * a_re


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _add_taps(line_taps, cell_taps, cells, orders, at, flat):
    """Add one line's cells to the grid, from index ``at``: the products of the line's weights and the cells'."""
    for lane in range(LANES):
        to, here = np.uint64(at + lane), np.uint64(lane)
        for g in range(len(cells)):
            re, im = np.float32(0.0), np.float32(0.0)
            for order in range(len(orders)):
                tap = cell_taps[here + np.uint64((order * len(cells) + g) * LANES)]
                re += tap * line_taps[here + np.uint64(2 * order * LANES)]
                im += tap * line_taps[here + np.uint64((2 * order + 1) * LANES)]
            flat[to + np.uint64(2 * g * LANES)] += re
            flat[to + np.uint64((2 * g + 1) * LANES)] += im


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def add_lines(paths, sensor, sweep, weights, forms, grid):
    """Add paths to the grid [lines, TX * panels, cells + margin, 2, LANES].

    :param forms: tuples of which only the lengths are used, which the compiler knows: the cells of a path, the terms of
        ``weights.cells``, the separable terms, the terms of a line's polynomial in d; and one of two entries for q and
        c, of one for neither
    """
    cells, powers, orders, terms, close = forms
    table, anchor, row = paths.table, paths.anchor, paths.row
    node, matrix = weights.node, weights.lines
    single = np.float32
    panels, tx_count, path_count = sensor.rx.shape[1] // LANES, len(sensor.tx), table.shape[1]
    flat = grid.reshape(grid.size)
    panel_stride = grid.shape[2] * 2 * LANES
    line_stride = grid.shape[1] * panel_stride
    frame_s, kappa, lead = sweep.frame_s, sweep.kappa, (sweep.beat_time - sweep.mid_time) / sweep.frame_s
    bins_per_metre = sweep.bandwidth_hz / SPEED_OF_LIGHT
    place = np.empty((panels, 3 * LANES))
    for axis in range(3):
        for e in range(sensor.rx.shape[1]):
            place[e // LANES, axis * LANES + e % LANES] = sensor.rx[axis, e]
    parts = 4 if len(close) > 1 else 1
    now, bends = np.zeros((16, CHUNK)), np.zeros((6, CHUNK))
    tx_leg, rx_leg, leg = np.zeros((4, CHUNK)), np.zeros((4, CHUNK)), np.zeros((4, CHUNK))
    link, rate = now[6], now[13]
    tx_length, rx_length, cycles, nearest = np.empty(CHUNK), np.empty(CHUNK), np.empty(CHUNK), np.empty(CHUNK)
    departure, frequency, constant = np.empty(CHUNK), np.empty(CHUNK), np.empty(CHUNK)
    tx_seen = np.zeros((tx_count, 6, CHUNK))
    values = np.zeros((len(orders), parts, 2 * len(node), CHUNK))
    # Those of a path stand together: the loops over its elements read them from the first cache.
    coefficients = np.zeros((len(orders), parts, CHUNK, len(matrix)), dtype=single)
    by_value, by_value_single = matrix.T, np.ascontiguousarray(matrix.T).astype(single)
    product, rounded = np.empty((CHUNK, len(matrix))), np.empty((2 * len(node), CHUNK), dtype=single)
    cell_weights = weights.cells.reshape(weights.cells.size)
    all_coefficients = coefficients.reshape(coefficients.size)
    part_stride, line_step = CHUNK * len(matrix), 2 * len(terms)
    lines = len(matrix) // (2 * len(terms))
    work, seen = np.empty(3 * LANES), np.zeros(6 * LANES, dtype=single)
    rx_seen = np.zeros((panels, 6 * LANES), dtype=single)
    cell_taps = np.empty(len(orders) * len(cells) * LANES, dtype=single)
    line_taps = np.empty(2 * len(orders) * LANES, dtype=single)
    for first in range(0, path_count, CHUNK):
        count = min(CHUNK, path_count - first)
        for column in range(16):
            for b in range(count):
                now[column, b] = table[column, first + b]
        for column in range(6):
            for b in range(count):
                bends[column, b] = paths.bends[column, first + b]
        mid, beat = sweep.mid_time, sweep.beat_time
        _lengths(now, 0, beat, sensor.tx_centre, tx_length)
        _lengths(now, 3, beat, sensor.rx_centre, rx_length)
        for b in range(CHUNK):
            # The bend's mean over the frame is a range like any other.
            middle = bins_per_metre * (tx_length[b] + (link[b] + rate[b] * beat) + rx_length[b]) + bends[1, b] / 12.0
            nearest[b] = np.floor(middle * sweep.oversampling + 0.5)
            departure[b] = middle - nearest[b] / sweep.oversampling
        for b in range(CHUNK):
            delay = nearest[b] / (sweep.oversampling * sweep.bandwidth_hz)
            frequency[b] = (sweep.reference_hz - sweep.video_phase * sweep.slope_hz_per_s * delay) / SPEED_OF_LIGHT
            constant[b] = 0.5 * sweep.video_phase * sweep.slope_hz_per_s * delay * delay
        _legs(now, 0, mid, sensor.tx_centre, tx_leg)
        _legs(now, 3, mid, sensor.rx_centre, rx_leg)
        for n in range(len(node)):
            eta = node[n]
            _lengths(now, 0, mid + eta * frame_s, sensor.tx_centre, tx_length)
            _lengths(now, 3, mid + eta * frame_s, sensor.rx_centre, rx_length)
            for b in range(CHUNK):
                longer = (tx_length[b] - tx_leg[0, b]) + (rx_length[b] - rx_leg[0, b]) + rate[b] * (eta * frame_s)
                cycles[b] = frequency[b] * longer
            for b in range(count):
                cycles[b] -= anchor[first + b] * eta
            _node_values(cycles, eta, bends, (kappa, lead), 2 * n, close, orders, values)
        for order in range(len(orders)):
            for part in range(parts):
                # All but the first are small: single precision serves, in half the time. In the first, 1e-6 feels it.
                if order + part > 0:
                    rounded[:] = values[order, part]
                    np.dot(rounded.T, by_value_single, coefficients[order, part])
                else:
                    np.dot(values[0, 0].T, by_value, product)
                    coefficients[0, 0] = product
        for i in range(tx_count):
            _legs(now, 0, mid, sensor.tx[i], leg)
            re, im = tx_seen[i, 0], tx_seen[i, 1]
            for b in range(CHUNK):
                cycles[b] = frequency[b] * (leg[0, b] + (link[b] + rate[b] * mid)) + constant[b]
            for b in range(CHUNK):
                re[b], im[b] = phasor(cycles[b])
            for b in range(CHUNK):
                x, y = re[b], im[b]
                re[b], im[b] = x * now[14, b] - y * now[15, b], x * now[15, b] + y * now[14, b]
            for b in range(CHUNK):
                tx_seen[i, 2, b] = departure[b] + bins_per_metre * (leg[0, b] - tx_leg[0, b])
                tx_seen[i, 3, b] = frequency[b] * frame_s * (leg[1, b] - tx_leg[1, b])
            for b in range(CHUNK):
                tx_seen[i, 4, b] = 0.5 * frequency[b] * frame_s**2 * (leg[2, b] - tx_leg[2, b])
                tx_seen[i, 5, b] = frequency[b] * frame_s**3 / 6.0 * (leg[3, b] - tx_leg[3, b])
        for b in range(count):
            vx, vy, vz = now[10, b], now[11, b], now[12, b]
            point = (now[3, b] + vx * mid, now[4, b] + vy * mid, now[5, b] + vz * mid)
            centre_leg = (rx_leg[0, b], rx_leg[1, b], rx_leg[2, b], rx_leg[3, b])
            scales = (frequency[b], bins_per_metre, frame_s)
            for panel in range(panels):
                _rx_seen(place[panel], point, (vx, vy, vz), centre_leg, scales, close, work, rx_seen[panel])
            start = row[first + b] * line_stride + (int(nearest[b]) % sweep.cells) * 2 * LANES
            for i in range(tx_count):
                of_tx = (
                    single(tx_seen[i, 0, b]), single(tx_seen[i, 1, b]), single(tx_seen[i, 2, b]),
                    single(tx_seen[i, 3, b]), single(tx_seen[i, 4, b]), single(tx_seen[i, 5, b]),
                )  # fmt: skip
                for panel in range(panels):
                    _channels(rx_seen[panel], of_tx, single(kappa), single(lead), close, seen)
                    _cell_taps(seen, cell_weights, cells, powers, orders, cell_taps)
                    at = start + ((sensor.first_tx + i) * panels + panel) * panel_stride
                    for line in range(lines):
                        for order in range(len(orders)):
                            part = order * parts * part_stride + b * len(matrix) + line * line_step
                            _line_taps(
                                seen, all_coefficients, part, part_stride, terms, close, 2 * order * LANES, line_taps
                            )
                        _add_taps(line_taps, cell_taps, cells, orders, at + line * line_stride, flat)
