"""Cells that are listed as targets: an echo once, however strong it is, and none of its sidelobes."""

from dataclasses import replace

import numpy as np
import pytest

from datafactory.frame.truth_cells import MARGIN, detected_cells, listed_cells, response_of
from shared.dataset import Frame, Target
from shared.physics.units import amplitude_to_db
from shared.radar import Radar
from shared.signal.windows import angle_window, hann_response

RADAR = Radar()
WINDOW = "taylor-30"
NOISE = 1e-6
ROWS, COLUMNS = RADAR.waveform.range_bins, RADAR.grid.bins


def image_of(*echoes: tuple[float, float, complex]) -> np.ndarray:
    """[R, U] of points: range bin, angle bin and amplitude of each."""
    sensor = RADAR.virtual_sensor
    weights, y = angle_window(WINDOW, sensor.channels), sensor.virtual[:, 1] / RADAR.waveform.wavelength_m
    field = np.zeros((ROWS, COLUMNS), dtype=complex)
    for row, column, amplitude in echoes:
        away = RADAR.grid.step * (np.arange(COLUMNS) - column)
        over_u = np.exp(-2j * np.pi * away[:, None] * y) @ weights / weights.sum()
        field += amplitude * hann_response(np.arange(ROWS) - row)[:, None] * over_u
    return np.abs(field).astype(np.float32)


def a_frame(*targets: Target) -> Frame:
    frame = Frame(0, "scene", "s", 0, targets=targets)
    return replace(frame, velocity=np.zeros((1, ROWS), np.float32), noise_power=NOISE)


def listed(image: np.ndarray, *targets: Target) -> list[tuple[int, int]]:
    found = listed_cells(image, a_frame(*targets), RADAR, WINDOW)
    place = ((t.range_m / RADAR.waveform.range_step_m, (t.u - RADAR.grid.u_start) / RADAR.grid.step) for t in found)
    return [(round(row), round(column)) for row, column in place]


def target(row: float, column: float, amplitude: float, velocity: float = 0.0) -> Target:
    u = RADAR.grid.u_start + column * RADAR.grid.step
    return Target(row * RADAR.waveform.range_step_m, u, velocity, float(amplitude_to_db(amplitude)), "it")


@pytest.mark.parametrize("off", [(0.0, 0.0), (0.49, 0.3), (-0.4, 0.49), (0.25, -0.49)])
def test_a_strong_echo_is_listed_once(off: tuple[float, float]) -> None:
    """60 dB above the noise: dozens of sidelobes are above it as well."""
    image = image_of((100 + off[0], 150 + off[1], 1.0))
    assert len(detected_cells(image, NOISE).row) > 20
    ((row, column),) = listed(image)
    assert abs(row - 100 - off[0]) <= 0.51
    assert abs(column - 150 - off[1]) <= 0.51


@pytest.mark.parametrize("place", [(100, 162), (101, 250), (103, 150), (108, 150), (110, 300)])
@pytest.mark.parametrize("phase", [0.0, 2.1, 4.2])
def test_a_weak_echo_beside_a_strong_one_is_listed(place: tuple[int, int], phase: float) -> None:
    """20 dB weaker, or as much as 10 dB above the envelope of sidelobes there."""
    response = response_of(RADAR, WINDOW)
    far, aside = abs(place[0] - 100), abs(place[1] - 150)
    envelope = (response.over_range[far] if far < len(response.over_range) else 0.0) * response.over_u[aside]
    weak = 0.1 if far <= 1 and aside <= response.lobe else max(3.2 * envelope, 0.005)
    image = image_of((100, 150, 1.0), (*place, weak * np.exp(1j * phase)))
    strong, found = sorted(listed(image), key=lambda cell: cell != (100, 150))
    assert strong == (100, 150)
    assert found[0] == place[0]
    assert abs(found[1] - place[1]) <= 1  # sidelobes move it


def test_envelopes_hold_everywhere() -> None:
    """No cell of a point's image, wherever in its bins it stands, is above the product of the envelopes."""
    response = response_of(RADAR, WINDOW)
    for off in np.linspace(-0.5, 0.5, 7):
        image = image_of((100 + off, 200 + off, 1.0))
        rows, columns = np.nonzero(image > NOISE)
        far, aside = np.abs(rows - 100), np.abs(columns - 200)
        beyond = (far > 1) | (aside > response.lobe)
        inside = far < len(response.over_range)
        lobe = np.where(far == 2, 0.18, 0.0)  # the skirt of the main lobe, where no maximum stands
        bound = np.maximum(response.over_range[np.minimum(far, len(response.over_range) - 1)], lobe)
        # Half a bin off its place: the next angle bin's envelope.
        bound = bound * response.over_u[np.maximum(aside - 1, 0)]
        checked = beyond & inside
        assert (image[rows, columns][checked] <= np.sqrt(MARGIN) * bound[checked]).all()


def test_a_target_s_own_cell_is_left_to_it() -> None:
    image = image_of((100, 150, 1.0), (200, 90, 0.1))
    assert listed(image, target(100.3, 150.4, 1.0)) == [(200, 90)]
    # Elsewhere, of another velocity, or much weaker, it is another echo that shows there.
    for other in (target(104.0, 150.0, 1.0), target(100.0, 165.0, 1.0), target(100.0, 150.0, 1.0, velocity=3.0)):
        assert (100, 150) in listed(image, other)
    assert (100, 150) in listed(image, target(100.0, 150.0, 0.3))


def test_several_echoes_of_one_target_own_their_cell_together() -> None:
    image = image_of((100, 150, 1.0))
    assert listed(image, target(100.0, 149.0, 0.5), target(100.4, 151.0, 0.5)) == []


def test_the_rule_spelt_out() -> None:
    """Every maximum of a crowded image against the sum over the stronger ones that stay."""
    generator, response = np.random.default_rng(2), response_of(RADAR, WINDOW)
    places = zip(generator.uniform(20, 60, 40), generator.uniform(0, COLUMNS, 40), strict=True)
    echoes = [(*place, 10.0 ** -generator.uniform(0.0, 2.5) * np.exp(1j * k)) for k, place in enumerate(places)]
    image = image_of(*echoes)
    expected: list[tuple[int, int, float]] = []
    for row, column, level in zip(*map(np.ndarray.tolist, detected_cells(image, NOISE)), strict=True):
        explained = 0.0
        for r, c, a in expected:
            far, aside = abs(row - r), abs(column - c)
            if far < len(response.over_range) and (far > 1 or aside > response.lobe):
                explained += (a * response.over_range[far] * response.over_u[aside]) ** 2
        if level**2 > MARGIN * explained:
            expected.append((row, column, level))
    assert 20 <= len(expected) <= 45
    assert sorted(listed(image)) == sorted((row, column) for row, column, _ in expected)


def test_a_frame_without_echoes_lists_none() -> None:
    assert listed(np.zeros((ROWS, COLUMNS), np.float32)) == []
    assert listed(np.full((ROWS, COLUMNS), 1e-9, np.float32), target(10, 10, 1.0)) == []
