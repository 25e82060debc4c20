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
from jaxtyping import Float32

from datafactory.synthesis.lines_at_centres import CHUNK, Paths, Weights, see_from_centres
from datafactory.synthesis.spread import LANES, Sensor, Sweep
from shared.physics.compiled import compiled, inlined
from shared.physics.cycles import phasor_like
from shared.physics.units import SPEED_OF_LIGHT

_FAST = {"contract", "nsz", "arcp"}
AT_ONCE = 16
"""Chunks of paths whose centres are seen, then their elements: enough not to notice two calls, few enough to stay in
the cache. A path takes 0.73 microseconds with 1, 0.59 with 4, 0.56 with 16: docs/notes/synthesis.md."""
_RE, _IM, _BINS, _D, _Q, _C = (LANES * n for n in range(6))
"""Where the parts of what elements see of a path stand in one array, so that the compiler sees that they do not
overlap: the phasor at mid-frame; range [bins], d, q and c [cycles] beyond the centre's."""


class Forms(NamedTuple):
    """What the loops over elements are compiled for.

    :param cells, powers: of a path and of the range's shift, the shape of ``Weights.cells``
    :param orders: the separable terms
    :param terms: of a line's polynomial in d
    :param parts: CLOSE_PARTS with q and c, 1 with neither
    """

    cells: int
    powers: int
    orders: int
    terms: int
    parts: int


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _rx_seen(place, point, velocity, leg, scales, parts, work, seen):
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
    if len(parts) > 1:
        square = vx * vx + vy * vy + vz * vz
        for lane in range(LANES):
            inverse, rate = work[LANES + lane], work[2 * LANES + lane]
            bend = (square - rate * rate) * inverse
            seen[_Q + lane] = 0.5 * cycles * frame_s**2 * (bend - bend_0)
            seen[_C + lane] = cycles * frame_s**3 / 6.0 * (-3.0 * rate * bend * inverse - jerk_0)


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _channels(rx_seen, tx_seen, kappa, lead, parts, seen):
    """TX and RX together: the product of their phasors, the sums of all else; the range is that of the beat."""
    t_re, t_im, t_bins, t_d, t_q, t_c = tx_seen
    for lane in range(LANES):
        re, im = rx_seen[_RE + lane], rx_seen[_IM + lane]
        seen[_RE + lane], seen[_IM + lane] = t_re * re - t_im * im, t_re * im + t_im * re
        d = t_d + rx_seen[_D + lane]
        z = t_bins + rx_seen[_BINS + lane] + kappa * lead * d
        if len(parts) > 1:
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
def _line_taps(seen, coefficients, part, step, terms, parts, to, taps):
    """A line's weight with one number of orders, re and im of LANES from index ``to``.

    :param part: where the coefficients of this path and line begin; ``step`` from there to those of q, q^2, c
    """
    for lane in range(LANES):
        d, a_re, a_im = seen[_D + lane], seen[_RE + lane], seen[_IM + lane]
        x, y = _polynomial(coefficients, np.uint64(part), d, terms)
        if len(parts) > 1:
            u, v = _polynomial(coefficients, np.uint64(part + step), d, terms)
            x, y = x + seen[_Q + lane] * u, y + seen[_Q + lane] * v
        taps[np.uint64(to + lane)] = x * a_re - y * a_im
        taps[np.uint64(to + LANES + lane)] = x * a_im + y * a_re
    if len(parts) > 1:
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


def add_lines(
    paths: Paths, sensor: Sensor, sweep: Sweep, weights: Weights, forms: Forms, grid: Float32[np.ndarray, ...]
) -> None:
    """Add paths to the grid [lines, TX * panels, cells + margin, 2, LANES]."""
    count, known = paths.table.shape[1], tuple((0,) * length for length in forms)
    for first in range(0, count, AT_ONCE * CHUNK):
        chunks = min(AT_ONCE, -(-(count - first) // CHUNK))
        seen = see_from_centres(paths, first, chunks, (forms.orders, forms.parts), sensor, sweep, weights)
        add_elements(paths, first, seen, sensor, sweep, weights.cells, known, grid)


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def add_elements(paths, first, centres, sensor, sweep, cell_weights, forms, grid):
    """Add the paths from ``first`` on, as far as their centres are known, to the grid.

    :param forms: tuples of which only the lengths are used, which the compiler knows: see :class:`Forms`
    """
    cells, powers, orders, terms, parts = forms
    table, coefficients = paths.table, centres.coefficients.reshape(centres.coefficients.size)
    single = np.float32
    panels, tx_count, flat = sensor.rx.shape[1] // LANES, len(sensor.tx), grid.reshape(grid.size)
    panel_stride = grid.shape[2] * 2 * LANES
    line_stride = grid.shape[1] * panel_stride
    frame_s, kappa, lead = sweep.frame_s, sweep.kappa, (sweep.beat_time - sweep.mid_time) / sweep.frame_s
    mid, bins_per_metre = sweep.mid_time, sweep.bandwidth_hz / SPEED_OF_LIGHT
    place = np.empty((panels, 3 * LANES))
    for axis in range(3):
        for e in range(sensor.rx.shape[1]):
            place[e // LANES, axis * LANES + e % LANES] = sensor.rx[axis, e]
    flat_weights = cell_weights.reshape(cell_weights.size)
    path_stride, line_step = centres.coefficients.shape[4], 2 * len(terms)
    part_stride = centres.cell.size * path_stride
    lines = path_stride // line_step
    work, seen = np.empty(3 * LANES), np.zeros(6 * LANES, dtype=single)
    rx_seen = np.zeros((panels, 6 * LANES), dtype=single)
    cell_taps = np.empty(len(orders) * len(cells) * LANES, dtype=single)
    line_taps = np.empty(2 * len(orders) * LANES, dtype=single)
    for here in range(min(centres.cell.size, table.shape[1] - first)):
        path, chunk, b = first + here, here // CHUNK, here % CHUNK
        vx, vy, vz = table[10, path], table[11, path], table[12, path]
        point = (table[3, path] + vx * mid, table[4, path] + vy * mid, table[5, path] + vz * mid)
        leg = centres.rx_leg[chunk]
        centre_leg = (leg[0, b], leg[1, b], leg[2, b], leg[3, b])
        scales = (centres.frequency[chunk, b], bins_per_metre, frame_s)
        for panel in range(panels):
            _rx_seen(place[panel], point, (vx, vy, vz), centre_leg, scales, parts, work, rx_seen[panel])
        start = paths.row[path] * line_stride + (int(centres.cell[chunk, b]) % sweep.cells) * 2 * LANES
        for i in range(tx_count):
            one = centres.tx_seen[chunk, i]
            tx_seen = (
                single(one[0, b]), single(one[1, b]), single(one[2, b]),
                single(one[3, b]), single(one[4, b]), single(one[5, b]),
            )  # fmt: skip
            for panel in range(panels):
                _channels(rx_seen[panel], tx_seen, single(kappa), single(lead), parts, seen)
                _cell_taps(seen, flat_weights, cells, powers, orders, cell_taps)
                at = start + ((sensor.first_tx + i) * panels + panel) * panel_stride
                for line in range(lines):
                    for order in range(len(orders)):
                        part = order * len(parts) * part_stride + here * path_stride + line * line_step
                        _line_taps(seen, coefficients, part, part_stride, terms, parts, 2 * order * LANES, line_taps)
                    _add_taps(line_taps, cell_taps, cells, orders, at + line * line_stride, flat)
