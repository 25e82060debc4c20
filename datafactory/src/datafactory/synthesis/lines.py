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

A delay that curves does not separate wholly. With X(eta) the range and s'(eta) the slope of s, what is left is a phase

    2 pi nu e(eta),      e = X - x - kappa f_l eta - kappa eta s'(eta) = -kappa q eta^2 for s = q eta^2,

whose first order exp(j 2 pi nu e) = 1 + j 2 pi nu e is a second separable term: j 2 pi nu exp(j 2 pi z nu) is the
derivative by z of the range's factor. The second order is left out and is part of the path's error
(:mod:`datafactory.synthesis.sorting`).
"""

from __future__ import annotations

import numpy as np

from datafactory.synthesis.spread import rx_lengths
from shared.physics.compiled import compiled
from shared.physics.cycles import phasor, phasor_like
from shared.physics.units import SPEED_OF_LIGHT

RANGE_TERMS = 10
"""Powers of the range's shift that are evaluated, the last of them perhaps zero: a constant, so that the compiler
unrolls the loop. 1e-6 needs 9."""
_FAST = {"contract", "nsz", "arcp"}


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def _length(x, y, z, element, plane):
    if plane:
        far = np.sqrt(x * x + y * y + z * z)
        return far - (x * element[0] + y * element[1] + z * element[2]) / max(far, 1e-9)
    dx, dy, dz = x - element[0], y - element[1], z - element[2]
    return np.sqrt(dx * dx + dy * dy + dz * dz)


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def _phasors(length, cycles_per_metre, re, im, at):
    for e in range(len(length)):
        to = np.uint64(at) + np.uint64(e)
        re[to], im[to] = phasor_like(cycles_per_metre * length[e], re[to])


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def _pair(one, other, rx_re, rx_im, rx_count, bends, at, sums):
    """V_i + V_-i and j (V_-i - V_i) of one TX at two nodes, then the same times the bend, [8, channels] from ``at``.

    :param one, other: re and im of the TX leg, and the node's first RX leg
    :param at: of the first channel; ``sums`` has ``bends[2]`` channels a row
    """
    a_re, a_im, first = one
    b_re, b_im, second = other
    e, f, stride = bends
    for lane in range(rx_count):
        c, d, to = np.uint64(first + lane), np.uint64(second + lane), np.uint64(at + lane)
        x_re, x_im = a_re * rx_re[c] - a_im * rx_im[c], a_re * rx_im[c] + a_im * rx_re[c]
        y_re, y_im = b_re * rx_re[d] - b_im * rx_im[d], b_re * rx_im[d] + b_im * rx_re[d]
        sums[to] = x_re + y_re
        sums[to + np.uint64(stride)] = x_im + y_im
        sums[to + np.uint64(2 * stride)] = x_im - y_im
        sums[to + np.uint64(3 * stride)] = y_re - x_re
        sums[to + np.uint64(4 * stride)] = e * x_re + f * y_re
        sums[to + np.uint64(5 * stride)] = e * x_im + f * y_im
        sums[to + np.uint64(6 * stride)] = e * x_im - f * y_im
        sums[to + np.uint64(7 * stride)] = f * y_re - e * x_re


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def _line_taps(sums, stride, even, odd, taps):
    """Weights of all lines, [lines, 4, channels]: re, im, and re, im of the bend's term."""
    pairs, half = even.shape
    for t in range(half):
        for part in range(2):
            low = np.uint64((4 * t + 2 * part) * stride)
            high = np.uint64((4 * (2 * half - 1 - t) + 2 * part) * stride)
            for lane in range(2 * stride):
                taps[low + np.uint64(lane)] = np.float32(0.0)
                taps[high + np.uint64(lane)] = np.float32(0.0)
            for i in range(0, pairs, 2):
                p, q, u, v = even[i, t], odd[i, t], np.float32(0.0), np.float32(0.0)
                j = min(i + 1, pairs - 1)
                if j > i:
                    u, v = even[j, t], odd[j, t]
                one = np.uint64((8 * i + 4 * part) * stride)
                other = np.uint64((8 * j + 4 * part) * stride)
                odd_one, odd_other = one + np.uint64(2 * stride), other + np.uint64(2 * stride)
                for lane in range(2 * stride):
                    c = np.uint64(lane)
                    plus = p * sums[one + c] + u * sums[other + c]
                    minus = q * sums[odd_one + c] + v * sums[odd_other + c]
                    taps[low + c] += plus - minus
                    taps[high + c] += plus + minus


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def _cell_taps(shift, stride, weights, taps):
    """Weights of all cells and their derivatives by the shift, [cells, 2, channels]."""
    for g in range(len(weights)):
        to = np.uint64(g * 2 * stride)
        for lane in range(stride):
            c = to + np.uint64(lane)
            z, value, slope = shift[lane], weights[g, RANGE_TERMS - 1], np.float32(0.0)
            for p in range(RANGE_TERMS - 1):
                slope = slope * z + value
                value = value * z + weights[g, RANGE_TERMS - 2 - p]
            taps[c] = value
            taps[c + np.uint64(stride)] = slope


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def _add_taps(line_taps, cell_taps, stride, first, strides, counts, grid):
    """Add one path to the grid, from index ``first``: the product of its lines' and its cells' weights."""
    line_stride, cell_stride, half_stride = strides
    for t in range(counts[0]):
        for part in range(2):
            b, db = np.uint64((4 * t + part) * stride), np.uint64((4 * t + 2 + part) * stride)
            to = np.uint64(first + t * line_stride + part * half_stride)
            for g in range(counts[1]):
                a, da = np.uint64(2 * g * stride), np.uint64((2 * g + 1) * stride)
                at = to + np.uint64(g * cell_stride)
                for lane in range(stride):
                    c = np.uint64(lane)
                    grid[at + c] += cell_taps[a + c] * line_taps[b + c] + cell_taps[da + c] * line_taps[db + c]


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def add_lines(
    table, anchor, row, bends, tx, rx, tx_centre, rx_centre, node, node_time, beat_time, plane,
    reference_hz, bandwidth_hz, slope_hz_per_s, video_phase, oversampling, cells, even, odd, weights, first_tx, grid,
):  # fmt: skip
    """Add paths to the grid [lines, cells + margin, 2, TX * RX].

    :param table: [16, K] of :func:`datafactory.synthesis.spread.columns`
    :param anchor: [K] f_l between the two middle lines [cycles a frame]
    :param row: [K] the grid's row of the first line
    :param bends: [3, K] e_1, e_2, e_3, see :class:`datafactory.synthesis.motion.Motion`
    :param tx: [TX, 3] elements [m]; ``rx`` [3, E] of :func:`datafactory.synthesis.spread.padded` [m]
    :param tx_centre, rx_centre: [3] the arrays' centres, which choose the cell
    :param node, node_time: [nodes] positions in the frame, and when phases there are those of the scene [s]
    :param beat_time: when ranges are those of mid-frame [s]
    :param plane: plane waves over both arrays
    :param video_phase: 1.0 adds the residual video phase as far as it is linear in the departure from a cell
    :param oversampling: ``cells`` in a bin
    :param even, odd: of :class:`datafactory.synthesis.slow_time.LineWeights`
    :param weights: [taps, RANGE_TERMS] of the range's shift
    :param first_tx: index among the grid's TX of the first of ``tx``
    """
    path_count, nodes, tx_count, rx_count = table.shape[1], len(node), len(tx), rx.shape[1]
    stride = tx_count * rx_count
    flat = grid.reshape(grid.size)
    half_stride = grid.shape[3]
    strides = (grid.shape[1] * 2 * half_stride, 2 * half_stride, half_stride)
    counts = (2 * even.shape[1], len(weights))
    single = np.float32
    length = np.empty(rx_count)
    rx_re, rx_im = np.empty(nodes * rx_count, dtype=single), np.empty(nodes * rx_count, dtype=single)
    tx_re, tx_im = np.empty((tx_count, nodes), dtype=single), np.empty((tx_count, nodes), dtype=single)
    bend = np.empty(nodes, dtype=single)
    shift, departure = np.empty(stride, dtype=single), np.empty(tx_count)
    sums = np.empty(len(even) * 8 * stride, dtype=single)
    line_taps, cell_taps = (
        np.empty(counts[0] * 4 * stride, dtype=single),
        np.empty(counts[1] * 2 * stride, dtype=single),
    )
    bins_per_metre = bandwidth_hz / SPEED_OF_LIGHT
    for k in range(path_count):
        px, py, pz, qx, qy, qz, link = _at(table, k, beat_time)
        rx_leg = _length(qx, qy, qz, rx_centre, False)
        # The bend's mean over the frame is a range like any other.
        mean = bends[1, k] / 12.0
        middle = bins_per_metre * (_length(px, py, pz, tx_centre, False) + link + rx_leg) + mean
        nearest = np.floor(middle * oversampling + 0.5)
        delay = nearest / (oversampling * bandwidth_hz)
        frequency = (reference_hz - video_phase * slope_hz_per_s * delay) / SPEED_OF_LIGHT
        constant = 0.5 * video_phase * slope_hz_per_s * delay * delay
        for i in range(tx_count):
            leg = _length(px, py, pz, tx[i], plane) + link + rx_leg
            departure[i] = bins_per_metre * leg + mean - nearest / oversampling
        rx_lengths(qx, qy, qz, rx[0], rx[1], rx[2], plane, length)
        for i in range(tx_count):
            for e in range(rx_count):
                shift[i * rx_count + e] = departure[i] + bins_per_metre * (length[e] - rx_leg)
        for n in range(nodes):
            eta = node[n]
            bend[n] = eta * (bends[0, k] + bends[2, k] * eta * eta) + bends[1, k] * (eta * eta - 1.0 / 12.0)
            px, py, pz, qx, qy, qz, link = _at(table, k, node_time[n])
            for i in range(tx_count):
                cycles = frequency * (_length(px, py, pz, tx[i], plane) + link) + constant - anchor[k] * node[n]
                cosine, sine = phasor(cycles)
                tx_re[i, n] = cosine * table[14, k] - sine * table[15, k]
                tx_im[i, n] = cosine * table[15, k] + sine * table[14, k]
            rx_lengths(qx, qy, qz, rx[0], rx[1], rx[2], plane, length)
            _phasors(length, frequency, rx_re, rx_im, n * rx_count)
        for n in range(len(even)):
            last = nodes - 1 - n
            for i in range(tx_count):
                _pair(
                    (tx_re[i, n], tx_im[i, n], n * rx_count), (tx_re[i, last], tx_im[i, last], last * rx_count),
                    rx_re, rx_im, rx_count, (bend[n], bend[last], stride), 8 * n * stride + i * rx_count, sums,
                )  # fmt: skip
        _line_taps(sums, stride, even, odd, line_taps)
        _cell_taps(shift, stride, weights, cell_taps)
        first = row[k] * strides[0] + (int(nearest) % cells) * strides[1] + first_tx * rx_count
        _add_taps(line_taps, cell_taps, stride, first, strides, counts, flat)


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def _at(table, k, time):
    """TX point, RX point and length between of path k at a time."""
    return (
        table[0, k] + table[7, k] * time, table[1, k] + table[8, k] * time, table[2, k] + table[9, k] * time,
        table[3, k] + table[10, k] * time, table[4, k] + table[11, k] * time, table[5, k] + table[12, k] * time,
        table[6, k] + table[13, k] * time,
    )  # fmt: skip


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def line_spectrum(row, margin, spectrum):
    """One line's grid, folded to cyclic cells, as complex numbers in the channels' order.

    :param row: [cells + 2 * margin, 2, TX * padded RX]; what the margins hold belongs to the other end
    :param spectrum: [cells, RX, TX] complex64, overwritten
    """
    cells, rx_count, tx_count = spectrum.shape
    padded_rx = row.shape[2] // tx_count
    for cell in range(cells):
        for i in range(tx_count):
            for e in range(rx_count):
                at = i * padded_rx + e
                spectrum[cell, e, i] = complex(row[cell + margin, 0, at], row[cell + margin, 1, at])
    for outside in range(margin):
        for source in (outside, cells + margin + outside):
            cell = (source - margin) % cells
            for i in range(tx_count):
                for e in range(rx_count):
                    at = i * padded_rx + e
                    spectrum[cell, e, i] += complex(row[source, 0, at], row[source, 1, at])


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def fill_lines(frequency, scale, chirps, shape, taps, oversampling, rows):
    """cos and sin of 2 pi f eta', times the gain, for eta = p / chirps, p = 0, 1, ...

    :param scale: [samples] eta' / eta; ``rows`` [samples, 2, p, lines], overwritten
    """
    for n in range(len(scale)):
        for p in range(rows.shape[2]):
            eta = p / chirps * scale[n]
            width = np.pi * taps * eta / oversampling
            root = np.sqrt(shape * shape - width * width)
            gain = np.sinh(shape) / shape * root / np.sinh(root)
            cosines, sines = rows[n, 0, p], rows[n, 1, p]
            for line in range(len(frequency)):
                cosine, sine = phasor_like(frequency[line] * eta, cosines[line])
                cosines[line] = gain * cosine
                sines[line] = gain * sine


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def add_samples(product, first, cube):
    """Add samples from ``first`` on to ``cube`` [chirps, samples, channels].

    :param product: [samples, 2, p, 2 * channels] of cosines and of sines, for eta = p / chirps
    """
    chirps, _, channels = cube.shape
    middle = chirps // 2
    for n in range(product.shape[0]):
        for p in range(product.shape[2]):
            even, odd = product[n, 0, p], product[n, 1, p]
            if middle + p < chirps:
                line = cube[middle + p, first + n]
                for c in range(channels):
                    line[c] += complex(even[2 * c] - odd[2 * c + 1], even[2 * c + 1] + odd[2 * c])
            if 0 < p <= middle:
                line = cube[middle - p, first + n]
                for c in range(channels):
                    line[c] += complex(even[2 * c] + odd[2 * c + 1], even[2 * c + 1] - odd[2 * c])
