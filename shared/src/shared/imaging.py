"""Range-angle images: delay-and-sum of the input arrays, near-field matched filter of the virtual sensor.

Both compensate the delay of eq. (2). With the sign of eq. (1) the echo of a target at u = sin(azimuth) has the phase
-k u (y_tx + y_rx) over the virtual elements, so that the weights are exp(+j k u (y_tx + y_rx)) and the image peaks at
+u. (Eq. (7)-(9) of the paper, taken literally with its eq. (1), peak at -u.) k belongs to mid-sweep, f_c + B/2, where
the range window has its weight: an echo's phase in a range bin is that of mid-sweep.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from shared.arrays import AntennaArray
from shared.cycles import phasor
from shared.radar import Radar
from shared.sweep import reference_frequency_hz, shift_polynomials, sweep_positions
from shared.units import SPEED_OF_LIGHT
from shared.windows import hann

DEFAULT_TERMS = 5
"""Polynomial terms of the range walk in truth images."""
WALK_REACH = 0.8
"""Range walk [bins] that the terms must follow: +-0.71 bins at u = 0.85 over 256 elements, more as the front curves."""


def steering_matrix(radar: Radar, array: AntennaArray) -> NDArray[np.complex128]:
    """[C, U] delay-and-sum weights exp(j k u (y_tx + y_rx)), eq. (9) with the sign of eq. (2); plane waves.

    Valid from about 5 m for the input array of 94 mm: nearer than that the wave front's curvature costs gain.
    """
    wavenumber = 2.0 * np.pi / radar.waveform.wavelength_m
    return np.exp(1j * wavenumber * array.virtual[:, 1:2] * radar.grid.u[None, :])


def delay_and_sum(
    range_channel: NDArray[np.complex64], radar: Radar, channels: NDArray[np.intp] | None = None
) -> NDArray[np.complex64]:
    """[..., R, U] complex images of range-channel matrices [..., R, C], eq. (8), divided by the channels used.

    :param channels: indices of the virtual elements to use; all by default
    """
    weights = steering_matrix(radar, radar.array)
    if channels is not None:
        weights, range_channel = weights[channels], range_channel[..., channels]
    if range_channel.shape[-1] != len(weights):
        raise ValueError(f"range_channel has {range_channel.shape[-1]} channels; expected {len(weights)}")
    return (range_channel @ (weights / len(weights)).astype(np.complex64)).astype(np.complex64, copy=False)


def pixel_delays(radar: Radar, array: AntennaArray, range_m: float) -> NDArray[np.float64]:
    """[C, U] round trip [s] from each element pair to the pixels (range, u) in the plane z = 0, eq. (2)."""
    u = radar.grid.u
    pixel = np.stack([range_m * np.sqrt(1.0 - u**2), range_m * u, np.zeros_like(u)], axis=-1)  # (U, 3)
    tx_leg = np.linalg.norm(array.tx[:, None] - pixel, axis=-1)
    rx_leg = np.linalg.norm(array.rx[:, None] - pixel, axis=-1)
    return (tx_leg[array.channel_tx] + rx_leg[array.channel_rx]) / SPEED_OF_LIGHT


def matched_filter_row(
    fast_time: NDArray[np.complexfloating], radar: Radar, array: AntennaArray, row: int
) -> NDArray[np.complex128]:
    """[U] one image row by the exact matched filter, the slow reference.

    I(r, u) = 1/C sum_c sum_n w_n / sum(w) s_c[n] exp(-j 2 pi (f_c + B n / N) tau_c(r, u))

    :param fast_time: [samples, C] the virtual sensor's signal in the row's Doppler cell
    """
    waveform = radar.waveform
    window = hann(waveform.samples)
    tau = pixel_delays(radar, array, row * waveform.range_step_m)
    frequency = waveform.carrier_hz + waveform.bandwidth_hz * np.arange(waveform.samples) / waveform.samples
    weighted = fast_time * (window / window.sum())[:, None]
    image = np.zeros(radar.grid.bins, dtype=np.complex128)
    for channel in range(array.channels):
        image += weighted[:, channel] @ np.exp(-2j * np.pi * frequency[:, None] * tau[channel][None, :])
    return image / array.channels


def sweep_moments(fast_time: NDArray[np.complexfloating], radar: Radar, terms: int) -> NDArray[np.complex128]:
    """[terms, R, C] range spectra of ``fast_time`` [samples, C] weighted by the polynomials of the range walk.

    Y_p[r] = sum_n w_n / sum(w) q_p(nu_n) s[n] exp(-j 2 pi r nu_n),   nu_n = (n - N/2) / N

    with q_p of :func:`shared.sweep.shift_polynomials`: s compressed at r + d is sum_p (-d)^p Y_p[r], |d| <= WALK_REACH.
    """
    samples = radar.waveform.samples
    nu = sweep_positions(samples)
    weighted = fast_time * (hann(samples) / hann(samples).sum())[:, None]
    centre = np.exp(2j * np.pi * np.arange(radar.waveform.range_bins) * (samples // 2) / samples)[:, None]
    spectra = [
        centre * np.fft.fft(weighted * polynomial[:, None], axis=0)[: radar.waveform.range_bins]
        for polynomial in shift_polynomials(nu, WALK_REACH, terms)
    ]
    return np.stack(spectra)


@numba.njit(cache=True, error_model="numpy")
def _row_matrix(tx, rx, tx_of, rx_of, range_m, u, reference_hz, bandwidth_hz, row, terms, matrix):
    """Fill ``matrix`` [terms, C, U]: steering phase at mid-sweep times powers of the range walk [bins]."""
    channels = len(tx_of)
    x = range_m * np.sqrt(1.0 - u * u)
    y = range_m * u
    for c in range(channels):
        tx_x, tx_y, tx_z = tx[tx_of[c]]
        rx_x, rx_y, rx_z = rx[rx_of[c]]
        for j in range(len(u)):
            tx_leg = np.sqrt((tx_x - x[j]) ** 2 + (tx_y - y[j]) ** 2 + tx_z**2)
            rx_leg = np.sqrt((rx_x - x[j]) ** 2 + (rx_y - y[j]) ** 2 + rx_z**2)
            tau = (tx_leg + rx_leg) / SPEED_OF_LIGHT
            cosine, sine = phasor(-reference_hz * tau)
            walk = np.float32(row - bandwidth_hz * tau)
            value = np.complex64(complex(cosine / channels, sine / channels))
            for p in range(terms):
                matrix[p, c, j] = value
                value *= walk


def near_field_images(moments: NDArray[np.complex64], radar: Radar, array: AntennaArray) -> NDArray[np.complex64]:
    """[B, R, U] near-field matched-filter images of a batch of sweep moments [B, terms, R, C].

    The delay of each pixel and element pair is exact; only its departure from the row's own range, at most 1.5 bins
    over 256 elements, is developed into a polynomial of ``terms`` terms, so that a row is one matrix product for all
    frames of the batch. The matrix costs as much as some ten frames: image in batches. One BLAS thread, because a
    product's last bits depend on how it is split: for the same batch size the same bytes.
    """
    batch, terms, rows, channels = moments.shape
    if channels != array.channels or rows != radar.waveform.range_bins:
        raise ValueError(
            f"moments are [{batch}, {terms}, {rows}, {channels}]; expected [batch, terms, "
            f"{radar.waveform.range_bins}, {array.channels}]"
        )
    waveform, grid = radar.waveform, radar.grid
    reference_hz = reference_frequency_hz(radar)
    images = np.empty((batch, rows, grid.bins), dtype=np.complex64)
    matrix = np.empty((terms, channels, grid.bins), dtype=np.complex64)
    by_row = np.ascontiguousarray(moments.transpose(2, 0, 1, 3)).reshape(rows, batch, terms * channels)
    with threadpool_limits(limits=1, user_api="blas"):
        for row in range(rows):
            _row_matrix(
                array.tx, array.rx, array.channel_tx, array.channel_rx, row * waveform.range_step_m,
                grid.u, reference_hz, waveform.bandwidth_hz, float(row), terms, matrix,
            )  # fmt: skip
            images[:, row] = by_row[row] @ matrix.reshape(terms * channels, grid.bins)
    return images
