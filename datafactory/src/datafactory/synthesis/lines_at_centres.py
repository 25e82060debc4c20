"""What the centres of the arrays see of paths: the part of :mod:`datafactory.synthesis.lines` that elements share.

For each path the range cell, the legs to the centres at mid-frame and each TX beyond its centre; and at the nodes of
the frame the phase that the line leaves with its orders, turned into coefficients of the lines' weights. Nothing here
depends on how many cells, orders or terms there are but the length of loops: it is compiled once for all of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64

from shared.physics.compiled import compiled, inlined
from shared.physics.cycles import phasor
from shared.physics.units import SPEED_OF_LIGHT

_FAST = {"contract", "nsz", "arcp"}
CHUNK = 64
"""Paths that are worked on together: long enough to vectorise, short enough to stay in the first cache."""
CLOSE_PARTS = 4
"""Of a line's coefficients where paths are close: those of all elements, of their q, of q^2 and of their c."""


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


class Centres(NamedTuple):
    """What is filled for some chunks of paths.

    :param coefficients: of the lines' weights, of all orders; what ``lines`` of :class:`Weights` gives of each part
    :param cell: nearest to the centres' range at ``sweep.beat_time``; :param frequency: cycles a metre
    :param rx_leg: length [m] between point and RX centre at mid-frame and its three derivatives
    :param tx_seen: of each TX the phasor with the path's amplitude; the range beyond the cell [bins], d, q and c
        [cycles], the three beyond the centre's
    """

    coefficients: Float32[np.ndarray, "orders parts chunks 64 coefficients"]
    cell: Float64[np.ndarray, "chunks 64"]
    frequency: Float64[np.ndarray, "chunks 64"]
    rx_leg: Float64[np.ndarray, "chunks 4 64"]
    tx_seen: Float64[np.ndarray, "chunks tx 6 64"]


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
def _node_values(cycles, eta, bends, coupled, at, values):
    """re and im [CHUNK] at a node, rows ``at`` and ``at`` + 1 of values [orders, 1 or 4, 2 * nodes, CHUNK].

    Of all elements, and of close paths of their q, of q^2 and of their c.

    :param coupled: kappa, and the lead of ranges before phases in frames
    """
    kappa, lead = coupled
    square, own_e = 2.0 * np.pi * eta * eta, kappa * (2.0 * lead * eta - (eta * eta - 1.0 / 12.0))
    re, im = values[0, 0, at], values[0, 0, at + 1]
    for b in range(CHUNK):
        re[b], im[b] = phasor(cycles[b])
    for order in range(values.shape[0]):
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
            if values.shape[1] > 1:
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


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def see_from_centres(paths, first, chunks, forms, sensor, sweep, weights):
    """:class:`Centres` of the paths from ``first`` on, in so many chunks; what is beyond the last path has no meaning.

    :param forms: how many orders and parts
    """
    (orders, parts), single = forms, np.float32
    table, node, matrix = paths.table, weights.node, weights.lines
    coefficients = np.empty((orders, parts, chunks, CHUNK, len(matrix)), dtype=single)
    cell, frequency = np.empty((chunks, CHUNK)), np.empty((chunks, CHUNK))
    rx_leg, tx_seen = np.empty((chunks, 4, CHUNK)), np.empty((chunks, len(sensor.tx), 6, CHUNK))
    frame_s, kappa, lead = sweep.frame_s, sweep.kappa, (sweep.beat_time - sweep.mid_time) / sweep.frame_s
    bins_per_metre = sweep.bandwidth_hz / SPEED_OF_LIGHT
    now, bends, tx_leg, leg = np.zeros((16, CHUNK)), np.zeros((6, CHUNK)), np.zeros((4, CHUNK)), np.zeros((4, CHUNK))
    link, rate = now[6], now[13]
    tx_length, rx_length, cycles = np.empty(CHUNK), np.empty(CHUNK), np.empty(CHUNK)
    departure, constant = np.empty(CHUNK), np.empty(CHUNK)
    values = np.zeros((orders, parts, 2 * len(node), CHUNK))
    by_value, by_value_single = matrix.T, np.ascontiguousarray(matrix.T).astype(single)
    product, rounded = np.empty((CHUNK, len(matrix))), np.empty((2 * len(node), CHUNK), dtype=single)
    mid, beat = sweep.mid_time, sweep.beat_time
    for chunk in range(chunks):
        start = first + chunk * CHUNK
        count = min(CHUNK, table.shape[1] - start)
        for column in range(16):
            for b in range(count):
                now[column, b] = table[column, start + b]
        for column in range(6):
            for b in range(count):
                bends[column, b] = paths.bends[column, start + b]
        _lengths(now, 0, beat, sensor.tx_centre, tx_length)
        _lengths(now, 3, beat, sensor.rx_centre, rx_length)
        nearest, per_metre = cell[chunk], frequency[chunk]
        for b in range(CHUNK):
            # The bend's mean over the frame is a range like any other.
            middle = bins_per_metre * (tx_length[b] + (link[b] + rate[b] * beat) + rx_length[b]) + bends[1, b] / 12.0
            nearest[b] = np.floor(middle * sweep.oversampling + 0.5)
            departure[b] = middle - nearest[b] / sweep.oversampling
        for b in range(CHUNK):
            delay = nearest[b] / (sweep.oversampling * sweep.bandwidth_hz)
            per_metre[b] = (sweep.reference_hz - sweep.video_phase * sweep.slope_hz_per_s * delay) / SPEED_OF_LIGHT
            constant[b] = 0.5 * sweep.video_phase * sweep.slope_hz_per_s * delay * delay
        _legs(now, 0, mid, sensor.tx_centre, tx_leg)
        _legs(now, 3, mid, sensor.rx_centre, rx_leg[chunk])
        for n in range(len(node)):
            eta = node[n]
            _lengths(now, 0, mid + eta * frame_s, sensor.tx_centre, tx_length)
            _lengths(now, 3, mid + eta * frame_s, sensor.rx_centre, rx_length)
            for b in range(CHUNK):
                longer = (tx_length[b] - tx_leg[0, b]) + (rx_length[b] - rx_leg[chunk, 0, b])
                cycles[b] = per_metre[b] * (longer + rate[b] * (eta * frame_s))
            for b in range(count):
                cycles[b] -= paths.anchor[start + b] * eta
            _node_values(cycles, eta, bends, (kappa, lead), 2 * n, values)
        for order in range(orders):
            for part in range(parts):
                # All but the first are small: single precision serves, in half the time. In the first, 1e-6 feels it.
                if order + part > 0:
                    for n in range(len(rounded)):
                        for b in range(CHUNK):
                            rounded[n, b] = single(values[order, part, n, b])
                    np.dot(rounded.T, by_value_single, coefficients[order, part, chunk])
        np.dot(values[0, 0].T, by_value, product)
        for b in range(CHUNK):
            for n in range(len(matrix)):
                coefficients[0, 0, chunk, b, n] = single(product[b, n])
        for i in range(len(sensor.tx)):
            _legs(now, 0, mid, sensor.tx[i], leg)
            seen = tx_seen[chunk, i]
            for b in range(CHUNK):
                cycles[b] = per_metre[b] * (leg[0, b] + (link[b] + rate[b] * mid)) + constant[b]
            for b in range(CHUNK):
                seen[0, b], seen[1, b] = phasor(cycles[b])
            for b in range(CHUNK):
                x, y = seen[0, b], seen[1, b]
                seen[0, b], seen[1, b] = x * now[14, b] - y * now[15, b], x * now[15, b] + y * now[14, b]
            for b in range(CHUNK):
                seen[2, b] = departure[b] + bins_per_metre * (leg[0, b] - tx_leg[0, b])
                seen[3, b] = per_metre[b] * frame_s * (leg[1, b] - tx_leg[1, b])
            for b in range(CHUNK):
                seen[4, b] = 0.5 * per_metre[b] * frame_s**2 * (leg[2, b] - tx_leg[2, b])
                seen[5, b] = per_metre[b] * frame_s**3 / 6.0 * (leg[3, b] - tx_leg[3, b])
    return Centres(coefficients, cell, frequency, rx_leg, tx_seen)
