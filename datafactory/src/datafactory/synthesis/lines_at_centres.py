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
    """What is filled for K paths.

    :param coefficients: of the lines' weights, of all orders; what ``lines`` of :class:`Weights` gives of each part
    :param cell: nearest to the centres' range at ``sweep.beat_time``
    :param frequency: cycles a metre
    :param rx_leg: length [m] between point and RX centre at mid-frame and its three derivatives
    :param tx_seen: of each TX the phasor with the path's amplitude; the range beyond the cell [bins], d, q and c
        [cycles], the three beyond the centre's
    """

    coefficients: Float32[np.ndarray, "orders parts paths coefficients"]
    cell: Float64[np.ndarray, " paths"]
    frequency: Float64[np.ndarray, " paths"]
    rx_leg: Float64[np.ndarray, "4 paths"]
    tx_seen: Float32[np.ndarray, "paths tx 6"]


def empty_centres(orders: int, parts: int, paths: int, tx_count: int, coefficients: int) -> Centres:
    """Uninitialised."""
    return Centres(
        np.empty((orders, parts, paths, coefficients), dtype=np.float32),
        np.empty(paths), np.empty(paths), np.empty((4, paths)), np.empty((paths, tx_count, 6), dtype=np.float32),
    )  # fmt: skip


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
def see_from_centres(paths, first, sensor, sweep, weights, seen):
    """Fill :class:`Centres` with those of the paths from ``first`` on, as many as there are or it has room for."""
    table, node, matrix = paths.table, weights.node, weights.lines
    coefficients, cell, frequency, of_rx, of_tx = seen
    orders, parts, room = coefficients.shape[0], coefficients.shape[1], coefficients.shape[2]
    single = np.float32
    frame_s, kappa, lead = sweep.frame_s, sweep.kappa, (sweep.beat_time - sweep.mid_time) / sweep.frame_s
    bins_per_metre = sweep.bandwidth_hz / SPEED_OF_LIGHT
    now, bends = np.zeros((16, CHUNK)), np.zeros((6, CHUNK))
    tx_leg, rx_leg, leg = np.zeros((4, CHUNK)), np.zeros((4, CHUNK)), np.zeros((4, CHUNK))
    link, rate = now[6], now[13]
    tx_length, rx_length, cycles = np.empty(CHUNK), np.empty(CHUNK), np.empty(CHUNK)
    departure, per_metre, constant = np.empty(CHUNK), np.empty(CHUNK), np.empty(CHUNK)
    re, im = np.empty(CHUNK), np.empty(CHUNK)
    values = np.zeros((orders, parts, 2 * len(node), CHUNK))
    by_value, by_value_single = matrix.T, np.ascontiguousarray(matrix.T).astype(single)
    product, rounded = np.empty((CHUNK, len(matrix))), np.empty((2 * len(node), CHUNK), dtype=single)
    product_single = np.empty((CHUNK, len(matrix)), dtype=single)
    mid, beat = sweep.mid_time, sweep.beat_time
    for to in range(0, min(room, table.shape[1] - first), CHUNK):
        count = min(CHUNK, room - to, table.shape[1] - first - to)
        for column in range(16):
            for b in range(count):
                now[column, b] = table[column, first + to + b]
        for column in range(6):
            for b in range(count):
                bends[column, b] = paths.bends[column, first + to + b]
        _lengths(now, 0, beat, sensor.tx_centre, tx_length)
        _lengths(now, 3, beat, sensor.rx_centre, rx_length)
        for b in range(CHUNK):
            # The bend's mean over the frame is a range like any other.
            middle = bins_per_metre * (tx_length[b] + (link[b] + rate[b] * beat) + rx_length[b]) + bends[1, b] / 12.0
            nearest = np.floor(middle * sweep.oversampling + 0.5)
            departure[b] = middle - nearest / sweep.oversampling
            delay = nearest / (sweep.oversampling * sweep.bandwidth_hz)
            per_metre[b] = (sweep.reference_hz - sweep.video_phase * sweep.slope_hz_per_s * delay) / SPEED_OF_LIGHT
            constant[b] = 0.5 * sweep.video_phase * sweep.slope_hz_per_s * delay * delay
            re[b] = nearest
        _legs(now, 0, mid, sensor.tx_centre, tx_leg)
        _legs(now, 3, mid, sensor.rx_centre, rx_leg)
        for b in range(count):
            cell[to + b], frequency[to + b] = re[b], per_metre[b]
            for n in range(4):
                of_rx[n, to + b] = rx_leg[n, b]
        for n in range(len(node)):
            eta = node[n]
            _lengths(now, 0, mid + eta * frame_s, sensor.tx_centre, tx_length)
            _lengths(now, 3, mid + eta * frame_s, sensor.rx_centre, rx_length)
            for b in range(CHUNK):
                longer = (tx_length[b] - tx_leg[0, b]) + (rx_length[b] - rx_leg[0, b]) + rate[b] * (eta * frame_s)
                cycles[b] = per_metre[b] * longer
            for b in range(count):
                cycles[b] -= paths.anchor[first + to + b] * eta
            _node_values(cycles, eta, bends, (kappa, lead), 2 * n, values)
        for order in range(orders):
            for part in range(parts):
                # All but the first are small: single precision serves, in half the time. In the first, 1e-6 feels it.
                if order + part > 0:
                    for n in range(len(rounded)):
                        for b in range(CHUNK):
                            rounded[n, b] = single(values[order, part, n, b])
                    np.dot(rounded.T, by_value_single, product_single)
                    for b in range(count):
                        for n in range(len(matrix)):
                            coefficients[order, part, to + b, n] = product_single[b, n]
                else:
                    np.dot(values[0, 0].T, by_value, product)
                    for b in range(count):
                        for n in range(len(matrix)):
                            coefficients[0, 0, to + b, n] = single(product[b, n])
        for i in range(len(sensor.tx)):
            _legs(now, 0, mid, sensor.tx[i], leg)
            for b in range(CHUNK):
                cycles[b] = per_metre[b] * (leg[0, b] + (link[b] + rate[b] * mid)) + constant[b]
            for b in range(CHUNK):
                re[b], im[b] = phasor(cycles[b])
            for b in range(count):
                seen_of = of_tx[to + b, i]
                seen_of[0] = single(re[b] * now[14, b] - im[b] * now[15, b])
                seen_of[1] = single(re[b] * now[15, b] + im[b] * now[14, b])
                seen_of[2] = single(departure[b] + bins_per_metre * (leg[0, b] - tx_leg[0, b]))
                seen_of[3] = single(per_metre[b] * frame_s * (leg[1, b] - tx_leg[1, b]))
                seen_of[4] = single(0.5 * per_metre[b] * frame_s**2 * (leg[2, b] - tx_leg[2, b]))
                seen_of[5] = single(per_metre[b] * frame_s**3 / 6.0 * (leg[3, b] - tx_leg[3, b]))
