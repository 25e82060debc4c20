"""Random targets through the whole method after tracing: what holds of every frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hardcases.tools import frame_of, not_finite, small_radar
from hypothesis import given, settings
from hypothesis import strategies as st

from datafactory.paths.table import PathTable, ScatteredPaths
from shared.radar import Radar
from shared.radar.arrays import AntennaArray, line
from shared.signal.imaging import delay_and_sum

RADAR = small_radar(samples=48, chirps=4)

tables = st.builds(
    lambda count, seed: _table(count, np.random.default_rng(seed)), st.integers(0, 6), st.integers(0, 2**32 - 1)
)


def _table(count: int, generator: np.random.Generator) -> PathTable:
    """Moving targets in front of the radar, over four decades of amplitude."""
    u, range_m = generator.uniform(-0.9, 0.9, count), generator.uniform(0.5, 6.5, count)
    place = range_m[:, None] * np.stack([np.sqrt(1.0 - u**2), u, generator.uniform(-0.1, 0.1, count)], axis=1)
    amplitude = 10.0 ** generator.uniform(-4.0, 0.0, count) * np.exp(2j * np.pi * generator.uniform(size=count))
    return PathTable(ScatteredPaths.of_points(place, generator.uniform(-5.0, 5.0, (count, 3)), amplitude))


@settings(max_examples=12)
@given(tables, st.booleans())
def test_a_frame_is_finite_normalised_and_repeatable(paths: PathTable, noise: bool) -> None:
    frame = frame_of(paths, RADAR, noise)
    assert not_finite(frame) == 0
    assert frame.image.min() >= 0.0
    assert frame.image.max() == (1.0 if len(paths) else 0.0)
    again = frame_of(paths, RADAR, noise)
    assert again.image.tobytes() == frame.image.tobytes()
    assert again.range_channel.tobytes() == frame.range_channel.tobytes()
    assert again.targets == frame.targets


@settings(max_examples=12)
@given(tables, st.integers(-40, 40))
def test_a_stronger_frame_is_the_same_frame(paths: PathTable, power: int) -> None:
    scale = 2.0**power
    louder = replace(paths, scattered=replace(paths.scattered, amplitude=paths.scattered.amplitude * scale))
    frame, other = frame_of(paths, RADAR, noise=False), frame_of(louder, RADAR, noise=False)
    np.testing.assert_array_equal(other.image, frame.image)
    np.testing.assert_array_equal(other.velocity, frame.velocity)
    np.testing.assert_array_equal(other.range_channel, frame.range_channel * np.float32(scale))
    assert other.image_peak == frame.image_peak * scale


@settings(max_examples=30)
@given(
    st.lists(st.floats(-0.5, 0.5, width=32), min_size=1, max_size=8, unique=True),
    st.integers(0, RADAR.grid.bins - 1),
    st.floats(-np.pi, np.pi),
)
def test_delay_and_sum_reads_the_amplitude_where_the_wave_comes_from(
    positions: list[float], column: int, phase: float
) -> None:
    """A plane wave from a direction on the grid: its own value there, and nowhere more."""
    array = AntennaArray(tx_m=line(np.zeros(1)), rx_m=line(np.array(positions)))
    radar = Radar(waveform=RADAR.waveform, array=array, grid=RADAR.grid)
    wavenumber = 2.0 * np.pi / radar.waveform.wavelength_m
    wave = np.exp(1j * (phase - wavenumber * radar.grid.u[column] * array.virtual[:, 1]))
    image = delay_and_sum(wave.astype(np.complex64)[None], radar)[0]
    assert abs(image[column] - np.exp(1j * phase)) < 1e-5
    assert np.abs(image).max() < 1.0 + 1e-5
