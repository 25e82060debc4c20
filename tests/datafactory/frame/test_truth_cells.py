"""Cells that are listed as targets: an echo once, however strong it is, and none of its sidelobes."""

from dataclasses import replace

import numpy as np
import pytest

from datafactory.frame.measurement import MAXIMUM_TARGETS, Measurement, Processing, image
from datafactory.frame.truth_cells import MARGIN, detected_cells, listed_cells, response_of
from shared.dataset import Frame, Target
from shared.physics.units import amplitude_to_db
from shared.radar import ImageGrid, Radar
from shared.radar.waveform import Waveform
from shared.signal.imaging import walk_terms
from shared.signal.windows import angle_window, hann_response

RADAR = Radar()
WIDE = Radar(grid=ImageGrid(u_start=-1.0, u_stop=1.0))
WINDOW = "taylor-30"
AT_REST = Processing(truth_window=WINDOW)
NOISE = 1e-6
ROWS, COLUMNS = RADAR.waveform.range_bins, RADAR.grid.bins
STEP_MPS = RADAR.waveform.velocity_step_mps


def image_of(*echoes: tuple[float, float, complex], radar: Radar = RADAR) -> np.ndarray:
    """[R, U] of points: range bin, angle bin and amplitude of each."""
    sensor = radar.virtual_sensor
    weights, y = angle_window(WINDOW, sensor.channels), sensor.virtual[:, 1] / RADAR.waveform.wavelength_m
    field = np.zeros((ROWS, COLUMNS), dtype=complex)
    for row, column, amplitude in echoes:
        away = radar.grid.step * (np.arange(COLUMNS) - column)
        over_u = np.exp(-2j * np.pi * away[:, None] * y) @ weights / weights.sum()
        field += amplitude * hann_response(np.arange(ROWS) - row)[:, None] * over_u
    return np.abs(field).astype(np.float32)


def listed(
    image: np.ndarray,
    *targets: Target,
    radar: Radar = RADAR,
    how: Processing = AT_REST,
    velocity: np.ndarray | None = None,
) -> list[tuple[int, int]]:
    """Range and angle bins of the cells that are listed beside targets.

    :param velocity: [R] of the rows; 0 by default
    """
    of_rows = np.zeros((1, ROWS), np.float32) if velocity is None else velocity[None].astype(np.float32)
    frame = replace(Frame(0, "scene", "s", 0, targets=targets), velocity=of_rows, noise_power=NOISE)
    found = listed_cells(image, frame, radar, how)
    place = ((t.range_m / radar.waveform.range_step_m, (t.u - radar.grid.u_start) / radar.grid.step) for t in found)
    return [(round(row), round(column)) for row, column in place]


def target(row: float, column: float, amplitude: float, velocity: float = 0.0) -> Target:
    u = RADAR.grid.u_start + column * RADAR.grid.step
    return Target(row * RADAR.waveform.range_step_m, u, velocity, float(amplitude_to_db(amplitude)), "it")


@pytest.mark.parametrize("radar", [RADAR, WIDE])
@pytest.mark.parametrize("off", [(0.0, 0.0), (0.49, 0.3), (-0.4, 0.49), (0.25, -0.49)])
def test_a_strong_echo_is_listed_once(off: tuple[float, float], radar: Radar) -> None:
    """60 dB above the noise: dozens of sidelobes are above it as well."""
    image = image_of((100 + off[0], 150 + off[1], 1.0), radar=radar)
    assert len(detected_cells(image, NOISE, np.zeros(ROWS, np.int64)).row) > 20
    ((row, column),) = listed(image, radar=radar)
    assert abs(row - 100 - off[0]) <= 0.51
    assert abs(column - 150 - off[1]) <= 0.51


@pytest.mark.parametrize("place", [(100, 162), (101, 250), (103, 150), (108, 150), (110, 300)])
@pytest.mark.parametrize("phase", [0.0, 2.1, 4.2])
def test_a_weak_echo_beside_a_strong_one_is_listed(place: tuple[int, int], phase: float) -> None:
    """20 dB weaker, or as much as 10 dB above the envelope of sidelobes there."""
    response = response_of(RADAR, WINDOW)
    far, aside = abs(place[0] - 100), abs(place[1] - 150)
    envelope = (response.over_bins[far] if far < len(response.over_bins) else 0.0) * response.over_u[aside]
    weak = 0.1 if far <= 1 and aside <= response.lobe else max(3.2 * envelope, 0.005)
    image = image_of((100, 150, 1.0), (*place, weak * np.exp(1j * phase)))
    strong, found = sorted(listed(image), key=lambda cell: cell != (100, 150))
    assert strong == (100, 150)
    assert found[0] == place[0]
    assert abs(found[1] - place[1]) <= 1  # sidelobes move it


def test_echoes_of_one_range_are_listed_where_the_image_shows_everything() -> None:
    """A grating lobe repeats the main lobe at the other end of u; between them sidelobes are as low as elsewhere."""
    image = image_of((100, 150, 1.0), (100, 250, 0.56), (100, 350, 0.32), radar=WIDE)
    assert sorted(listed(image, radar=WIDE)) == [(100, 150), (100, 250), (100, 350)]
    end = image_of((100, 1, 1.0), radar=WIDE)
    assert end[100, -3:].max() > 0.5
    assert listed(end, radar=WIDE) == [(100, 1)]


@pytest.mark.parametrize("radar", [RADAR, WIDE])
def test_envelopes_hold_everywhere(radar: Radar) -> None:
    """No cell of a point's image, wherever in its bins it stands, is above the product of the envelopes."""
    response = response_of(radar, WINDOW)
    for off in np.linspace(-0.5, 0.5, 7):
        image = image_of((100 + off, 200 + off, 1.0), radar=radar)
        rows, columns = np.nonzero(image > NOISE)
        far, aside = np.abs(rows - 100), np.abs(columns - 200)
        beyond = (far > 1) | (aside > response.lobe)
        inside = far < len(response.over_bins)
        lobe = np.where(far == 2, 0.18, 0.0)  # the skirt of the main lobe, where no maximum stands
        bound = np.maximum(response.over_bins[np.minimum(far, len(response.over_bins) - 1)], lobe)
        bound = bound * response.over_u[aside]
        checked = beyond & inside
        assert (image[rows, columns][checked] <= np.sqrt(MARGIN) * bound[checked]).all()


def test_a_target_s_own_cell_is_left_to_it() -> None:
    image = image_of((100, 150, 1.0), (200, 90, 0.1))
    assert listed(image, target(100.3, 150.4, 1.0)) == [(200, 90)]
    # Elsewhere, of another velocity, or much weaker, it is another echo that shows there.
    for other in (target(104.0, 150.0, 1.0), target(100.0, 165.0, 1.0), target(100.0, 150.0, 1.0, velocity=3.0)):
        assert (100, 150) in listed(image, other)
    assert (100, 150) in listed(image, target(100.0, 150.0, 0.3))


@pytest.mark.parametrize("speed_mps", [-30.0, 30.0])
def test_a_fast_target_s_cell_is_where_its_doppler_moves_it(speed_mps: float) -> None:
    waveform = RADAR.waveform
    moved = 2.0 * speed_mps * waveform.chirp_duration_s / waveform.wavelength_m
    assert abs(moved) > 1.0
    image, velocity = image_of((100.4 + moved, 150, 1.0)), np.full(ROWS, speed_mps)
    within = replace(AT_REST, intra_chirp_motion=True)
    assert listed(image, target(100.4, 150, 1.0, speed_mps), how=within, velocity=velocity) == []


def test_without_doppler_a_target_that_moves_shows_itself_at_rest() -> None:
    still = replace(AT_REST, doppler=False)
    assert listed(image_of((100, 150, 1.0)), target(100, 150, 1.0, velocity=4.0), how=still) == []


def test_the_doppler_axis_is_a_circle() -> None:
    velocity = np.full(ROWS, -64 * STEP_MPS)  # of 128 cells the first; the last is next to it
    assert listed(image_of((100, 150, 1.0)), target(100, 150, 1.0, velocity=63 * STEP_MPS), velocity=velocity) == []


@pytest.mark.parametrize(("apart", "there"), [(0, []), (21, [(153, 150)])])
def test_another_doppler_cell_shows_no_sidelobe(apart: int, there: list[tuple[int, int]]) -> None:
    """28 dB below, three bins behind: of an echo that stands it is a sidelobe, of a mover it is none."""
    image = image_of((150, 150, 1.0)) * (np.arange(ROWS) < 152)[:, None] + image_of((153, 150, 0.04))
    velocity = np.where(np.arange(ROWS) < 152, apart * STEP_MPS, 0.0)
    assert listed(image, target(150, 150, 1.0, velocity=apart * STEP_MPS), velocity=velocity) == there


def test_several_echoes_of_one_target_own_their_cell_together() -> None:
    image = image_of((100, 150, 1.0))
    assert listed(image, target(100.0, 149.0, 0.5), target(100.4, 151.0, 0.5)) == []


def test_a_target_that_is_known_is_listed_before_the_strongest_cells() -> None:
    """Fewer are listed than the image has maxima, all of them stronger than the target."""
    radar = Radar(waveform=Waveform(range_bins=40))
    generator, terms = np.random.default_rng(5), walk_terms(radar, AT_REST.truth_terms)
    shape = (terms, 40, radar.virtual_sensor.channels, 2)
    moments = (generator.standard_normal(shape) @ np.array([1.0, 1.0j])).astype(np.complex64)
    walker = target(20.0, 200.0, 1e-4)
    frame = replace(Frame(0, "scene", "s", 0, targets=(walker,)), velocity=np.zeros((1, 40), np.float32))
    ((made, counts),) = image([Measurement(frame, moments, {}, AT_REST)], radar)
    assert len(made.targets) == MAXIMUM_TARGETS
    assert made.targets[-1] == walker
    levels = [one.amplitude_db for one in made.targets]
    assert levels == sorted(levels, reverse=True)
    assert counts["targets_left_out"] > 100


def test_the_rule_spelt_out() -> None:
    """Every maximum of a crowded image against the sum over the stronger ones that stay."""
    generator, response = np.random.default_rng(2), response_of(RADAR, WINDOW)
    places = zip(generator.uniform(20, 60, 40), generator.uniform(0, COLUMNS, 40), strict=True)
    echoes = [(*place, 10.0 ** -generator.uniform(0.0, 2.5) * np.exp(1j * k)) for k, place in enumerate(places)]
    image = image_of(*echoes)
    expected: list[tuple[int, int, float]] = []
    cells = detected_cells(image, NOISE, np.zeros(ROWS, np.int64))
    cells = cells.take(np.argsort(-cells.level, kind="stable"))
    for row, column, _, level in zip(*map(np.ndarray.tolist, cells), strict=True):
        explained = 0.0
        for r, c, a in expected:
            far, aside = abs(row - r), abs(column - c)
            if far < len(response.over_bins) and (far > 1 or aside > response.lobe):
                explained += (a * response.over_bins[far] * response.over_u[aside]) ** 2
        if level**2 > MARGIN * explained:
            expected.append((row, column, level))
    assert 20 <= len(expected) <= 45
    assert sorted(listed(image)) == sorted((row, column) for row, column, _ in expected)


def test_a_frame_without_echoes_lists_none() -> None:
    assert listed(np.zeros((ROWS, COLUMNS), np.float32)) == []
    assert listed(np.full((ROWS, COLUMNS), 1e-9, np.float32), target(10, 10, 1.0)) == []
