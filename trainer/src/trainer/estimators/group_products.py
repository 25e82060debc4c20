"""The model of a group of range-Doppler cells: what lines respond with, and their inner products.

The equations stand in :mod:`trainer.estimators.groups`. In cell m of channel c a line of unit amplitude shows as W_m(c)
e(c), with W the whitened window's response, real, and e(c) = exp(-j phase). Its derivatives have the same e(c) times W,
W' and the phase's slope. The inner products of two lines and their derivatives so follow, channel by channel, from
e^* e and four real sums over the cells: a third of the products that columns of all cells and channels would take. The
loops over channels have no branches and no calls, which is what lets them work on several channels at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shared.physics.compiled import inlined
from shared.physics.cycles import phasor
from trainer.estimators.small_matrices import part

FARTHEST = 2.5
"""Bins from a group's centre to a line that it is told of: what stands there reaches its outer cells."""
MOST_CELLS = 3
"""Of a group. Lines respond with nothing in those that it lacks: a loop of constant length costs less."""
POINTS_A_BIN, TABLE_BINS = 64, 6
"""Cubics of the table of a window's response: within 1e-8 of the peak; and how far from a group's centre it reaches,
the last bin with zeros alone: see :data:`trainer.estimators.fitting.RESPONSE_BINS`."""
COSINE, SINE, TURN, VALUE, SLOPE = 0, 1, 2, 3, 3 + MOST_CELLS
"""Rows of a line's response: real and imaginary part of e(c), the phase's slope, W and W' of each cell."""
ROWS = 3 + 2 * MOST_CELLS
FAST = {"reassoc", "contract", "nsz", "nnan", "ninf"}
"""Of sums over channels. The last two spare the products with the zero part of a real or imaginary factor."""
ZERO, ONE = np.int64(0), np.int64(1)
"""Of one type wherever they are passed on: see :data:`.small_matrices.part`."""


class Model(NamedTuple):
    """What all groups share; A search angles."""

    phase: NDArray[np.float64]
    """[C] k p_c [rad]"""
    walk: NDArray[np.float64]
    """[C] w_c [bins]"""
    curve: NDArray[np.float64]
    """[C] k q_c [rad m]"""
    window: NDArray[np.float64]
    """[S, 4, MOST_CELLS] coefficients of rising powers, by cells of the group: its whitened responses to an echo x bins
    above its centre, a cubic for each POINTS_A_BIN-th from x = -TABLE_BINS to TABLE_BINS"""
    cells: int
    """Of a group, at most MOST_CELLS"""
    cell: float
    """Resolution cell in u"""
    axis: NDArray[np.float64]
    """[A] uniform"""
    steering: NDArray[np.float64]
    """[2, C, A] real and imaginary part of exp(-j k p u)"""
    overlap: NDArray[np.complex128]
    """[A] mean over channels of exp(-j k p u) at multiples of the axis' step"""
    first: float
    """Threshold of the first line of a group"""
    further: float
    """Threshold of every other line"""
    limit: NDArray[np.float64]
    """[most + 1] energy in units of the noise below which nothing is added, by lines"""
    most: int
    """Lines of a group"""


class Work(NamedTuple):
    """Scratch of one group: V = lines (1 + coordinates) columns, two sets of what follows from the lines' places."""

    response: NDArray[np.float64]
    """[2, K, ROWS, C]"""
    gram: NDArray[np.complex128]
    """[2, V, V] inner products of the lines and their derivatives"""
    right: NDArray[np.complex128]
    """[2, V] and with x"""
    amplitude: NDArray[np.complex128]
    """[K] s of one set"""
    factor: NDArray[np.complex128]
    """[K, K] Cholesky factor L of its lines' Gram matrix"""
    mixed: NDArray[np.float64]
    """[2, K, V] real and imaginary part of L^-1 A^H D diag(s)"""
    curvature: NDArray[np.float64]
    """[V, V] its upper triangle"""
    slope: NDArray[np.float64]
    """[V]"""
    score: NDArray[np.float64]
    """[A] energy that a further line takes at each search angle"""
    matched: NDArray[np.float64]
    """[2, A] a^H P x / |a| there, real and imaginary part"""
    inside: NDArray[np.float64]
    """[K, 2, A] Q^H a / |a| there, Q an orthonormal basis of the lines"""


@part
def empty_work(most, coordinates, channels, angles):
    """Scratch for up to ``most`` lines."""
    columns = most * (1 + coordinates)
    response = np.zeros((2, most, ROWS, channels))
    response[:, :, VALUE] = 1.0  # of a single cell; else filled for each place
    return Work(
        response, np.empty((2, columns, columns), dtype=np.complex128), np.empty((2, columns), dtype=np.complex128),
        np.empty(most, dtype=np.complex128), np.empty((most, most), dtype=np.complex128), np.empty((2, most, columns)),
        np.empty((columns, columns)), np.empty(columns), np.empty(angles), np.empty((2, angles)),
        np.empty((most, 2, angles)),
    )  # fmt: skip


class Group(NamedTuple):
    """The data of one group."""

    x: NDArray[np.float64]
    """[2, MOST_CELLS, C] real and imaginary part, whitened, of largest element about 1"""
    coordinates: int | np.int64
    """Of a line, that the cells tell: 1, its u, or 2, its range as well"""
    noise: float
    """Power of one element"""
    energy: float
    """|x|^2"""
    bend: float
    """1 / R [1/m]"""
    migration: float
    """Bins through which an echo may migrate in the frame"""


@inlined(error_model="numpy", fastmath={"contract"})
def _fill_waves(model, bend, u, line, response, which):
    """e(c) and its phase's slope."""
    for c in range(len(model.phase)):
        bent = model.curve[c] * bend * u
        cosine, sine = phasor((model.phase[c] + bent) * u * (-0.5 / np.pi))
        response[which, line, COSINE, c], response[which, line, SINE, c] = cosine, sine
        response[which, line, TURN, c] = model.phase[c] + 2.0 * bent


@inlined(error_model="numpy", fastmath={"contract"})
def table_place(x):
    """Place of an echo x bins above the centre in ``Model.window``, in cubics; in it even for a NaN, by the order."""
    return (max(-TABLE_BINS, min(TABLE_BINS, x)) + TABLE_BINS) * POINTS_A_BIN


@inlined(error_model="numpy", fastmath={"contract"})
def _fill_windows(model, u, offset, line, response, which):
    """W and W' of each cell. An echo above the centre stands in a cell as the cell below it does: h is even."""
    window = model.window
    for c in range(len(model.walk)):
        response[which, line, VALUE, c] = table_place(offset - model.walk[c] * u)
    for c in range(len(model.walk)):
        place = response[which, line, VALUE, c]
        i = int(place)
        t = place - i
        for m in range(MOST_CELLS):
            linear, square, cube = window[i, 1, m], window[i, 2, m], window[i, 3, m]
            response[which, line, VALUE + m, c] = window[i, 0, m] + t * (linear + t * (square + t * cube))
            response[which, line, SLOPE + m, c] = -POINTS_A_BIN * (linear + 2.0 * t * (square + 1.5 * t * cube))


@inlined(error_model="numpy", fastmath=FAST)
def _wave_pair(response, which, a, b):
    """Inner products of line a and its derivative by u with those of b, where W is 1; that of the lines is known."""
    lu = ul = uu = 0j
    for c in range(response.shape[3]):
        wave_a = complex(response[which, a, COSINE, c], -response[which, a, SINE, c])
        wave = wave_a * complex(response[which, b, COSINE, c], response[which, b, SINE, c])
        turn_a, turn_b = 1j * response[which, a, TURN, c], -1j * response[which, b, TURN, c]
        lu += turn_b * wave
        ul += turn_a * wave
        uu += turn_a * turn_b * wave
    return lu, ul, uu


@inlined(error_model="numpy", fastmath=FAST)
def _pair(response, which, a, b, walk):
    """Inner products of line a and its derivatives by u and range with those of b, by a first; that of the lines is
    known."""
    lu = lr = ul = uu = ur = rl = ru = rr = 0j
    for c in range(response.shape[3]):
        wave_a = complex(response[which, a, COSINE, c], -response[which, a, SINE, c])
        wave = wave_a * complex(response[which, b, COSINE, c], response[which, b, SINE, c])
        values = slope_a = slope_b = slopes = 0.0
        for m in range(MOST_CELLS):
            values += response[which, a, VALUE + m, c] * response[which, b, VALUE + m, c]
            slope_a += response[which, a, SLOPE + m, c] * response[which, b, VALUE + m, c]
            slope_b += response[which, a, VALUE + m, c] * response[which, b, SLOPE + m, c]
            slopes += response[which, a, SLOPE + m, c] * response[which, b, SLOPE + m, c]
        # The derivative of W e by u is (w W' - j turn W) e, that by the range offset -W' e.
        w, turn_a, turn_b = walk[c], 1j * response[which, a, TURN, c], -1j * response[which, b, TURN, c]
        by_u_value = w * (slope_a * wave) + turn_a * (values * wave)
        by_u_slope = w * (slopes * wave) + turn_a * (slope_b * wave)
        lu += w * (slope_b * wave) + turn_b * (values * wave)
        lr -= slope_b * wave
        ul += by_u_value
        uu += w * by_u_slope + turn_b * by_u_value
        ur -= by_u_slope
        rl -= slope_a * wave
        ru -= w * (slopes * wave) + turn_b * (slope_a * wave)
        rr += slopes * wave
    return lu, lr, ul, uu, ur, rl, ru, rr


@inlined(error_model="numpy", fastmath=FAST)
def _data(response, which, a, walk, x):
    """Inner products of line a and its derivatives by u and range with x."""
    line = by_u = by_range = 0j
    for c in range(response.shape[3]):
        wave = complex(response[which, a, COSINE, c], -response[which, a, SINE, c])
        value = slope = 0j
        for m in range(MOST_CELLS):
            value += response[which, a, VALUE + m, c] * complex(x[0, m, c], x[1, m, c])
            slope += response[which, a, SLOPE + m, c] * complex(x[0, m, c], x[1, m, c])
        value, slope = wave * value, wave * slope
        line += value
        by_u += walk[c] * slope + 1j * response[which, a, TURN, c] * value
        by_range -= slope
    return line, by_u, by_range


@inlined(error_model="numpy", fastmath=FAST)
def _values(response, which, a, b):
    """Inner product of lines a and b alone."""
    total = 0j
    for c in range(response.shape[3]):
        values = 0.0
        for m in range(MOST_CELLS):
            values += response[which, a, VALUE + m, c] * response[which, b, VALUE + m, c]
        wave_a = complex(response[which, a, COSINE, c], -response[which, a, SINE, c])
        total += values * (wave_a * complex(response[which, b, COSINE, c], response[which, b, SINE, c]))
    return total


@part
def evaluate(model, group, place, lines, work, which):
    """Fill set ``which`` of ``work`` for lines at ``place`` [K, 2], but for the products of derivatives: more than half
    of the steps that are tried lead nowhere, and none is asked for. Of the Gram matrix the lower triangle."""
    response, right, wide = work.response, work.right, 1 + group.coordinates
    for k in range(lines):
        a = k * wide
        _fill_waves(model, group.bend, place[k, 0], k, response, which)
        if wide == 3:
            _fill_windows(model, place[k, 0], place[k, 1], k, response, which)
        right[which, a], right[which, a + 1], by_range = _data(response, which, k, model.walk, group.x)
        if wide == 3:
            right[which, a + 2] = by_range
        for j in range(k + 1):
            work.gram[which, a, j * wide] = _values(response, which, k, j)


@part
def differentiate(model, wide, lines, work, which):
    """Fill the products of derivatives of a set that :func:`evaluate` filled."""
    response, gram = work.response, work.gram
    for k in range(lines):
        a = k * wide
        for j in range(k + 1):
            b = j * wide
            if wide == 2:
                lu, ul, uu = _wave_pair(response, which, k, j)
                gram[which, a, b + 1], gram[which, a + 1, b], gram[which, a + 1, b + 1] = lu, ul, uu
                continue
            lu, lr, ul, uu, ur, rl, ru, rr = _pair(response, which, k, j, model.walk)
            gram[which, a, b + 1], gram[which, a, b + 2] = lu, lr
            gram[which, a + 1, b], gram[which, a + 1, b + 1], gram[which, a + 1, b + 2] = ul, uu, ur
            gram[which, a + 2, b], gram[which, a + 2, b + 1], gram[which, a + 2, b + 2] = rl, ru, rr
