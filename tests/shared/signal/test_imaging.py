"""Images: where targets peak and at which level; the fast matched filter against the exact one; resolution."""

import os
import subprocess
import sys

import numpy as np
import pytest
from numpy.typing import NDArray
from oracles import interpolated_peak, matched_filter_row, reference_file

from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.cube import cube_of_paths
from datafactory.synthesis.truth import truth_moments
from shared.radar import ImageGrid, Radar
from shared.radar.arrays import AVR_QDM_110_THINNED_RX, AntennaArray, line
from shared.radar.waveform import Waveform
from shared.signal.imaging import PRODUCT_FRAMES, delay_and_sum, near_field_images, steering_matrix, sweep_moments
from shared.signal.spectrum import DopplerSelection, range_doppler, select_doppler

COUNT = 24
TARGET_ROWS = np.linspace(20.0, 620.0, COUNT)
"""From 3 m on, 26 bins apart: Hann skirts of the neighbours lie below -90 dB."""


@pytest.fixture(scope="module")
def targets() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions [K, 3] and velocities [K, 3] of targets of equal strength, anywhere in u and in velocity."""
    generator = np.random.default_rng(31)
    radar = Radar()
    u = generator.uniform(-0.82, 0.82, COUNT)
    range_m = (TARGET_ROWS + generator.uniform(-0.5, 0.5, COUNT)) * radar.waveform.range_step_m
    return range_m[:, None] * np.stack([np.sqrt(1.0 - u**2), u, np.zeros(COUNT)], axis=1), generator.uniform(
        -9.0, 9.0, (COUNT, 3)
    ) * [1.0, 0.5, 0.0]


@pytest.fixture(scope="module")
def seen(targets) -> tuple[PathTable, DopplerSelection]:
    """The targets through the default radar: one cube, one Doppler choice."""
    radar = Radar()
    table = PathTable(ScatteredPaths.of_points(targets[0], targets[1], np.ones(COUNT)))
    return table, select_doppler(range_doppler(cube_of_paths(table, radar).astype(np.complex64), radar), 1e-9)


def mid_frame(targets, radar: Radar) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Range [K] m, u [K] and range rate [K] m/s at mid-frame, from the origin."""
    position, velocity = targets
    position = position + velocity * radar.waveform.mid_frame_s
    range_m = np.linalg.norm(position, axis=1)
    return range_m, position[:, 1] / range_m, np.einsum("ki,ki->k", position, velocity) / range_m


def assert_registered(image: NDArray[np.complex64], targets, radar: Radar) -> None:
    """Every target peaks within half a bin in range and in u."""
    range_m, u, _ = mid_frame(targets, radar)
    rows, columns = range_m / radar.waveform.range_step_m, (u - radar.grid.u_start) / radar.grid.step
    magnitude = np.abs(image)
    for row, column in zip(rows, columns, strict=True):
        first = round(row) - 3
        patch = magnitude[first : first + 7]
        top, peak = np.unravel_index(patch.argmax(), patch.shape)
        assert abs(interpolated_peak(patch[top]) - column) < 0.5
        assert abs(first + interpolated_peak(patch[:, peak]) - row) < 0.5


@pytest.mark.parametrize("array", AVR_QDM_110_THINNED_RX)
def test_targets_peak_where_they_are_in_delay_and_sum(array, seen, targets):
    radar = Radar()
    image = delay_and_sum(seen[1].range_channel[0], radar, radar.array.channel_indices(AVR_QDM_110_THINNED_RX[array]))
    assert_registered(image, targets, radar)


def test_targets_peak_where_they_are_in_the_truth(seen, targets):
    radar = Radar()
    moments = truth_moments(seen[0], radar, seen[1].cells[0])
    assert_registered(near_field_images(moments[None], radar, radar.virtual_sensor)[0], targets, radar)


def test_targets_peak_at_their_velocity(seen, targets):
    radar = Radar()
    range_m, _, rate = mid_frame(targets, radar)
    for row, velocity in zip(np.rint(range_m / radar.waveform.range_step_m).astype(int), rate, strict=True):
        cell = interpolated_peak(seen[1].magnitude[row])
        assert abs(cell - radar.waveform.chirps // 2 - velocity / radar.waveform.velocity_step_mps) < 0.5


def test_steering_is_the_far_field_of_equation_2():
    # Delays of a point 1e5 m away against plane waves, at mid-sweep; a common phase is free.
    radar = Radar(grid=ImageGrid(bins=9))
    u, array = radar.grid.u, radar.array
    point = 1e5 * np.stack([np.sqrt(1.0 - u**2), u, np.zeros_like(u)], axis=1)
    tx, rx = (
        np.linalg.norm(point - e[:, None], axis=2) for e in (array.tx[array.channel_tx], array.rx[array.channel_rx])
    )
    echo = np.exp(2j * np.pi * ((tx + rx - 2e5) / radar.waveform.wavelength_m))
    response = np.abs((steering_matrix(radar, array) * echo).mean(axis=0))
    np.testing.assert_allclose(response, 1.0, atol=1e-6)


@pytest.mark.parametrize("range_m", [3.0, 5.7, 20.0, 60.0])
def test_fast_images_agree_with_the_exact_matched_filter(range_m):
    # Echoes of unit amplitude, so that errors are relative to the peak. Measured: -47 dB with 3 terms, -83 dB with 5.
    step = Waveform().range_step_m
    centre = round(range_m / step)
    samples = 1 << int(np.ceil(np.log2(centre + 20)))
    radar = Radar(waveform=Waveform(samples=samples, range_bins=centre + 6, chirps=1), grid=ImageGrid(bins=20))
    generator = np.random.default_rng(3)
    u = radar.grid.u[[1, 5, 10, 19]] + generator.uniform(-0.003, 0.003, 4)
    reach = range_m + step * generator.uniform(-1.5, 1.5, 4)
    points = reach[:, None] * np.stack([np.sqrt(1.0 - u**2), u, np.zeros(4)], axis=1)
    table = PathTable(ScatteredPaths.of_points(points, np.zeros((4, 3)), np.ones(4)))
    fast_time = cube_of_paths(table, radar, array=radar.virtual_sensor)[0]
    rows = range(centre - 5, centre + 6, 3)
    exact = np.stack([matched_filter_row(fast_time, radar, radar.virtual_sensor, row) for row in rows])
    for terms, bound_db in ((3, -45.0), (5, -80.0)):
        moments = sweep_moments(fast_time, radar, terms)[None].astype(np.complex64)
        image = near_field_images(moments, radar, radar.virtual_sensor)[0]
        assert 20.0 * np.log10(np.abs(image[list(rows)] - exact).max()) < bound_db


@pytest.mark.parametrize("elements", [256, 255])
def test_a_frame_has_the_same_bytes_in_every_batch(elements):
    # 255 elements have a middle one: the way without symmetry.
    radar = Radar(waveform=Waveform(samples=32, range_bins=20, chirps=1), grid=ImageGrid(bins=20))
    array = AntennaArray(tx_m=radar.virtual_sensor.tx_m, rx_m=radar.virtual_sensor.rx_m[:elements])
    generator = np.random.default_rng(4)
    shape = PRODUCT_FRAMES + 3, 3, 20, elements
    frames = (generator.normal(size=shape) + 1j * generator.normal(size=shape)).astype(np.complex64)
    whole = near_field_images(frames, radar, array)
    for count in (1, 2, 7, PRODUCT_FRAMES, PRODUCT_FRAMES + 1):
        assert near_field_images(frames[:count], radar, array).tobytes() == whole[:count].tobytes()
    turned = near_field_images(frames[::-1], radar, array)
    assert turned[::-1].tobytes() == whole.tobytes()


@pytest.mark.parametrize("kernels", ["Haswell", "Sandybridge"])
def test_a_frame_has_the_same_bytes_in_every_batch_by_the_kernels_of_other_processors(kernels):
    """OpenBLAS has kernels for each; those for Haswell, which Zen has too, treat rows of a large product unalike."""
    test = f"{__file__}::test_a_frame_has_the_same_bytes_in_every_batch[256]"
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", test]
    done = subprocess.run(command, env={**os.environ, "OPENBLAS_CORETYPE": kernels}, capture_output=True, check=False)
    assert done.returncode == 0, done.stdout.decode()


def test_images_are_the_same_with_and_without_the_use_of_symmetry():
    # A silent 257th element makes the array lopsided.
    radar = Radar(waveform=Waveform(samples=64, range_bins=40, chirps=1), grid=ImageGrid(bins=30))
    sensor = radar.virtual_sensor
    wider = AntennaArray(tx_m=sensor.tx_m, rx_m=(*sensor.rx_m, (0.0, 0.26, 0.0)))
    generator = np.random.default_rng(5)
    moments = np.zeros((2, 3, 40, 257), dtype=np.complex64)
    moments[..., :256] = generator.normal(size=(2, 3, 40, 256)) + 1j * generator.normal(size=(2, 3, 40, 256))
    folded = near_field_images(moments[..., :256], radar, sensor)
    whole = near_field_images(moments, radar, wider) * (257 / 256)
    assert np.abs(whole - folded).max() < 1e-5 * np.abs(folded).max()


@pytest.mark.parametrize("elements", [86, 48])
def test_measured_reflectors_peak_where_they_stand(elements):
    # One snapshot of a half-wavelength array, corner reflectors at 15 m near 0 and 7 deg. It holds the phases of the
    # received wave; ours are those of the IF signal, conjugated by the mixer.
    from scipy.io import loadmat

    snapshot = loadmat(reference_file("measured", "two_reflectors", "realData_demo.mat"))["bv_final"][
        0, :elements
    ].conj()
    radar = Radar(grid=ImageGrid(u_start=-0.3, u_stop=0.3, bins=1200))
    spacing = radar.waveform.wavelength_m / 2.0
    array = AntennaArray(tx_m=((0.0, 0.0, 0.0),), rx_m=line(spacing * np.arange(elements)))
    image = np.abs(snapshot @ steering_matrix(radar, array))
    peaks = 1 + np.flatnonzero((image[1:-1] > image[:-2]) & (image[1:-1] >= image[2:]))
    found = np.sort(np.degrees(np.arcsin(radar.grid.u[peaks[np.argsort(-image[peaks])[:2]]])))
    np.testing.assert_allclose(found, [-0.006, 6.985], atol=0.15)


def test_a_grid_has_mirror_images_where_its_bins_meet_them() -> None:
    assert ImageGrid().mirror == 450
    np.testing.assert_allclose(ImageGrid().u[1:], -ImageGrid().u[:0:-1])
    assert ImageGrid(u_start=-0.5, u_stop=0.5, bins=20).mirror == 20
    assert ImageGrid(u_start=-0.5, u_stop=0.5 - 1e-12, bins=20).mirror == 20
    assert ImageGrid(u_start=-0.5, u_stop=0.6, bins=20).mirror is None
    assert ImageGrid(u_start=-0.5, u_stop=0.5001, bins=20).mirror is None
