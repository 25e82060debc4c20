"""Echoes to IF samples: moments of the delays on a grid of range cells, then one FFT a moment.

Eq. (1) at sample n, with nu = (n - N/2) / N, f_0 = f_c + B/2 the frequency there, and x = B tau the range in bins:

    s[n] = sum_k A_k exp(j 2 pi f_0 tau_k) exp(j 2 pi x_k nu_n)

Split x = g / h + z into a cell g of a grid h times finer than the bins and a remainder z, and develop the remainder's
phasor into powers of z (:mod:`shared.sweep`):

    s[n] = sum_p q_p(nu_n) sum_g M_p[g] exp(j 2 pi g nu_n / h),      M_p[g] = sum_{k in g} A_k exp(j 2 pi f_0 tau_k)
    z_k^p

All channels share the cell of the array's centre, so that the moments of a path are added to one contiguous stretch of
memory, and every path costs channels * terms multiply-adds; paths come sorted by range, so that the stretch stays in
cache. The sums over g are FFTs. The error is the remainder's, bounded by :func:`shared.sweep.shift_error`, plus
rounding.

Delays are evaluated in float64 for every TX, RX and chirp; the phase is reduced modulo one cycle before it is rounded.
"""

from __future__ import annotations

import numba
import numpy as np

from shared.cycles import phasor
from shared.units import SPEED_OF_LIGHT

CHUNK = 128
"""Paths whose phases are evaluated together: long enough to vectorise, short enough to stay in the first cache."""


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract", "nsz", "arcp"})
def _legs(count, x, y, z, elements, link, cycles_per_metre, constant, bins_per_metre, offset, re, im, shift):
    """Phasor and range [bins] of the leg from every element [E, 3] to the first ``count`` points x, y, z [B], plus
    ``link`` metres.
    """
    for e in range(len(elements)):
        ex, ey, ez = elements[e, 0], elements[e, 1], elements[e, 2]
        for k in range(count):
            dx, dy, dz = x[k] - ex, y[k] - ey, z[k] - ez
            leg = np.sqrt(dx * dx + dy * dy + dz * dz) + link[k]
            re[e, k], im[e, k] = phasor(cycles_per_metre[k] * leg + constant[k])
            shift[e, k] = bins_per_metre * leg - offset[k]


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract", "nsz", "arcp"})
def add_moments(
    tx_point, rx_point, tx_velocity, rx_velocity, between, between_rate, amplitude,
    tx, rx, tx_centre, rx_centre, time, reference_hz, bandwidth_hz, slope_hz_per_s, video_phase, oversampling, moments,
):  # fmt: skip
    """Add all paths at one instant to ``moments``.

    Paths as in :class:`datafactory.paths.table.ScatteredPaths`, amplitude [K] complex128.

    :param tx, rx: [TX, 3], [RX, 3] elements [m]; ``tx_centre``, ``rx_centre`` [3] their centres, which choose the cell
    :param time: start of the chirp [s]
    :param video_phase: 1.0 adds the residual video phase -mu tau^2 / 2 up to its part quadratic in the remainder z
    :param moments: [cells, terms, 2 * RX * TX] real; re, im of channels in tx-major order
    """
    cells, terms, width = moments.shape
    tx_count, rx_count = len(tx), len(rx)
    # One allocation each: slices of a common array lose their contiguous layout in numba, and with it vectorisation.
    px, py, pz = np.empty(CHUNK), np.empty(CHUNK), np.empty(CHUNK)
    qx, qy, qz = np.empty(CHUNK), np.empty(CHUNK), np.empty(CHUNK)
    link, zero, tx_offset, rx_offset = np.empty(CHUNK), np.zeros(CHUNK), np.empty(CHUNK), np.empty(CHUNK)
    frequency, constant = np.empty(CHUNK), np.empty(CHUNK)
    cell = np.empty(CHUNK, dtype=np.int64)
    on_tx, on_rx = (tx_count, CHUNK), (rx_count, CHUNK)
    tx_re, tx_im, tx_shift = np.empty(on_tx), np.empty(on_tx), np.empty(on_tx)
    rx_re, rx_im, rx_shift = np.empty(on_rx), np.empty(on_rx), np.empty(on_rx)
    real = moments.dtype.type
    r_re, r_im = np.empty(rx_count, dtype=moments.dtype), np.empty(rx_count, dtype=moments.dtype)
    r_shift = np.empty(rx_count, dtype=moments.dtype)
    term = np.empty((tx_count, rx_count, 2), dtype=moments.dtype)
    remainder = np.empty((tx_count, rx_count, 2), dtype=moments.dtype)
    flat_term, flat_remainder = term.reshape(width), remainder.reshape(width)
    bins_per_metre = bandwidth_hz / SPEED_OF_LIGHT
    for first in range(0, len(amplitude), CHUNK):
        count = min(CHUNK, len(amplitude) - first)
        for b in range(count):
            k = first + b
            px[b] = tx_point[k, 0] + tx_velocity[k, 0] * time
            py[b] = tx_point[k, 1] + tx_velocity[k, 1] * time
            pz[b] = tx_point[k, 2] + tx_velocity[k, 2] * time
            qx[b] = rx_point[k, 0] + rx_velocity[k, 0] * time
            qy[b] = rx_point[k, 1] + rx_velocity[k, 1] * time
            qz[b] = rx_point[k, 2] + rx_velocity[k, 2] * time
            link[b] = between[k] + between_rate[k] * time
            tx_leg = np.sqrt((px[b] - tx_centre[0]) ** 2 + (py[b] - tx_centre[1]) ** 2 + (pz[b] - tx_centre[2]) ** 2)
            rx_leg = np.sqrt((qx[b] - rx_centre[0]) ** 2 + (qy[b] - rx_centre[1]) ** 2 + (qz[b] - rx_centre[2]) ** 2)
            cell[b] = int(np.floor(bins_per_metre * (tx_leg + link[b] + rx_leg) * oversampling + 0.5))
            # Each leg has its own offset, so that both shifts are small before they are rounded to float32.
            rx_offset[b] = bins_per_metre * rx_leg
            tx_offset[b] = cell[b] / oversampling - rx_offset[b]
            # tau^2 = tau_0 (2 tau - tau_0) + (z / B)^2 with tau_0 the cell's delay; the last term is in the
            # polynomials.
            delay = cell[b] / (oversampling * bandwidth_hz)
            frequency[b] = (reference_hz - video_phase * slope_hz_per_s * delay) / SPEED_OF_LIGHT
            constant[b] = 0.5 * video_phase * slope_hz_per_s * delay * delay
        _legs(
            count, px, py, pz, tx, link, frequency, constant, bins_per_metre, tx_offset,
            tx_re, tx_im, tx_shift,
        )  # fmt: skip
        _legs(
            count, qx, qy, qz, rx, zero, frequency, zero, bins_per_metre, rx_offset,
            rx_re, rx_im, rx_shift,
        )  # fmt: skip
        for b in range(count):
            a_re, a_im = amplitude[first + b].real, amplitude[first + b].imag
            for j in range(rx_count):
                r_re[j], r_im[j], r_shift[j] = rx_re[j, b], rx_im[j, b], rx_shift[j, b]
            for i in range(tx_count):
                t_re = real(tx_re[i, b] * a_re - tx_im[i, b] * a_im)
                t_im = real(tx_re[i, b] * a_im + tx_im[i, b] * a_re)
                t_shift = real(tx_shift[i, b])
                part, rest = term[i], remainder[i]
                for j in range(rx_count):
                    part[j, 0] = t_re * r_re[j] - t_im * r_im[j]
                    part[j, 1] = t_re * r_im[j] + t_im * r_re[j]
                    rest[j, 0] = t_shift + r_shift[j]
                    rest[j, 1] = t_shift + r_shift[j]
            row = moments[cell[b] % cells]
            for p in range(terms):
                moment = row[p]
                for c in range(width):
                    moment[c] += flat_term[c]
                    flat_term[c] *= flat_remainder[c]
