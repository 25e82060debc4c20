"""Motion within the chirp, beyond eq. (1), against sums that evaluate every sample's own delay."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from oracles import doppler_filtered, relative_error, scattered_delays

from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.cube import cube_of_paths
from datafactory.synthesis.truth import truth_moments
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar
from shared.radar.waveform import Waveform
from shared.signal.imaging import near_field_images, sweep_moments
from shared.signal.spectrum import range_doppler

RADAR = Radar(waveform=Waveform(samples=256, range_bins=160, chirps=32))


def moving_points(speed_mps: float, count: int = 12, nearest_m: float = 4.0, seed: int = 1) -> PathTable:
    generator = np.random.default_rng(seed)
    azimuth, distance = generator.uniform(-0.9, 0.9, count), generator.uniform(nearest_m, 22.0, count)
    position = np.stack(
        [distance * np.cos(azimuth), distance * np.sin(azimuth), generator.uniform(-0.5, 0.5, count)], 1
    )
    velocity = generator.uniform(-speed_mps, speed_mps, (count, 3))
    return PathTable(ScatteredPaths.of_points(position, velocity, np.exp(2j * np.pi * generator.random(count))))


def by_definition(paths: PathTable, radar: Radar, cycles) -> NDArray[np.complex128]:
    """[chirps, samples, channels] sum of exp(j 2 pi cycles(tau, t, s)), tau a function of time."""
    waveform, array = radar.waveform, radar.array
    fast = np.arange(waveform.samples) * waveform.chirp_duration_s / waveform.samples
    cube = np.zeros((waveform.chirps, waveform.samples, array.channels), dtype=np.complex128)
    for channel, (tx, rx) in enumerate(zip(array.tx[array.channel_tx], array.rx[array.channel_rx], strict=True)):
        for chirp in range(waveform.chirps):
            start = chirp * waveform.chirp_interval_s

            def tau(time, tx=tx, rx=rx):
                return scattered_delays(paths.scattered, tx, rx, time)

            phase = np.stack([np.broadcast_to(cycles(tau, start, s), len(paths)) for s in fast])
            cube[chirp, :, channel] = np.exp(2j * np.pi * (phase % 1.0)) @ paths.scattered.amplitude
    return cube


@pytest.fixture
def few_channels() -> Radar:
    array = RADAR.array.model_copy(update={"rx_m": RADAR.array.rx_m[::8], "tx_m": RADAR.array.tx_m[:2]})
    return RADAR.model_copy(update={"array": array, "waveform": Waveform(samples=64, range_bins=40, chirps=4)})


@pytest.mark.parametrize("speed_mps", [3.0, 30.0])
def test_motion_within_the_chirp_is_that_of_every_sample(few_channels, speed_mps):
    waveform = few_channels.waveform

    def cycles(tau, start, fast):
        return (waveform.carrier_hz + waveform.slope_hz_per_s * fast) * tau(start + fast)

    paths = moving_points(speed_mps)
    exact = by_definition(paths, few_channels, cycles)
    ours = cube_of_paths(paths, few_channels, 1e-9, intra_chirp=True)
    # The term left out, 2 pi mu tau' (T_c / 2)^2 with tau' up to 2 sqrt(3) v / c, and its mean over the sweep.
    rate = 2.0 * np.sqrt(3.0) * speed_mps / SPEED_OF_LIGHT
    bound = 2.0 * np.pi * waveform.slope_hz_per_s * rate * (waveform.chirp_duration_s / 2.0) ** 2
    assert relative_error(ours, exact) < bound
    assert relative_error(cube_of_paths(paths, few_channels, 1e-9), exact) > 20.0 * bound
    # A scene at rest has none.
    still = moving_points(0.0)
    usual = cube_of_paths(still, few_channels)
    assert relative_error(cube_of_paths(still, few_channels, intra_chirp=True), usual) < 2e-6


@pytest.mark.parametrize("intra_chirp", [False, True])
def test_the_truth_follows_the_cube(intra_chirp):
    paths = moving_points(8.0, count=20)
    cube = cube_of_paths(paths, RADAR, 1e-9, intra_chirp=intra_chirp).astype(np.complex64)
    spectra = np.abs(range_doppler(cube, RADAR)).mean(axis=-1)
    cells = np.argmax(spectra, axis=1)
    ours = near_field_images(
        truth_moments(paths, RADAR, cells, intra_chirp=intra_chirp)[None], RADAR, RADAR.virtual_sensor
    )[0]
    whole = cube_of_paths(paths, RADAR, 1e-9, array=RADAR.virtual_sensor, intra_chirp=intra_chirp)
    # Each row from the virtual sensor's own cube, filtered in its Doppler cell.
    expected = np.zeros_like(ours)
    for cell in np.unique(cells):
        moments = sweep_moments(doppler_filtered(whole, RADAR, int(cell)), RADAR, 5).astype(np.complex64)
        image = near_field_images(moments[None], RADAR, RADAR.virtual_sensor)[0]
        rows = cells == cell
        expected[rows] = image[rows]
    assert np.abs(np.abs(ours) - np.abs(expected)).max() < 10 ** (-45 / 20) * np.abs(expected).max()
