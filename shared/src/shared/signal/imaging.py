"""Range-angle images: delay-and-sum of the input arrays, near-field matched filter of the virtual sensor.

Both compensate the delay of eq. (2). With the sign of eq. (1) the echo of a target at u = sin(azimuth) has the phase
-k u (y_tx + y_rx) over the virtual elements, so that the weights are exp(+j k u (y_tx + y_rx)) and the image peaks at
+u. (Eq. (7)-(9) of the paper, taken literally with its eq. (1), peak at -u.) k belongs to mid-sweep, f_c + B/2, where
the range window has its weight: an echo's phase in a range bin is that of mid-sweep.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex, Complex64, Complex128, Int
from numpy.typing import NDArray
from scipy.special import jv
from threadpoolctl import threadpool_limits

from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import ImageGrid, Radar
from shared.radar.arrays import AntennaArray
from shared.signal.near_field_kernels import PRODUCT_FRAMES, Pairs, Row, fill_folded, fill_matrix, fold_signals, unfold
from shared.signal.signal import manifold
from shared.signal.sweep import reference_frequency_hz, shift_polynomials, sweep_positions
from shared.signal.windows import angle_window, unit_hann

DEFAULT_TERMS = 5
"""Polynomial terms of the range walk: -70 dB of the image's peak from 3 to 60 m (``make bench``, truth_vs_exact)."""
WALK_REACH, WALK_SHARE = 0.62, 0.87
"""Range walk [bins] that the terms are fitted to, and its share of the outermost element's walk where that is more. It
reaches +-0.71 bins at u = 0.85 over 256 elements and 1 GHz, but only at the outermost; fitted to 0.8 the errors are
10 dB larger, to 0.54 3 to 6 dB (5 terms, with echoes at u = +-0.84)."""


def walk_reach(radar: Radar) -> float:
    """Range walk [bins] across the virtual sensor that the terms are fitted to, by plane waves.

    Limit: in rows nearer than the sensor is wide the waves curve, and walk as far. Where a grid is narrow (0.1) and
    a sweep is wide (4 GHz) that costs -47 dB at 0.4 m.
    """
    aside_m = float(np.abs(radar.virtual_sensor.virtual[:, 1]).max())
    outermost = aside_m * float(np.abs(radar.grid.u).max()) * radar.waveform.bandwidth_hz / SPEED_OF_LIGHT
    return max(WALK_REACH, WALK_SHARE * outermost)


def walk_terms(radar: Radar, terms: int) -> int:
    """How many terms a radar needs for what ``terms`` keep at a walk of WALK_REACH: 13 for 5 at 4 GHz.

    What n terms leave out of a walk of z bins is about 2 J_n(pi z), see :func:`shared.signal.sweep.shift_polynomials`.
    Limit: their float32 powers cancel. Of a band of 4 GHz -80 dB are left of that, of 6 GHz -64, of 8 GHz -38.
    """
    argument, needed = np.pi * walk_reach(radar), terms
    while needed < argument or jv(needed, argument) > jv(terms, np.pi * WALK_REACH):
        needed += 1
    return needed


def steering_matrix(radar: Radar, array: AntennaArray) -> Complex128[np.ndarray, "channels bins"]:
    """[C, U] delay-and-sum weights exp(j k u (y_tx + y_rx)), eq. (9) with the sign of eq. (2); plane waves.

    Valid from about 5 m for the input array of 94 mm: nearer than that the wave front's curvature costs gain.
    """
    return manifold(array.virtual[:, 1], radar.waveform.wavelength_m, radar.grid.u).conj()


def steering_weights(
    radar: Radar, channels: Int[np.ndarray, " channels"] | slice = slice(None)
) -> Complex64[np.ndarray, "channels bins"]:
    """[C, U] weights of eq. (9) for these channels of the radar's array, divided by their number."""
    weights = steering_matrix(radar, radar.array)[channels]
    return (weights / len(weights)).astype(np.complex64)


def sensor_weights(radar: Radar, window: str) -> Complex128[np.ndarray, "channels bins"]:
    """[C, U] weights of the virtual sensor for plane waves, as the truth's window has them, divided by their number."""
    sensor = radar.virtual_sensor
    return angle_window(window, sensor.channels)[:, None] / sensor.channels * steering_matrix(radar, sensor)


def delay_and_sum(
    range_channel: Complex[np.ndarray, "*rows channels"],
    radar: Radar,
    channels: Int[np.ndarray, " used"] | None = None,
) -> Complex64[np.ndarray, "*rows bins"]:
    """[..., R, U] complex images of range-channel matrices [..., R, C], eq. (8), divided by the channels used.

    :param channels: indices of the virtual elements to use; all by default
    """
    used = slice(None) if channels is None else channels
    return (range_channel[..., used] @ steering_weights(radar, used)).astype(np.complex64, copy=False)


def sweep_moments(
    fast_time: Complex[np.ndarray, "samples channels"], radar: Radar, terms: int
) -> Complex128[np.ndarray, "{terms} rows channels"]:
    """[terms, R, C] range spectra of ``fast_time`` [samples, C] weighted by the polynomials of the range walk.

    Y_p[r] = sum_n w_n / sum(w) q_p(nu_n) s[n] exp(-j 2 pi r nu_n),   nu_n = (n - N/2) / N

    with q_p of :func:`shared.signal.sweep.shift_polynomials`: s compressed at r + d is sum_p (-d)^p Y_p[r], for |d|
    up to about :func:`walk_reach`.
    """
    samples = radar.waveform.samples
    nu = sweep_positions(samples)
    weighted = fast_time * unit_hann(samples)[:, None]
    centre = np.exp(2j * np.pi * np.arange(radar.waveform.range_bins) * (samples // 2) / samples)[:, None]
    spectra = [
        centre * np.fft.fft(weighted * polynomial[:, None], axis=0)[: radar.waveform.range_bins]
        for polynomial in shift_polynomials(nu, walk_reach(radar), terms)
    ]
    return np.stack(spectra)


def _product(signal: NDArray[np.complex64], matrix: NDArray[np.float32]) -> NDArray[np.float32]:
    """[groups, 2, F, U] re and im of sum s conj(m) over matrix m [terms, C, 2, U].

    One real product a group: with s = a + j b and m = x + j y the sum is a x + b y + j (b x - a y), and -j s = b - j a.

    :param signal: [groups, 2, F = PRODUCT_FRAMES, terms, C] s and -j s
    """
    groups, _, frames = signal.shape[:3]
    columns = matrix.shape[-1]
    lines = signal.view(np.float32).reshape(groups, 2 * frames, -1)
    return (lines @ matrix.reshape(-1, columns)).reshape(groups, 2, frames, columns)


def _mirror_column(array: AntennaArray, grid: ImageGrid) -> int | None:
    """J such that column J - j of the grid's axis is -u_j, if channel C - 1 - c is the mirror image of channel c.

    The mirror is the x-z plane. None where array or grid have no such symmetry, or the middle channel is its own image.
    """
    mirror = np.array([1.0, -1.0, 1.0])
    tx, rx = array.tx[array.channel_tx], array.rx[array.channel_rx]
    symmetric = np.array_equal(tx[::-1] * mirror, tx) and np.array_equal(rx[::-1] * mirror, rx)
    return grid.mirror if symmetric and array.channels % 2 == 0 else None


def near_field_images(
    moments: Complex[np.ndarray, "batch terms rows channels"], radar: Radar, array: AntennaArray
) -> Complex64[np.ndarray, "batch rows bins"]:
    """[B, R, U] near-field matched-filter images of a batch of sweep moments [B, terms, R, C].

    The delay of each pixel and element pair is exact; only its departure from the row's own range, at most 1.5 bins
    over 256 elements, is developed into a polynomial of ``terms`` terms, so that a row is a matrix product for all
    frames of the batch. The matrix costs as much as some eight frames: image in batches. A product's last bits depend
    on its size and on how it is split among threads. Every product here is one of PRODUCT_FRAMES frames on one BLAS
    thread, so that a frame has the same bytes in every batch.

    Where array and u axis are symmetric, an element is as far from the pixel at -u as its mirror image is from the one
    at +u. With M the matrix and s, s' the signals of an element and of its mirror image, summed over half of the
    elements,

        I(+-u) = sum (s + s') (M(u) + M(-u)) / 2  +-  sum (s - s') (M(u) - M(-u)) / 2,

    which is half the work in filling the matrices and in multiplying by them.
    """
    batch, terms, rows, channels = moments.shape
    if channels != array.channels or rows != radar.waveform.range_bins:
        raise ValueError(
            f"moments are [{batch}, {terms}, {rows}, {channels}]; expected [batch, terms, "
            f"{radar.waveform.range_bins}, {array.channels}]"
        )
    moments = np.ascontiguousarray(moments, dtype=np.complex64)
    images = np.empty((batch, rows, radar.grid.bins), dtype=np.complex64)
    crossing = _mirror_column(array, radar.grid)
    with threadpool_limits(limits=1, user_api="blas"):
        if crossing is None:
            _whole_images(moments, radar, array, images)
        else:
            _folded_images(moments, radar, array, crossing, images)
    return images


def _whole_images(moments: NDArray, radar: Radar, array: AntennaArray, images: NDArray) -> None:
    """Fill ``images`` with no use of symmetry."""
    batch, terms, _, channels = moments.shape
    signal = np.zeros((-(-batch // PRODUCT_FRAMES), 2, PRODUCT_FRAMES, terms, channels), dtype=np.complex64)
    matrix = np.empty((terms, channels, 2, radar.grid.bins), dtype=np.float32)
    pairs = Pairs(array.tx, array.rx, array.channel_tx, array.channel_rx)
    for row, range_m in enumerate(radar.waveform.ranges_m):
        fill_matrix(pairs, _row(radar, row, range_m, radar.grid.u, 1.0 / channels), matrix)
        for b in range(batch):
            signal[b // PRODUCT_FRAMES, :, b % PRODUCT_FRAMES] = moments[b, :, row], -1j * moments[b, :, row]
        product = _product(signal, matrix).swapaxes(1, 2).reshape(-1, 2, radar.grid.bins)[:batch]
        images.real[:, row], images.imag[:, row] = product[:, 0], product[:, 1]


def _folded_images(moments: NDArray, radar: Radar, array: AntennaArray, crossing: int, images: NDArray) -> None:
    """Fill ``images`` by their halves u >= 0 and u < 0, see :func:`near_field_images`."""
    (batch, terms, _, channels), grid = moments.shape, radar.grid
    half = channels // 2
    # Columns j >= J / 2 have u_j >= 0; u holds these and the mirror images of the others, perhaps beyond the grid.
    first = min(max((crossing + 1) // 2, 0), grid.bins)
    last = max(crossing, grid.bins - 1) if first else grid.bins - 1
    start = min(first, crossing - first + 1) if first else 0
    u = grid.u_start + grid.step * np.arange(start, last + 1)
    lines = (-(-batch // PRODUCT_FRAMES), 2, PRODUCT_FRAMES, terms, half)
    sums, differences = np.zeros(lines, dtype=np.complex64), np.zeros(lines, dtype=np.complex64)
    even, odd = (np.empty((terms, half, 2, len(u)), dtype=np.float32) for _ in range(2))
    pairs = Pairs(array.tx, array.rx, array.channel_tx[half:], array.channel_rx[half:])
    for row, range_m in enumerate(radar.waveform.ranges_m):
        fill_folded(pairs, _row(radar, row, range_m, u, 0.5 / channels), even, odd)
        fold_signals(moments, row, sums, differences)
        unfold(_product(sums, even), _product(differences, odd), row, start, crossing, first, images)


def _row(radar: Radar, number: int, range_m: float, u: NDArray, scale: float) -> Row:
    cycles_per_metre = reference_frequency_hz(radar) / SPEED_OF_LIGHT
    bins_per_metre = radar.waveform.bandwidth_hz / SPEED_OF_LIGHT
    return Row(float(number), range_m, u, cycles_per_metre, bins_per_metre, np.float32(scale))
