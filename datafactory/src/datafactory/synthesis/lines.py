"""Echoes to a grid of range cells and Doppler lines: a path is spread once a frame instead of once a chirp.

With nu the position in the sweep, eta that in the frame, f_0 the frequency at nu = 0 and kappa = B / f_0, a path whose
delay moves evenly is, in cycles,

    f_0 tau_0 + x nu + (1 + nu kappa) f eta,          x = B tau_0,  f = f_0 tau_1 T.

The grid's atoms are exp(j 2 pi (g nu / h + (1 + nu kappa) f_l eta)): range cell g, Doppler line l. The line's part is a
function of eta' = (1 + nu kappa) eta alone, so that what is left of the path separates,

    exp(j 2 pi z nu) exp(j 2 pi s(eta')),             z = x - g / h,  s = the phase that the line leaves,

and each factor is a sum of a few neighbouring atoms. The first is the polynomial in z of
:mod:`datafactory.synthesis.spread`. The second is known at a few instants of the frame, where every delay is evaluated
exactly; :mod:`datafactory.synthesis.slow_time` turns its values there into weights of lines. Curvature, the different
Doppler of every element and motion of whatever kind enter through the exact values.

A delay that curves does not separate wholly. Let the phase be sum_p c_p eta^p and the range sum_p d_p eta^p / kappa,
equal to each other but for motion within the chirp. With eta = eta' / (1 + nu kappa), what is left is a phase

    2 pi (nu e(eta') + nu^2 g(eta') + ...),
    e = kappa sum_p (d_p - p c_p) eta'^p,             g = kappa^2 sum_p (p (p + 1) / 2 c_p - p d_p) eta'^p,

that is -kappa q eta'^2 and kappa^2 q eta'^2 for a curvature q. Its exponential in powers of j 2 pi nu is

    1 + (j 2 pi nu) e + (j 2 pi nu)^2 (e^2 - j g / pi) / 2 + ...,

of which as many *orders* as a path calls for are separable terms: (j 2 pi nu)^n exp(j 2 pi z nu) is the n-th derivative
by z of the range's factor. What is left out is part of the path's error (:mod:`datafactory.synthesis.motion`).
"""

from __future__ import annotations

import numpy as np

from datafactory.synthesis.spread import rx_lengths
from shared.physics.compiled import compiled, inlined
from shared.physics.cycles import phasor, phasor_like
from shared.physics.units import SPEED_OF_LIGHT

_FAST = {"contract", "nsz", "arcp"}
DOUBLES = 8
"""Float64 in the widest vectors. A loop's rest is worked on one by one: padded to a multiple, it has none."""


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _length(x, y, z, element):
    dx, dy, dz = x - element[0], y - element[1], z - element[2]
    return np.sqrt(dx * dx + dy * dy + dz * dz)


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _rate_and_bend(x, y, z, vx, vy, vz, ex, ey, ez):
    """First and second derivative of the length between a moving point and an element."""
    dx, dy, dz = x - ex, y - ey, z - ez
    length = max(np.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
    rate = (dx * vx + dy * vy + dz * vz) / length
    return rate, (vx * vx + vy * vy + vz * vz - rate * rate) / length


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _phasors(length, cycles_per_metre, re, im, at):
    for e in range(len(length)):
        to = np.uint64(at) + np.uint64(e)
        re[to], im[to] = phasor_like(cycles_per_metre * length[e], re[to])


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _pair(one, other, rx_re, rx_im, rx_count, bends, tilt, dish, orders, at, sums):
    """V_i + V_-i and j (V_-i - V_i) of one TX at two nodes, then the same for V e and V (e^2 - j g / pi).

    :param one, other: re and im of the TX leg, and the node's first RX leg
    :param bends: (e, g / pi) at one node, the same at the other, (eta, eta^2 - 1/12) at the other, and a row's length
    :param tilt, dish: [channels] what an element has beyond e: its coefficients of eta and of eta^2 - 1/12
    :param orders: a tuple of as many entries as there are terms; only its length is used, which the compiler knows
    :param at: of the first channel; ``sums`` [4 * orders, channels]
    """
    a_re, a_im, first = one
    b_re, b_im, second = other
    e, f, g, h, odd, square, row, channel = bends
    stride = np.uint64(row)
    for lane in range(rx_count):
        c, d, to = np.uint64(first + lane), np.uint64(second + lane), np.uint64(at + lane)
        x_re, x_im = a_re * rx_re[c] - a_im * rx_im[c], a_re * rx_im[c] + a_im * rx_re[c]
        y_re, y_im = b_re * rx_re[d] - b_im * rx_im[d], b_re * rx_im[d] + b_im * rx_re[d]
        sums[to] = x_re + y_re
        sums[to + stride] = x_im + y_im
        sums[to + np.uint64(2) * stride] = x_im - y_im
        sums[to + np.uint64(3) * stride] = y_re - x_re
        if len(orders) == 2:
            sums[to + np.uint64(4) * stride] = e * x_re + f * y_re
            sums[to + np.uint64(5) * stride] = e * x_im + f * y_im
            sums[to + np.uint64(6) * stride] = e * x_im - f * y_im
            sums[to + np.uint64(7) * stride] = f * y_re - e * x_re
        if len(orders) == 3:
            own = np.uint64(channel + lane)
            even_part, odd_part = square * dish[own], odd * tilt[own]
            p, q = e + (even_part - odd_part), f + (even_part + odd_part)
            sums[to + np.uint64(4) * stride] = p * x_re + q * y_re
            sums[to + np.uint64(5) * stride] = p * x_im + q * y_im
            sums[to + np.uint64(6) * stride] = p * x_im - q * y_im
            sums[to + np.uint64(7) * stride] = q * y_re - p * x_re
            u_re, u_im = p * p * x_re + g * x_im, p * p * x_im - g * x_re
            v_re, v_im = q * q * y_re + h * y_im, q * q * y_im - h * y_re
            sums[to + np.uint64(8) * stride] = u_re + v_re
            sums[to + np.uint64(9) * stride] = u_im + v_im
            sums[to + np.uint64(10) * stride] = u_im - v_im
            sums[to + np.uint64(11) * stride] = v_re - u_re


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _line_taps(sums, stride, even, odd, orders, taps):
    """Weights of all lines, [lines, orders, re and im, channels]."""
    pairs, half = even.shape
    count = len(orders)
    for t in range(half):
        for part in range(count):
            low = np.uint64((2 * count * t + 2 * part) * stride)
            high = np.uint64((2 * count * (2 * half - 1 - t) + 2 * part) * stride)
            for lane in range(2 * stride):
                taps[low + np.uint64(lane)] = np.float32(0.0)
                taps[high + np.uint64(lane)] = np.float32(0.0)
            for i in range(0, pairs, 2):
                p, q, u, v = even[i, t], odd[i, t], np.float32(0.0), np.float32(0.0)
                j = min(i + 1, pairs - 1)
                if j > i:
                    u, v = even[j, t], odd[j, t]
                one = np.uint64((4 * count * i + 4 * part) * stride)
                other = np.uint64((4 * count * j + 4 * part) * stride)
                odd_one, odd_other = one + np.uint64(2 * stride), other + np.uint64(2 * stride)
                for lane in range(2 * stride):
                    c = np.uint64(lane)
                    plus = p * sums[one + c] + u * sums[other + c]
                    minus = q * sums[odd_one + c] + v * sums[odd_other + c]
                    taps[low + c] += plus - minus
                    taps[high + c] += plus + minus


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _cell_taps(shift, stride, weights, powers, orders, taps):
    """Weights of all cells, their derivatives by the shift and half of the second ones, [cells, orders, channels]."""
    count = len(orders)
    for g in range(len(weights)):
        to = np.uint64(g * count * stride)
        for lane in range(stride):
            c = to + np.uint64(lane)
            z, value = shift[lane], weights[g, len(powers) - 1]
            slope, bend = np.float32(0.0), np.float32(0.0)
            for p in range(len(powers) - 1):
                if count > 2:
                    bend = bend * z + slope
                if count > 1:
                    slope = slope * z + value
                value = value * z + weights[g, len(powers) - 2 - p]
            taps[c] = value
            if count > 1:
                taps[c + np.uint64(stride)] = slope
            if count > 2:
                taps[c + np.uint64(2 * stride)] = bend


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _add_taps(line_taps, cell_taps, stride, first, strides, counts, orders, grid):
    """Add one path to the grid, from index ``first``: the product of its lines' and its cells' weights."""
    line_stride, cell_stride, half_stride = strides
    count = len(orders)
    for t in range(counts[0]):
        for part in range(2):
            b = np.uint64((2 * count * t + part) * stride)
            to = np.uint64(first + t * line_stride + part * half_stride)
            for g in range(counts[1]):
                a, at = np.uint64(count * g * stride), to + np.uint64(g * cell_stride)
                for lane in range(stride):
                    c = np.uint64(lane)
                    total = cell_taps[a + c] * line_taps[b + c]
                    if count > 1:
                        total += cell_taps[a + np.uint64(stride) + c] * line_taps[b + np.uint64(2 * stride) + c]
                    if count > 2:
                        total += cell_taps[a + np.uint64(2 * stride) + c] * line_taps[b + np.uint64(4 * stride) + c]
                    grid[at + c] += total


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _elements_apart(table, k, time, lead, tx, rx, tx_centre, rx_centre, scales, tilt, dish):
    """What every element's e has beyond that of the centres: coefficients of eta and of eta^2 - 1/12, [TX * RX].

    :param time: mid-frame [s]; ``lead`` time by which ranges precede phases [s]
    :param scales: kappa times the cycles a frame of 1 m/s, and of 1 m/s^2 of second derivative
    """
    per_rate, per_bend = scales
    rx_count = rx.shape[1]
    px, py, pz, qx, qy, qz, _ = _at(table, k, time)
    ux, uy, uz = table[7, k], table[8, k], table[9, k]
    vx, vy, vz = table[10, k], table[11, k], table[12, k]
    for sign in range(2 if lead > 0.0 else 1):
        # Once the phase's part; where ranges precede phases, then the range's part, at its own time.
        later = sign * lead
        of_rate = per_rate * (1.0 if sign else -1.0) if lead > 0.0 else 0.0
        of_bend = per_bend * (1.0 if sign else -2.0) if lead > 0.0 else -per_bend
        ax, ay, az = px + later * ux, py + later * uy, pz + later * uz
        bx, by, bz = qx + later * vx, qy + later * vy, qz + later * vz
        rate_0, bend_0 = _rate_and_bend(ax, ay, az, ux, uy, uz, tx_centre[0], tx_centre[1], tx_centre[2])
        rate_1, bend_1 = _rate_and_bend(bx, by, bz, vx, vy, vz, rx_centre[0], rx_centre[1], rx_centre[2])
        rate_0, bend_0 = rate_0 + rate_1, bend_0 + bend_1
        for i in range(len(tx)):
            tx_rate, tx_bend = _rate_and_bend(ax, ay, az, ux, uy, uz, tx[i, 0], tx[i, 1], tx[i, 2])
            for e in range(rx_count):
                to = i * rx_count + e
                rate, bend = _rate_and_bend(bx, by, bz, vx, vy, vz, rx[0, e], rx[1, e], rx[2, e])
                tilt_part, dish_part = of_rate * (tx_rate + rate - rate_0), of_bend * (tx_bend + bend - bend_0)
                if sign:
                    tilt[to] += tilt_part
                    dish[to] += dish_part
                else:
                    tilt[to] = tilt_part
                    dish[to] = dish_part


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _tx_ways(tx, node, node_time, ways):
    """Fill ``ways`` [5, ways] for every TX and node: the TX's place [m], the node's time [s] and position in the frame.

    Ways beyond TX * nodes fill the last vector; nobody reads what comes of them.
    """
    for i in range(len(tx)):
        for n in range(len(node)):
            way = i * len(node) + n
            ways[0, way], ways[1, way], ways[2, way] = tx[i, 0], tx[i, 1], tx[i, 2]
            ways[3, way], ways[4, way] = node_time[n], node[n]


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _tx_phasors(table, k, frequency, constant, anchor, ways, cycles, re, im):
    """Path k's amplitude, turned by its way from every TX at every node; one loop over both fills the vectors.

    :param ways: of :func:`_tx_ways`; ``cycles``, ``re``, ``im`` have its length
    """
    px, py, pz, link = table[0, k], table[1, k], table[2, k], table[6, k]
    vx, vy, vz, rate = table[7, k], table[8, k], table[9, k], table[13, k]
    ex, ey, ez, time, eta = ways[0], ways[1], ways[2], ways[3], ways[4]
    for way in range(len(cycles)):
        x, y, z = px + vx * time[way] - ex[way], py + vy * time[way] - ey[way], pz + vz * time[way] - ez[way]
        cycles[way] = np.sqrt(x * x + y * y + z * z)
    for way in range(len(cycles)):
        length = cycles[way] + (link + rate * time[way])
        cycles[way] = frequency * length + constant - anchor * eta[way]
    a_re, a_im = table[14, k], table[15, k]
    for way in range(len(cycles)):
        cosine, sine = phasor(cycles[way])
        re[way] = cosine * a_re - sine * a_im
        im[way] = cosine * a_im + sine * a_re


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def add_lines(
    table, anchor, row, bends, tx, rx, tx_centre, rx_centre, node, node_time, mid_time, beat_time,
    reference_hz, bandwidth_hz, slope_hz_per_s, video_phase, oversampling, cells, even, odd, weights, scales, powers,
    orders, first_tx, grid,
):  # fmt: skip
    """Add paths to the grid [lines, cells + margin, 2, TX * RX].

    :param table: [16, K] of :func:`datafactory.synthesis.spread.columns`
    :param anchor: [K] f_l between the two middle lines [cycles a frame]
    :param row: [K] the grid's row of the first line
    :param bends: [6, K] coefficients of e and g, see :class:`datafactory.synthesis.motion.Motion`
    :param tx: [TX, 3] elements [m]; ``rx`` [3, E] of :func:`datafactory.synthesis.spread.padded` [m]
    :param tx_centre, rx_centre: [3] the arrays' centres, which choose the cell
    :param node, node_time: [nodes] positions in the frame, and when phases there are those of the scene [s]
    :param mid_time, beat_time: when phases and ranges are those of mid-frame [s]
    :param video_phase: 1.0 adds the residual video phase as far as it is linear in the departure from a cell
    :param oversampling: ``cells`` in a bin
    :param even, odd: of :class:`datafactory.synthesis.slow_time.LineWeights`
    :param weights: [taps, terms] of the range's shift
    :param scales: of :func:`_elements_apart`
    :param powers: a tuple of as many entries as ``weights`` has terms; only its length is used
    :param orders: likewise of 1 to 3 entries, as many as there are separable terms; with 3
        the elements have their own e
    :param first_tx: index among the grid's TX of the first of ``tx``
    """
    path_count, nodes, tx_count, rx_count = table.shape[1], len(node), len(tx), rx.shape[1]
    count, stride = len(orders), tx_count * rx_count
    flat = grid.reshape(grid.size)
    half_stride = grid.shape[3]
    strides = (grid.shape[1] * 2 * half_stride, 2 * half_stride, half_stride)
    counts = (2 * even.shape[1], len(weights))
    single = np.float32
    length = np.empty(rx_count)
    rx_re, rx_im = np.empty(nodes * rx_count, dtype=single), np.empty(nodes * rx_count, dtype=single)
    ways = np.zeros((5, -(-tx_count * nodes // DOUBLES) * DOUBLES))
    _tx_ways(tx, node, node_time, ways)
    cycles, tx_re, tx_im = np.empty(ways.shape[1]), np.empty(ways.shape[1], single), np.empty(ways.shape[1], single)
    bend, scaling = np.zeros(nodes, dtype=single), np.zeros(nodes, dtype=single)
    tilt, dish = np.zeros(stride, dtype=single), np.zeros(stride, dtype=single)
    shift, departure = np.empty(stride, dtype=single), np.empty(tx_count)
    sums = np.empty(len(even) * 4 * count * stride, dtype=single)
    line_taps, cell_taps = (
        np.empty(counts[0] * 2 * count * stride, dtype=single),
        np.empty(counts[1] * count * stride, dtype=single),
    )
    bins_per_metre = bandwidth_hz / SPEED_OF_LIGHT
    for k in range(path_count):
        px, py, pz, qx, qy, qz, link = _at(table, k, beat_time)
        rx_leg = _length(qx, qy, qz, rx_centre)
        # The bend's mean over the frame is a range like any other.
        mean = bends[1, k] / 12.0
        middle = bins_per_metre * (_length(px, py, pz, tx_centre) + link + rx_leg) + mean
        nearest = np.floor(middle * oversampling + 0.5)
        delay = nearest / (oversampling * bandwidth_hz)
        frequency = (reference_hz - video_phase * slope_hz_per_s * delay) / SPEED_OF_LIGHT
        constant = 0.5 * video_phase * slope_hz_per_s * delay * delay
        for i in range(tx_count):
            leg = _length(px, py, pz, tx[i]) + link + rx_leg
            departure[i] = bins_per_metre * leg + mean - nearest / oversampling
        rx_lengths(qx, qy, qz, rx[0], rx[1], rx[2], length)
        for i in range(tx_count):
            for e in range(rx_count):
                shift[i * rx_count + e] = departure[i] + bins_per_metre * (length[e] - rx_leg)
        if count > 2:
            _elements_apart(table, k, mid_time, beat_time - mid_time, tx, rx, tx_centre, rx_centre, scales, tilt, dish)
            for e in range(stride):
                shift[e] += dish[e] / single(12.0)
        _tx_phasors(table, k, frequency, constant, anchor[k], ways, cycles, tx_re, tx_im)
        for n in range(nodes):
            eta = node[n]
            if count > 1:
                bend[n] = eta * (bends[0, k] + bends[2, k] * eta * eta) + bends[1, k] * (eta * eta - 1.0 / 12.0)
            if count > 2:
                scaling[n] = eta * (bends[3, k] + eta * (bends[4, k] + eta * bends[5, k])) / np.pi
            _, _, _, qx, qy, qz, _ = _at(table, k, node_time[n])
            rx_lengths(qx, qy, qz, rx[0], rx[1], rx[2], length)
            _phasors(length, frequency, rx_re, rx_im, n * rx_count)
        for n in range(len(even)):
            last = nodes - 1 - n
            square = single(node[last] * node[last] - 1.0 / 12.0)
            for i in range(tx_count):
                here, there = i * nodes + n, i * nodes + last
                _pair(
                    (tx_re[here], tx_im[here], n * rx_count), (tx_re[there], tx_im[there], last * rx_count),
                    rx_re, rx_im, rx_count,
                    (bend[n], bend[last], scaling[n], scaling[last], single(node[last]), square, stride, i * rx_count),
                    tilt, dish, orders, 4 * count * n * stride + i * rx_count, sums,
                )  # fmt: skip
        _line_taps(sums, stride, even, odd, orders, line_taps)
        _cell_taps(shift, stride, weights, powers, orders, cell_taps)
        first = row[k] * strides[0] + (int(nearest) % cells) * strides[1] + first_tx * rx_count
        _add_taps(line_taps, cell_taps, stride, first, strides, counts, orders, flat)


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _at(table, k, time):
    """TX point, RX point and length between of path k at a time."""
    return (
        table[0, k] + table[7, k] * time, table[1, k] + table[8, k] * time, table[2, k] + table[9, k] * time,
        table[3, k] + table[10, k] * time, table[4, k] + table[11, k] * time, table[5, k] + table[12, k] * time,
        table[6, k] + table[13, k] * time,
    )  # fmt: skip
