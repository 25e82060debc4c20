"""The compiled loops of :func:`shared.signal.imaging.near_field_images`: the delays, and what symmetry folds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from shared.physics.compiled import compiled, inlined
from shared.physics.cycles import single_phasor

PRODUCT_FRAMES = 4
"""Frames of one matrix product; batches are filled up with zeros. OpenBLAS treats its eight rows alike on the kinds of
processor that were tried; of sixteen its kernels for Haswell, which Zen has too, give some rows other last bits."""


class Pairs(NamedTuple):
    """C pairs of elements.

    :param tx, rx: places [m]; :param tx_of, rx_of: their numbers in each pair
    """

    tx: Float64[np.ndarray, "tx 3"]
    rx: Float64[np.ndarray, "rx 3"]
    tx_of: Int64[np.ndarray, " channels"]
    rx_of: Int64[np.ndarray, " channels"]


class Row(NamedTuple):
    """A row of an image, ``range_m`` away.

    :param u: of its pixels; :param scale: of its phasors
    :param cycles_per_metre: at mid-sweep; :param bins_per_metre: of the range
    """

    number: float
    range_m: float
    u: Float64[np.ndarray, " bins"]
    cycles_per_metre: float
    bins_per_metre: float
    scale: np.float32


@inlined(error_model="numpy", fastmath={"contract", "nsz", "arcp"})
def _steer(tx_leg, x, y, element, row, re, im, walk):
    """Fill re, im, walk [U] for one element pair: phasor of the delay at mid-sweep, range walk [bins].

    :param tx_leg: [U] from the TX to the pixels (x, y, 0) [m]; ``element`` [3] the RX [m]
    """
    rx_x, rx_y, rx_z = element[0], element[1], element[2]
    for j in range(len(x)):
        dx, dy = x[j] - rx_x, y[j] - rx_y
        path = tx_leg[j] + np.sqrt(dx * dx + dy * dy + rx_z * rx_z)
        cosine, sine = single_phasor(row.cycles_per_metre * path)
        re[j], im[j] = row.scale * cosine, row.scale * sine
        walk[j] = row.number - row.bins_per_metre * path


@inlined(error_model="numpy", fastmath={"contract", "nsz", "arcp"})
def _store_power(value, walk, line):
    """``line`` = value; value *= walk; all [U]. A call of its own: one loop over more lines does not vectorise."""
    for j in range(len(line)):
        line[j] = value[j]
        value[j] *= walk[j]


@inlined(error_model="numpy", fastmath={"contract", "nsz", "arcp"})
def _store_folded_power(left, right, left_walk, right_walk, even, odd):
    """``even`` = left + right, ``odd`` = left - right; then left, right *= their walks; all [U]."""
    for j in range(len(even)):
        even[j] = left[j] + right[j]
        odd[j] = left[j] - right[j]
        left[j] *= left_walk[j]
        right[j] *= right_walk[j]


@inlined(error_model="numpy")
def _pixels(row):
    """x and y [U] of a row's pixels [m]."""
    return row.range_m * np.sqrt(1.0 - row.u * row.u), row.range_m * row.u


@inlined(error_model="numpy")
def _pixel_legs(elements, x, y):
    """[E, U] distances from elements [E, 3] to the pixels (x, y, 0) [m]."""
    legs = np.empty((len(elements), len(x)))
    for e in range(len(elements)):
        for j in range(len(x)):
            legs[e, j] = np.sqrt((x[j] - elements[e, 0]) ** 2 + (y[j] - elements[e, 1]) ** 2 + elements[e, 2] ** 2)
    return legs


@compiled(error_model="numpy")
def fill_matrix(pairs, row, matrix):
    """Fill ``matrix`` [terms, C, 2, U]: re and im of the delays' phasors times powers of the range walk [bins].

    Real and imaginary parts stand in lines of their own: interleaved stores took four times as long.
    """
    terms, channels, _, columns = matrix.shape
    x, y = _pixels(row)
    tx_leg = _pixel_legs(pairs.tx, x, y)
    re, im, walk = np.empty(columns, np.float32), np.empty(columns, np.float32), np.empty(columns, np.float32)
    for c in range(channels):
        _steer(tx_leg[pairs.tx_of[c]], x, y, pairs.rx[pairs.rx_of[c]], row, re, im, walk)
        for p in range(terms):
            _store_power(re, walk, matrix[p, c, 0])
            _store_power(im, walk, matrix[p, c, 1])


@compiled(error_model="numpy")
def fill_folded(pairs, row, even, odd):
    """Sum and difference of :func:`fill_matrix` at +u and -u into ``even`` and ``odd`` [terms, C, 2, U]."""
    terms, channels, _, columns = even.shape
    x, y = _pixels(row)
    mirror_y = -y
    tx_leg, mirror_leg = _pixel_legs(pairs.tx, x, y), _pixel_legs(pairs.tx, x, mirror_y)
    l_re, l_im, l_walk = np.empty(columns, np.float32), np.empty(columns, np.float32), np.empty(columns, np.float32)
    r_re, r_im, r_walk = np.empty(columns, np.float32), np.empty(columns, np.float32), np.empty(columns, np.float32)
    for c in range(channels):
        i, element = pairs.tx_of[c], pairs.rx[pairs.rx_of[c]]
        _steer(tx_leg[i], x, y, element, row, l_re, l_im, l_walk)
        _steer(mirror_leg[i], x, mirror_y, element, row, r_re, r_im, r_walk)
        for p in range(terms):
            _store_folded_power(l_re, r_re, l_walk, r_walk, even[p, c, 0], odd[p, c, 0])
            _store_folded_power(l_im, r_im, l_walk, r_walk, even[p, c, 1], odd[p, c, 1])


@compiled(error_model="numpy")
def fold_signals(moments, row, even, odd):
    """Fill ``even`` and ``odd`` with s + s' and s - s', where s' is the signal of an element's mirror image.

    :param moments: [B, terms, R, C]
    :param even, odd: [groups, 2, PRODUCT_FRAMES, terms, C / 2], the signal s and -j s
    """
    batch, terms, _, channels = moments.shape
    half = channels // 2
    for b in range(batch):
        group, frame = b // PRODUCT_FRAMES, b % PRODUCT_FRAMES
        for p in range(terms):
            signal = moments[b, p, row]
            plus, plus_turned = even[group, 0, frame, p], even[group, 1, frame, p]
            minus, minus_turned = odd[group, 0, frame, p], odd[group, 1, frame, p]
            for c in range(half):
                one, other = signal[half + c], signal[half - 1 - c]
                total, difference = one + other, one - other
                plus[c], plus_turned[c] = total, complex(total.imag, -total.real)
                minus[c], minus_turned[c] = difference, complex(difference.imag, -difference.real)


@compiled(error_model="numpy")
def unfold(even, odd, row, offset, crossing, first, images):
    """Write even + odd to columns j of an image row, and even - odd to their mirror images, columns ``crossing`` - j.

    :param even, odd: [groups, 2, PRODUCT_FRAMES, columns] re and im of columns j = ``offset`` and on
    :param first: columns from this one on are written as they stand, those before as mirror images
    """
    batch, _, bins = images.shape
    end = offset + even.shape[3]
    for b in range(batch):
        group, frame = b // PRODUCT_FRAMES, b % PRODUCT_FRAMES
        even_re, even_im = even[group, 0, frame], even[group, 1, frame]
        odd_re, odd_im = odd[group, 0, frame], odd[group, 1, frame]
        image = images[b, row]
        for j in range(max(first, offset), min(bins, end)):
            k = j - offset
            image[j] = complex(even_re[k] + odd_re[k], even_im[k] + odd_im[k])
        for j in range(max(crossing - end + 1, 0), min(crossing - offset + 1, first)):
            k = crossing - j - offset
            image[j] = complex(even_re[k] - odd_re[k], even_im[k] - odd_im[k])
