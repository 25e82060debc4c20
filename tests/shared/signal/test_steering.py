"""One manifold: its sign is that of an echo, and everyone's weights are its conjugate."""

from __future__ import annotations

import numpy as np

from shared.radar import ImageGrid, Radar
from shared.signal import if_signal
from shared.signal.adaptive import adaptive_tables
from shared.signal.imaging import steering_matrix
from shared.signal.spectrum import range_doppler
from shared.signal.steering import manifold

RADAR = Radar()
POSITIONS = RADAR.array.virtual[:, 1]


def test_the_manifold_is_the_echo_of_a_far_target() -> None:
    waveform = RADAR.waveform.model_copy(update={"chirps": 1, "samples": 128, "range_bins": 128, "bandwidth_hz": 1e7})
    radar = RADAR.model_copy(update={"waveform": waveform})
    row, u = 50, 0.3
    range_m = row * waveform.range_step_m
    position = range_m * np.array([[np.sqrt(1.0 - u**2), u, 0.0]])
    cube = if_signal(radar, position, np.zeros((1, 3)), np.ones(1, dtype=np.complex128))
    echo = range_doppler(cube.astype(np.complex64), radar)[row, 0]
    expected = manifold(POSITIONS, waveform.wavelength_m, np.array(u))
    assert abs(np.vdot(expected, echo)) / len(echo) > 0.999
    # The other sign is the echo of a target on the other side.
    assert abs(np.vdot(expected.conj(), echo)) / len(echo) < 0.3


def test_images_and_the_adaptive_spectrum_look_for_its_conjugate() -> None:
    wavelength, u = RADAR.waveform.wavelength_m, RADAR.grid.u
    expected = manifold(POSITIONS, wavelength, u).conj()
    np.testing.assert_array_equal(steering_matrix(RADAR, RADAR.array), expected)
    channels = np.arange(48)
    # The adaptive spectrum's phases are those in the middle of the array.
    expected = manifold(POSITIONS - POSITIONS.mean(), wavelength, u).conj()
    np.testing.assert_array_equal(adaptive_tables(RADAR, channels).matched[:, : len(u)], expected.astype(np.complex64))


def test_a_grid_has_mirror_images_where_its_bins_meet_them() -> None:
    assert ImageGrid().mirror == 450
    np.testing.assert_allclose(ImageGrid().u[1:], -ImageGrid().u[:0:-1])
    assert ImageGrid(u_start=-0.5, u_stop=0.5, bins=20).mirror == 20
    assert ImageGrid(u_start=-0.5, u_stop=0.5 - 1e-12, bins=20).mirror == 20
    assert ImageGrid(u_start=-0.5, u_stop=0.6, bins=20).mirror is None
    assert ImageGrid(u_start=-0.5, u_stop=0.5001, bins=20).mirror is None
