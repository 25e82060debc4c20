"""The truth's loop over paths: what a block of elements sees of a path, and its moments in a Doppler cell.

The equations are those of :mod:`datafactory.synthesis.truth`.
"""

from __future__ import annotations

from math import comb

import numpy as np

from shared.physics.compiled import compiled
from shared.physics.cycles import phasor_like
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


@compiled(nogil=True, error_model="numpy", fastmath=_FAST)
def add_doppler_moments(
    chosen, path_terms, rx_point, rx_velocity, tx_length, tx_rate, curvature, amplitude,
    rx, rx_centre, frequency, chirps, frame_s,
    reference_hz, bandwidth_hz, lead, kappa, needed, table_parts, binomial, grid,
):  # fmt: skip
    """Add the chosen paths' moments in one Doppler cell to ``grid`` [cells, SHIFT_TERMS * doppler terms, 2, RX].

    :param path_terms: [K] Doppler terms of each path
    :param frequency: of the Doppler cell [bins]
    :param lead: time by which ranges precede phases [s]
    :param kappa: B / f_0, 0 for ranges that do not move within the frame
    :param needed: [cells] of the grid
    """
    lowest_q, lowest_delta, table = table_parts
    doppler_terms = grid.shape[1] // SHIFT_TERMS
    count, single = len(rx), np.float32
    leg, rate = np.empty(count), np.empty(count)
    x, y, z = rx[:, 0].copy(), rx[:, 1].copy(), rx[:, 2].copy()
    re, im = np.empty(count, dtype=single), np.empty(count, dtype=single)
    depart, shift = np.empty(count, dtype=single), np.empty(count, dtype=single)
    b_re, b_im = np.empty(count, dtype=single), np.empty(count, dtype=single)
    a_re, a_im = np.empty(count, dtype=single), np.empty(count, dtype=single)
    per_metre = reference_hz / SPEED_OF_LIGHT
    bins_per_metre = bandwidth_hz / SPEED_OF_LIGHT
    for k in chosen:
        qx, qy, qz = rx_point[k]
        vx, vy, vz = rx_velocity[k]
        cx, cy, cz = qx - rx_centre[0], qy - rx_centre[1], qz - rx_centre[2]
        centre_leg = np.sqrt(cx * cx + cy * cy + cz * cz)
        centre_rate = (cx * vx + cy * vy + cz * vz) / max(centre_leg, 1e-9)
        total = per_metre * frame_s * (tx_rate[k] + centre_rate)
        delta = total - frequency
        delta -= chirps * np.floor(delta / chirps + 0.5)
        ranged = tx_length[k] + lead * tx_rate[k]
        cell = int(np.floor(bins_per_metre * (ranged + centre_leg + lead * centre_rate) * CELLS_PER_BIN + 0.5))
        slot = cell % len(needed)
        q = min(max(int(np.floor(curvature[k] / CURVATURE_STEP + 0.5)) - lowest_q, 0), table.shape[0] - 1)
        node = int(np.floor((delta - lowest_delta) / DELTA_STEP + 0.5))
        if not needed[slot] or node < 0 or node >= table.shape[1]:
            continue
        response = table[q, node]
        origin = total - delta + lowest_delta + node * DELTA_STEP
        migration = single(kappa * total)
        offset = cell / CELLS_PER_BIN - bins_per_metre * ranged
        k_re, k_im = single(amplitude[k].real), single(amplitude[k].imag)
        # Each loop uses few arrays: the compiler tests at most about eight pairs of arrays for overlap.
        for c in range(count):
            dx, dy, dz = qx - x[c], qy - y[c], qz - z[c]
            leg[c] = np.sqrt(dx * dx + dy * dy + dz * dz)
        for c in range(count):
            rate[c] = ((qx - x[c]) * vx + (qy - y[c]) * vy + (qz - z[c]) * vz) / leg[c]
        for c in range(count):
            cosine, sine = phasor_like(per_metre * (tx_length[k] + leg[c]), re[c])
            re[c] = cosine * k_re - sine * k_im
            im[c] = cosine * k_im + sine * k_re
        for c in range(count):
            shift[c] = bins_per_metre * (leg[c] + lead * rate[c]) - offset
            depart[c] = per_metre * frame_s * (tx_rate[k] + rate[c]) - origin
        scale = np.float32(1.0)
        last = path_terms[k] - 1
        for j in range(last + 1):
            # migration^j sum_e C(e, j) G_e d^(e - j), by Horner's rule
            top_re = np.float32(binomial[last, j] * response[last].real)
            top_im = np.float32(binomial[last, j] * response[last].imag)
            for c in range(count):
                b_re[c], b_im[c] = top_re, top_im
            for e in range(last - 1, j - 1, -1):
                g_re = np.float32(binomial[e, j] * response[e].real)
                g_im = np.float32(binomial[e, j] * response[e].imag)
                for c in range(count):
                    b_re[c] = b_re[c] * depart[c] + g_re
                    b_im[c] = b_im[c] * depart[c] + g_im
            for c in range(count):
                a_re[c] = scale * (b_re[c] * re[c] - b_im[c] * im[c])
            for c in range(count):
                a_im[c] = scale * (b_re[c] * im[c] + b_im[c] * re[c])
            for p in range(SHIFT_TERMS):
                moment_re, moment_im = grid[slot, p * doppler_terms + j, 0], grid[slot, p * doppler_terms + j, 1]
                for c in range(count):
                    moment_re[c] += a_re[c]
                    a_re[c] *= shift[c]
                for c in range(count):
                    moment_im[c] += a_im[c]
                    a_im[c] *= shift[c]
            scale *= migration
