"""The truth's loop over paths: what a block of elements sees of a path, and its moments in a Doppler cell.

The equations are those of :mod:`datafactory.synthesis.truth`.
"""

from __future__ import annotations

from math import comb
from typing import NamedTuple

import numpy as np

from shared.physics.compiled import compiled, inlined
from shared.physics.cycles import short_phasor
from shared.physics.units import SPEED_OF_LIGHT

CELLS_PER_BIN = 2
"""Of the grid of range moments: a path is at most a quarter of a bin from its cell."""
SHIFT_TERMS = 5
"""Powers of the range remainder: -77 dB at the ends of the sweep for |z| <= 0.36 bins."""
DELTA_STEP = 1.0 / 16.0
"""Of the table's Doppler nodes [bins]; half of it is part of a path's departure, which sets its terms."""
CURVATURE_STEP = 1.0 / 32.0
"""Of the table's curvatures [cycles]: half of it turns the frame's edges, where Hann has no weight, by 0.025 rad."""
MAX_DOPPLER_TERMS = 10
BINOMIAL = np.array(
    [[comb(e, j) for j in range(MAX_DOPPLER_TERMS)] for e in range(MAX_DOPPLER_TERMS)], dtype=np.float64
)
_FAST = {"contract", "nsz", "arcp", "reassoc"}
BLOCK = 32
"""Elements that share a path's range cell and Doppler expansion; a number that the compiler knows, so that a loop over
them is a few vectors without a rest."""
_PHASE, _LEG, _RATE, _RE, _IM, _DEPART, _SHIFT = (BLOCK * n for n in range(7))
_PARTS = 7
"""Where the values of a block's elements stand in one array: the compiler sees that they do not overlap."""
_ONE, _TWO, _THREE, _FOUR, _FIVE = ((0,) * count for count in range(1, 6))
_NEAREST = np.float32(1e-18)
"""Square of the smallest distance of an element [m^2]."""


class Frame(NamedTuple):
    """A Doppler cell, and what frame and sweep are.

    :param frequency: of the cell [bins]
    :param nu: place in the sweep around which migration is developed
    :param lead: time by which ranges precede phases [s]; :param kappa: B / f_0
    """

    frequency: float
    nu: float
    chirps: float
    frame_s: float
    reference_hz: float
    bandwidth_hz: float
    lead: float
    kappa: float


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def add_doppler_moments(seen, path_terms, by_element, block, frame, needed, table_parts, binomial, grid):
    """Add K paths' moments in one Doppler cell to ``grid`` [cells, doppler terms * SHIFT_TERMS * 2 * BLOCK].

    With d from the block's centre to the path and t to an element, its leg is longer than the centre's, L, by
    l = (t^2 - 2 d t) / (2 L + l), and its rate is larger by -(v t + rate l) / (L + l). The l of the divisor may be
    float32, so that a float32 root serves: the phase is float64 until it is reduced. Range and Doppler beyond the
    centre's are small, and float32.

    :param seen: a :class:`datafactory.synthesis.mid_frame.MidFrame`; :param path_terms: Doppler terms of each path
    :param by_element: [K] whether every element has its own point of expansion, at the node of the table nearest to it
    :param frame: a :class:`Frame`
    :param block: its elements [BLOCK, 3] from its centre [m], and that centre [3]
    :param needed: [cells] of the grid
    """
    rx_point, rx_velocity, tx_length, tx_rate = seen.rx_point, seen.rx_velocity, seen.tx_length, seen.tx_rate
    curvature, amplitude = seen.curvature, seen.amplitude
    frequency, nu, chirps, frame_s, reference_hz, bandwidth_hz, lead, kappa = frame
    elements, rx_centre = block
    lowest_q, lowest_delta, table = table_parts
    single = np.float32
    per_slot = grid.shape[1]
    flat = grid.reshape(grid.size)
    work, factors = np.zeros(_PARTS * BLOCK, dtype=single), np.zeros(2 * MAX_DOPPLER_TERMS**2, dtype=single)
    place = np.zeros(4 * BLOCK)
    for c in range(BLOCK):
        x, y, z = elements[c]
        place[c], place[BLOCK + c], place[2 * BLOCK + c] = x, y, z
        place[3 * BLOCK + c] = x * x + y * y + z * z
    per_metre = reference_hz / SPEED_OF_LIGHT
    bins_per_metre = bandwidth_hz / SPEED_OF_LIGHT
    bins_of_leg, bins_of_rate = single(bins_per_metre), single(bins_per_metre * lead)
    scaled = 1.0 + kappa * nu
    doppler_per_rate = single(scaled * per_metre * frame_s)
    for k in range(len(path_terms)):
        vx, vy, vz = rx_velocity[k]
        cx, cy, cz = rx_point[k, 0] - rx_centre[0], rx_point[k, 1] - rx_centre[1], rx_point[k, 2] - rx_centre[2]
        centre_leg = np.sqrt(cx * cx + cy * cy + cz * cz)
        centre_rate = (cx * vx + cy * vy + cz * vz) / max(centre_leg, 1e-9)
        total = per_metre * frame_s * (tx_rate[k] + centre_rate)
        delta = scaled * total - frequency
        delta -= chirps * np.floor(delta / chirps + 0.5)
        ranged = bins_per_metre * (tx_length[k] + centre_leg + lead * (tx_rate[k] + centre_rate))
        cell = int(np.floor(ranged * CELLS_PER_BIN + 0.5))
        slot = cell % len(needed)
        q = min(max(int(np.floor(curvature[k] / CURVATURE_STEP + 0.5)) - lowest_q, 0), table.shape[0] - 1)
        node = int(np.floor((delta - lowest_delta) / DELTA_STEP + 0.5))
        inside = 0 <= node < table.shape[1]
        if not needed[slot] or not (inside or by_element[k]):
            continue
        response = table[q, node if inside else 0]
        # From the expansion's points to the centre: a part of a cell, and of a node.
        off_cell = single(ranged - cell / CELLS_PER_BIN)
        off_node = single(delta - lowest_delta - node * DELTA_STEP)
        migration = single(kappa * total)
        turned = per_metre * (tx_length[k] + centre_leg)
        turned -= np.floor(turned)
        k_re, k_im = single(amplitude[k].real), single(amplitude[k].imag)
        leg, square, rate = single(centre_leg), single(centre_leg * centre_leg), single(centre_rate)
        for c in range(BLOCK):
            x, y, z = place[c], place[BLOCK + c], place[2 * BLOCK + c]
            more = place[3 * BLOCK + c] - 2.0 * (cx * x + cy * y + cz * z)
            own = np.sqrt(max(square + single(more), _NEAREST))
            longer = more / (2.0 * centre_leg + single(more) / (own + leg))
            cycles = turned + per_metre * longer
            work[_PHASE + c] = cycles - np.floor(cycles + 0.5)
            work[_LEG + c] = longer
            work[_RATE + c] = -(single(vx * x + vy * y + vz * z) + rate * single(longer)) / own
        for c in range(BLOCK):
            longer, faster = work[_LEG + c], work[_RATE + c]
            cosine, sine = short_phasor(work[_PHASE + c])
            work[_RE + c] = cosine * k_re - sine * k_im
            work[_IM + c] = cosine * k_im + sine * k_re
            work[_SHIFT + c] = off_cell + bins_of_leg * longer + bins_of_rate * faster
            work[_DEPART + c] = off_node + doppler_per_rate * faster
        count = path_terms[k]
        scale = single(1.0)
        for j in range(count):
            for e in range(j, count):
                factors[2 * (j * count + e)] = scale * single(binomial[e, j] * response[e].real)
                factors[2 * (j * count + e) + 1] = scale * single(binomial[e, j] * response[e].imag)
            scale *= migration
        at = slot * per_slot
        if by_element[k]:
            _add_terms_by_element(work, table[q], node, chirps, migration, binomial, at, count, flat)
        elif count == 1:
            _add_terms(work, factors, at, _ONE, flat)
        elif count == 2:
            _add_terms(work, factors, at, _TWO, flat)
        elif count == 3:
            _add_terms(work, factors, at, _THREE, flat)
        elif count == 4:
            _add_terms(work, factors, at, _FOUR, flat)
        elif count == 5:
            _add_terms(work, factors, at, _FIVE, flat)
        else:
            _add_many_terms(work, factors, at, count, flat)


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _add_terms(work, factors, at, orders, flat):
    """Add migration^j sum_e C(e, j) G_e d^(e - j), by Horner's rule, times the echo and the powers of the range shift.

    :param factors: [2 * count * count] scale and G of j and e, real and imaginary
    :param orders: a tuple of as many entries as there are terms; only its length is used, which the compiler knows
    """
    count = len(orders)
    for c in range(BLOCK):
        re, im, shift, depart = work[_RE + c], work[_IM + c], work[_SHIFT + c], work[_DEPART + c]
        for j in range(count):
            b_re, b_im = factors[2 * (j * count + count - 1)], factors[2 * (j * count + count - 1) + 1]
            for e in range(count - 1):
                # All of a known number of steps, those below j left out: the compiler unrolls them.
                if count - 2 - e >= j:
                    b_re = b_re * depart + factors[2 * (j * count + count - 2 - e)]
                    b_im = b_im * depart + factors[2 * (j * count + count - 2 - e) + 1]
            a_re, a_im = b_re * re - b_im * im, b_re * im + b_im * re
            to = np.uint64(at + c)
            for p in range(SHIFT_TERMS):
                flat[to + np.uint64(2 * BLOCK * (j * SHIFT_TERMS + p))] += a_re
                flat[to + np.uint64(2 * BLOCK * (j * SHIFT_TERMS + p) + BLOCK)] += a_im
                a_re *= shift
                a_im *= shift


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _add_many_terms(work, factors, at, count, flat):
    """As :func:`_add_terms`, of any number of terms."""
    b_re, b_im = np.empty(BLOCK, dtype=np.float32), np.empty(BLOCK, dtype=np.float32)
    lanes = len(work) // _PARTS  # BLOCK: short loops of a known length would be unrolled before they are vectorised
    for j in range(count):
        highest = 2 * (j * count + count - 1)
        for c in range(lanes):
            b_re[c], b_im[c] = factors[highest], factors[highest + 1]
        for e in range(count - 2, j - 1, -1):
            g_re, g_im = factors[2 * (j * count + e)], factors[2 * (j * count + e) + 1]
            for c in range(lanes):
                b_re[c] = b_re[c] * work[_DEPART + c] + g_re
                b_im[c] = b_im[c] * work[_DEPART + c] + g_im
        for c in range(lanes):
            re, im, shift = work[_RE + c], work[_IM + c], work[_SHIFT + c]
            a_re, a_im = b_re[c] * re - b_im[c] * im, b_re[c] * im + b_im[c] * re
            to = np.uint64(at + c)
            for p in range(SHIFT_TERMS):
                flat[to + np.uint64(2 * BLOCK * p)] += a_re
                flat[to + np.uint64(2 * BLOCK * p + BLOCK)] += a_im
                a_re *= shift
                a_im *= shift
        at += 2 * BLOCK * SHIFT_TERMS


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _add_terms_by_element(work, responses, node, chirps, migration, binomial, at, count, flat):
    """As :func:`_add_terms`, each element's departure that from the node nearest to it.

    :param responses: [nodes, terms] of the path's curvature; :param node: from which the departures are
    """
    for c in range(BLOCK):
        away = np.floor(work[_DEPART + c] / DELTA_STEP + 0.5)
        nearest = node + int(away)
        if nearest < 0 or nearest >= len(responses):  # of few chirps the table holds more than a period
            nearest += int(chirps / DELTA_STEP) * (1 if nearest < 0 else -1)
            if nearest < 0 or nearest >= len(responses):
                continue
        departure = work[_DEPART + c] - away * DELTA_STEP
        echo, scale, to = complex(work[_RE + c], work[_IM + c]), 1.0, at + c
        for j in range(count):
            factor = 0.0j
            for e in range(count - 1, j - 1, -1):
                factor = factor * departure + binomial[e, j] * responses[nearest, e]
            term = scale * factor * echo
            scale *= migration
            for p in range(SHIFT_TERMS):
                flat[to + 2 * BLOCK * (j * SHIFT_TERMS + p)] += np.float32(term.real)
                flat[to + 2 * BLOCK * (j * SHIFT_TERMS + p) + BLOCK] += np.float32(term.imag)
                term *= work[_SHIFT + c]
