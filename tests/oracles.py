"""Slow references, each written from its equation and sharing no code with what it judges beyond the data classes.

The IF signal is summed in float64 path by path from the delay laws of the PathTable; mirrors are mirrored; images come
from the full cube of the virtual sensor. Nothing here is fast, and nothing here approximates.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from datafactory.paths.table import PathTable, ScatteredPaths, SpecularPaths
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.signal.windows import hann

LIGHT_MPS = 299_792_458.0


Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


def reference_file(*parts: str) -> Path:
    """A file of the reference material that lies beside the checkout; the test skips where it is absent."""
    path = Path(__file__).resolve().parents[1] / ".." / "shared" / "data" / Path(*parts)
    if not path.is_file():
        pytest.skip(f"no reference material beside the checkout: {'/'.join(parts)}")
    return path


def pixel_delays(radar: Radar, array: AntennaArray, range_m: float) -> Real:
    """[C, U] round trip [s] from each element pair to the pixels (range, u) in the plane z = 0, eq. (2)."""
    u = radar.grid.u
    pixel = np.stack([range_m * np.sqrt(1.0 - u**2), range_m * u, np.zeros_like(u)], axis=-1)  # (U, 3)
    tx_leg = np.linalg.norm(array.tx[:, None] - pixel, axis=-1)
    rx_leg = np.linalg.norm(array.rx[:, None] - pixel, axis=-1)
    return (tx_leg[array.channel_tx] + rx_leg[array.channel_rx]) / LIGHT_MPS


def matched_filter_row(fast_time: Complex, radar: Radar, array: AntennaArray, row: int) -> Complex:
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


def scattered_delays(paths: ScatteredPaths, tx: Real, rx: Real, time_s: float) -> Real:
    """[K] c tau = |x_i - (p + v_p t)| + b + b' t + |x_j - (q + v_q t)|, divided by c [s]."""
    tx_leg = np.linalg.norm(paths.tx_point + paths.tx_velocity * time_s - tx, axis=1)
    rx_leg = np.linalg.norm(paths.rx_point + paths.rx_velocity * time_s - rx, axis=1)
    return (tx_leg + paths.between_m + paths.between_rate_mps * time_s + rx_leg) / LIGHT_MPS


def specular_delays(paths: SpecularPaths, tx: Real, rx: Real, time_s: float) -> Real:
    """[S] c tau = |x_j - (s + v_s t + H x_i)|, divided by c [s]."""
    image = paths.image + paths.image_velocity * time_s + paths.axes @ tx
    return np.linalg.norm(image - rx, axis=1) / LIGHT_MPS


def delays(paths: PathTable, tx: Real, rx: Real, time_s: float) -> Real:
    """[K] of both kinds of paths [s]."""
    return np.concatenate(
        [scattered_delays(paths.scattered, tx, rx, time_s), specular_delays(paths.specular, tx, rx, time_s)]
    )


def path_length(path: ScatteredPaths | SpecularPaths, tx: Real, rx: Real, time_s: float = 0.0) -> float:
    """Of the first path [m], by the table's own laws."""
    if isinstance(path, ScatteredPaths):
        return float(scattered_delays(path, tx, rx, time_s)[0]) * LIGHT_MPS
    return float(specular_delays(path, tx, rx, time_s)[0]) * LIGHT_MPS


def if_chirp(paths: PathTable, radar: Radar, array: AntennaArray, channel: tuple[int, int], chirp: int) -> Complex:
    """[samples] the float64 sum of eq. (1) over all paths of a table, for one (TX, RX) and one chirp."""
    waveform = radar.waveform
    slope = waveform.bandwidth_hz / waveform.chirp_duration_s
    fast_time = np.arange(waveform.samples) * waveform.chirp_duration_s / waveform.samples
    tx, rx = np.array(array.tx_m[channel[0]]), np.array(array.rx_m[channel[1]])
    turn = channel[0] * waveform.chirp_interval_s / len(array.tx_m) if waveform.multiplexing == "tdm" else 0.0
    time_s = chirp * waveform.chirp_interval_s + turn
    tau = delays(paths, tx, rx, time_s)
    cycles = waveform.carrier_hz * tau + slope * fast_time[:, None] * tau
    if waveform.residual_video_phase:
        cycles = cycles - 0.5 * slope * tau**2
    amplitude = np.concatenate([paths.scattered.amplitude, paths.specular.amplitude])
    return np.exp(2j * np.pi * (cycles % 1.0)) @ amplitude


def if_cube(paths: PathTable, radar: Radar, array: AntennaArray | None = None) -> Complex:
    """[chirps, samples, channels] the float64 sum of eq. (1) over all paths of a table, for every TX, RX and chirp."""
    array, waveform = array or radar.array, radar.waveform
    tx_count = len(array.tx_m)
    cube = np.zeros((waveform.chirps, waveform.samples, tx_count * len(array.rx_m)), dtype=np.complex128)
    for i in range(tx_count):
        for j in range(len(array.rx_m)):
            for m in range(waveform.chirps):
                cube[m, :, tx_count * j + i] = if_chirp(paths, radar, array, (i, j), m)
    return cube


def doppler_filtered(cube: Complex, radar: Radar, cell: int) -> Complex:
    """[samples, channels] one cell of the Hann-windowed Doppler filter bank, by its definition."""
    chirps = radar.waveform.chirps
    m = np.arange(chirps)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * m / chirps) if chirps > 1 else np.ones(1)
    filter_ = window / window.sum() * np.exp(-2j * np.pi * (cell - chirps // 2) * m / chirps)
    return np.einsum("m,mnc->nc", filter_, cube)


def truth_rows(paths: PathTable, radar: Radar, cells: NDArray[np.int64], rows: Sequence[int]) -> Complex:
    """[rows, U] truth image rows: full virtual cube, each row's own Doppler filter, exact matched filter."""
    cube = if_cube(paths, radar, radar.virtual_sensor)
    return np.stack(
        [matched_filter_row(doppler_filtered(cube, radar, int(cells[r])), radar, radar.virtual_sensor, r) for r in rows]
    )


def mirrored(point: Real, plane: tuple[Real, Real]) -> Real:
    """[..., 3] mirror image of points in the plane (point on it, unit normal)."""
    origin, normal = plane
    return point - 2.0 * ((point - origin) @ normal)[..., None] * normal


def mirror_path(tx: Real, rx: Real, planes: Sequence[tuple[Real, Real]]) -> tuple[float, Real]:
    """Length [m] and vertices [depth, 3] of the path TX - plane 1 - ... - plane n - RX, by the method of images.

    The TX is mirrored in plane 1, its image in plane 2, ...; then the path is walked back from the RX.
    """
    images = [tx]
    for plane in planes:
        images.append(mirrored(images[-1], plane))
    length = float(np.linalg.norm(rx - images[-1]))
    vertices, end = [], rx
    for (origin, normal), image in zip(reversed(planes), reversed(images[1:]), strict=True):
        along = image - end
        end = end + along * float((origin - end) @ normal) / float(along @ normal)
        vertices.append(end)
    return length, np.array(vertices[::-1])


def strip(extent: float, count: int) -> np.ndarray:
    """Midpoints of ``count`` cells of [-extent / 2, extent / 2]."""
    return extent * ((np.arange(count) + 0.5) / count - 0.5)


def corner_area(walls: np.ndarray, inside, direction: np.ndarray, extent: float, count: int = 1000) -> float:
    """Area [m^2] of a beam along -``direction`` whose rays meet every wall of a corner and leave where they came from.

    :param walls: [N, 3] normals of the planes through the origin; :param inside: (wall, points) -> mask
    """
    across = np.cross(direction, [0.3, -0.5, 0.8])
    across /= np.linalg.norm(across)
    up = np.cross(direction, across)
    grid = strip(2.0 * extent, count)
    rays = (grid[:, None, None] * across + grid[None, :, None] * up).reshape(-1, 3) + 10.0 * direction
    heading = np.tile(-direction, (len(rays), 1))
    alive, met = np.ones(len(rays), dtype=bool), np.zeros((len(rays), len(walls)), dtype=bool)
    for _ in range(len(walls)):
        nearest, which = np.full(len(rays), np.inf), np.full(len(rays), -1)
        for index, normal in enumerate(walls):
            speed = heading @ normal
            distance = np.where(speed < -1e-12, -(rays @ normal) / np.where(speed < -1e-12, speed, 1.0), np.inf)
            points = rays + np.where(np.isfinite(distance), distance, 0.0)[:, None] * heading
            hit = np.isfinite(distance) & (distance > 1e-9) & (distance < nearest) & inside(index, points)
            nearest, which = np.where(hit, distance, nearest), np.where(hit, index, which)
        alive &= which >= 0
        wall = walls[np.maximum(which, 0)]
        rays = rays + np.where(alive, nearest, 0.0)[:, None] * heading
        heading = heading - 2.0 * np.einsum("ri,ri->r", heading, wall)[:, None] * wall
        met[np.arange(len(rays)), np.maximum(which, 0)] |= alive
    return float(np.sum(alive & met.all(axis=1))) * (2.0 * extent / count) ** 2


def relative_error(value: NDArray, reference: NDArray) -> float:
    """Relative L2 error."""
    return float(np.linalg.norm(value - reference) / np.linalg.norm(reference))


def peak_error_db(value: NDArray, reference: NDArray) -> float:
    """Largest difference relative to the reference's peak magnitude [dB]."""
    return float(20.0 * np.log10(np.abs(value - reference).max() / np.abs(reference).max()))


def interpolated_peak(magnitude: Real) -> float:
    """Index of the maximum of a sampled curve, refined by the parabola through the logarithms of three samples."""
    top = int(np.argmax(magnitude))
    if top in (0, len(magnitude) - 1):
        return float(top)
    left, middle, right = np.log(magnitude[top - 1 : top + 2])
    return top + 0.5 * float(left - right) / float(left - 2.0 * middle + right)


def receiver_noise(radar: Radar, generator: np.random.Generator) -> NDArray[np.complex64]:
    """[chirps, samples, channels] circular white Gaussian noise of k T0 F f_s [W] a sample."""
    shape = (radar.waveform.chirps, radar.waveform.samples, radar.array.channels)
    deviation = np.float32(np.sqrt(radar.sample_noise_power_w / 2.0))
    noise = generator.standard_normal((*shape, 2), dtype=np.float32)
    noise *= deviation
    return noise.view(np.complex64)[..., 0]
