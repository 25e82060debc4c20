"""How much a frame would change without an effect: the equations, path by path.

Every figure is an amplitude ratio: the change of an echo's response over the response's peak. A path's power times the
square of its change is summed in the truth's resolution cells, without phase, and the strongest cell is held against
the strongest cell of everything.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.table import PathTable
from shared.physics.compiled import compiled
from shared.physics.vectors import lengths
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.radar.waveform import Waveform
from shared.signal.windows import hann

Real = NDArray[np.float64]

POINTS = 64
"""Samples of the windows in these integrals; their spectra are a few bins wide."""
PADDING = 16


def doppler_change(radial_mps: Real, waveform: Waveform) -> Real:
    """[K] change of the range-Doppler response when an echo of this range rate stands still.

    max over the Doppler axis of |W(nu - f) - W(nu)|, W the Hann window's spectrum, f the Doppler shift in bins.
    """
    bins = np.abs(radial_mps) / waveform.velocity_step_mps
    return _shift_change(bins)


def intra_chirp_change(radial_mps: Real, waveform: Waveform) -> Real:
    """[K] change of the range response when an echo stands still within each chirp.

    Its Doppler shift moves it by 2 v T_c / lambda range bins.
    """
    bins = 2.0 * np.abs(radial_mps) * waveform.chirp_duration_s / waveform.wavelength_m
    return _shift_change(bins)


def migration_change(radial_mps: Real, waveform: Waveform) -> Real:
    """[K] change of the range-Doppler response when an echo keeps its range of mid-frame.

    max over both axes of |sum w w exp(j 2 pi (eta y + nu x)) (exp(j 2 pi m eta nu) - 1)|, m the bins it crosses.
    """
    crossed = np.abs(radial_mps) * waveform.chirps * waveform.chirp_interval_s / waveform.range_step_m
    grid, values = _migration_table()
    return np.interp(crossed, grid, values)


def plane_wave_change(paths: PathTable, array: AntennaArray, wavelength_m: float) -> Real:
    """[K] change of the array's image when waves are plane over it, a phase common to all channels taken out.

    With d_c the channels' phase errors, min over phi of rms |1 - exp(j (d_c - phi))| = sqrt(2 - 2 |mean exp(j d_c)|),
    which bounds the change of the beamformer's output (Cauchy and Schwarz).
    """
    tx, rx = array.tx[array.channel_tx], array.rx[array.channel_rx]
    scattered, specular = paths.scattered, paths.specular
    error = _curvature(scattered.tx_point, tx) + _curvature(scattered.rx_point, rx)
    # A mirror shows the TX's image; seen from it an RX stands displaced by both their places.
    displaced = rx - np.einsum("kij,cj->kci", specular.axes, tx - specular.reference)
    error = np.concatenate([error, _curvature(specular.image, displaced)])
    coherence = np.abs(np.mean(np.exp(2j * np.pi * error / wavelength_m), axis=1))
    return np.sqrt(np.maximum(2.0 - 2.0 * coherence, 0.0))


def _curvature(point: Real, elements: Real) -> Real:
    """[K, C] spherical less plane wave's length [m] from points [K, 3] to elements [C, 3] or [K, C, 3]."""
    distance = np.maximum(lengths(point), 1e-9)[:, None]
    spherical = lengths(point[:, None] - elements)
    return spherical - (distance - np.sum(point[:, None] * elements, axis=2) / distance)


def plane_wave_bound(paths: PathTable, array: AntennaArray, wavelength_m: float) -> Real:
    """[K] what :func:`plane_wave_change` does not exceed, in closed form.

    An element at distance a from the origin sees a point at R > a with sqrt(d^2 + h^2) - d <= h^2 / 2 d, where h <= a
    is its distance from the line of sight and d >= R - a. The channels' phase errors so lie in an interval [0, D], and
    |mean exp(j d_c)| >= cos(D / 2), so that the change is at most 2 sin(D / 4), and sqrt(2) where D exceeds pi.

    Of scattered paths it is also at most the standard deviation of d_c, because |mean exp(j d_c)| >= 1 - var(d_c) / 2.
    That of the quadratic part, k h^2 / 2 R, is a closed form of the direction; the rest is at most a / (R - a) of it.
    """
    tx, rx = (float(np.linalg.norm(places, axis=1).max()) for places in (array.tx, array.rx))
    scattered, specular = paths.scattered, paths.specular
    at_tx, at_rx = lengths(scattered.tx_point), lengths(scattered.rx_point)
    error = _largest_curvature(at_tx, tx) + _largest_curvature(at_rx, rx)
    spread = np.hypot(_spread(scattered.tx_point, at_tx, array.tx), _spread(scattered.rx_point, at_rx, array.rx))
    spread += _remainder(at_tx, tx) + _remainder(at_rx, rx)
    displaced = rx + tx + float(np.linalg.norm(specular.reference))
    error = np.concatenate([error, _largest_curvature(lengths(specular.image), displaced)])
    bound = 2.0 * np.sin(0.25 * np.minimum(2.0 * np.pi * error / wavelength_m, np.pi))
    by_spread = np.full(len(bound), np.inf)
    by_spread[: len(scattered)] = 2.0 * np.pi * spread / wavelength_m
    return np.minimum(bound, by_spread)


def _spread(point: Real, distance: Real, elements: Real) -> Real:
    """[K] standard deviation over the elements of h^2 / 2 R [m], h their distance from the line of sight.

    :param distance: [K] of the points [K, 3]
    """
    # h^2 = |x|^2 - (n x)^2 is linear in 1 and the six products of n's components; so its variance is a quadratic form.
    rows, columns = np.triu_indices(3)
    products = elements[:, rows] * elements[:, columns] * np.where(rows == columns, 1.0, 2.0)
    terms = np.column_stack([np.sum(elements**2, axis=1), -products])
    covariance = (terms - terms.mean(axis=0)).T @ (terms - terms.mean(axis=0)) / len(terms)
    return _deviation(np.ascontiguousarray(point), np.maximum(distance, 1e-9), covariance)


@compiled()
def _deviation(point, distance, covariance):
    """[K] sqrt(d C d) / 2 R of the directions' terms d: 1, xx, xy, xz, yy, yz, zz."""
    result, d = np.empty(len(point)), np.empty(7)
    for k in range(len(point)):
        x, y, z = point[k, 0] / distance[k], point[k, 1] / distance[k], point[k, 2] / distance[k]
        d[0], d[1], d[2], d[3], d[4], d[5], d[6] = 1.0, x * x, x * y, x * z, y * y, y * z, z * z
        variance = 0.0
        for i in range(7):
            inner = 0.0
            for j in range(7):
                inner += covariance[i, j] * d[j]
            variance += d[i] * inner
        result[k] = np.sqrt(max(variance, 0.0)) / (2.0 * distance[k])
    return result


def _remainder(distance: Real, reach_m: float) -> Real:
    """[K] the most by which the curvature differs from its quadratic part [m]: e = h^2 / (d + sqrt(d^2 + h^2)), where
    both terms lie within R - a and R + a."""
    beyond = np.maximum(distance - reach_m, 1e-9)
    return 0.5 * reach_m**2 / np.maximum(distance, 1e-9) * reach_m / beyond


def _largest_curvature(distance: Real, reach_m: float) -> Real:
    """[K] the most that :func:`_curvature` can be for elements within ``reach_m`` of the origin [m]."""
    beyond = distance - reach_m
    return np.where(beyond > 0.0, 0.5 * reach_m**2 / np.where(beyond > 0.0, beyond, 1.0), np.inf)


def range_rates_mps(paths: PathTable, waveform: Waveform) -> Real:
    """[K] magnitude of the range rates seen from the origin: the larger of the means over both halves of the frame.

    Twice its product with half a frame's time is the most that the round trip differs from that of mid-frame at the
    frame's edges: an echo that passes abeam, whose rate is zero for a moment, is not at rest.
    """
    half_s = 0.5 * waveform.chirps * waveform.chirp_interval_s
    ranges = np.stack([_range_at(paths, time_s) for time_s in (0.0, half_s, 2.0 * half_s)])
    return np.abs(np.diff(ranges, axis=0)).max(axis=0, initial=0.0) / half_s


def _range_at(paths: PathTable, time_s: float) -> Real:
    """[K] half the paths' lengths at a time [m]."""
    one, specular = paths.scattered, paths.specular
    legs = _moved_lengths(one.tx_point, one.tx_velocity, time_s) + _moved_lengths(one.rx_point, one.rx_velocity, time_s)
    between = one.between_m + one.between_rate_mps * time_s
    return 0.5 * np.concatenate([legs + between, lengths(specular.image + specular.image_velocity * time_s)])


@compiled()
def _moved_lengths(point, velocity, time_s):
    """[K] distances of moving points from the origin at a time [m]."""
    result = np.empty(len(point))
    for k in range(len(point)):
        x = point[k, 0] + velocity[k, 0] * time_s
        y = point[k, 1] + velocity[k, 1] * time_s
        z = point[k, 2] + velocity[k, 2] * time_s
        result[k] = np.sqrt(x * x + y * y + z * z)
    return result


def pattern_change(paths: PathTable, radar: Radar) -> Real:
    """[K] change of an illuminated echo's amplitude when every direction gets boresight's gain, over the amplitude."""
    front_end = radar.front_end
    scattered, specular = paths.scattered, paths.specular
    departure = np.concatenate([scattered.tx_point, specular.departure()])
    arrival = np.concatenate([scattered.rx_point, specular.image])
    ahead = np.array([1.0, 0.0, 0.0])
    gain = front_end.tx_pattern.power_gain(departure) * front_end.rx_pattern.power_gain(arrival)
    boresight = float(front_end.tx_pattern.power_gain(ahead) * front_end.rx_pattern.power_gain(ahead))
    return np.abs(np.sqrt(boresight / np.maximum(gain, 1e-30 * boresight)) - 1.0)


def _shift_change(bins: Real) -> Real:
    grid, values = _shift_table()
    return np.interp(bins, grid, values)


@lru_cache(maxsize=1)
def _shift_table() -> tuple[Real, Real]:
    place = (np.arange(POINTS) - POINTS / 2) / POINTS
    window = hann(POINTS) / hann(POINTS).sum()
    grid = np.concatenate([[0.0], np.geomspace(1e-4, 3.0, 200)])
    moved = window * (np.exp(2j * np.pi * grid[:, None] * place) - 1.0)
    return grid, np.abs(np.fft.fft(moved, PADDING * POINTS, axis=1)).max(axis=1)


@lru_cache(maxsize=1)
def _migration_table() -> tuple[Real, Real]:
    place = (np.arange(POINTS) - POINTS / 2) / POINTS
    window = hann(POINTS) / hann(POINTS).sum()
    weight = np.outer(window, window)
    grid = np.concatenate([[0.0], np.geomspace(1e-3, 8.0, 60)])
    values = [
        np.abs(np.fft.fft2(weight * (np.exp(2j * np.pi * crossed * np.outer(place, place)) - 1.0), (256, 256))).max()
        for crossed in grid
    ]
    return grid, np.array(values)
