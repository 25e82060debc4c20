"""Online point targets: what is drawn, the signal model's echoes in both arrays, the same crop for the same place."""

import numpy as np
import pytest
import torch
from tiny_radar import RADAR

from shared.radar import Radar, load_radar
from shared.signal import if_signal, if_signal_of_delays
from shared.signal.spectrum import range_doppler
from shared.signal.windows import hann, hann_spectrum
from trainer.estimators.array import line_array
from trainer.training import online_points as module
from trainer.training.online_points import (
    EXTENT_CELLS,
    FLASH_DB,
    LEVEL_DB,
    MOST_POINTS,
    NEIGHBOURS,
    SCATTERERS,
    OnlinePoints,
    Targets,
    draw_targets,
)

CPU = torch.device("cpu")
QUIET = torch.zeros(1, 24, 6, dtype=torch.complex64)


def targets(row, u, amplitude, first=1e6, extended=()):
    """Points at rows of a crop whose first row is that range bin; far away by default."""
    count = len(row)
    return Targets(
        np.array(row), np.array(u), np.array(amplitude, complex), np.ones(count, dtype=bool), first,
        np.array(extended).reshape(-1, 3),
    )  # fmt: skip


def see(row, u, amplitude):
    """([R, C] snapshots without noise, [R, U] truth) of one crop."""
    snapshots = QUIET.clone()
    return snapshots, OnlinePoints(RADAR, "none", 6)._echoes([targets(row, u, amplitude)], snapshots)


def test_the_range_response_is_the_spectrum_of_the_window():
    samples = 512
    window = hann(samples)
    offset = np.array([-2.7, -1.0, -0.4, 0.0, 0.25, 1.0, 1.5, 2.0])
    tone = np.exp(2j * np.pi * offset[:, None] * np.arange(samples) / samples)
    np.testing.assert_allclose(hann_spectrum(offset), tone @ window / window.sum(), atol=2e-3)


def signal_model(radar, row, u):
    """[range bins, C] eq. (1) and (2) and the range FFT: a target at a range bin, not whole, and u."""
    position = row * radar.waveform.range_step_m * np.array([np.sqrt(1 - u**2), u, 0.0])
    legs = [np.linalg.norm(part - position, axis=1) for part in (radar.array.tx, radar.array.rx)]
    tau = (legs[0][radar.array.channel_tx] + legs[1][radar.array.channel_rx]) / 299_792_458.0
    samples = if_signal_of_delays(radar, tau[:, None])[0]  # (N, C)
    window = hann(radar.waveform.samples)[:, None]
    return np.fft.fft(samples * window, axis=0) / window.sum()


def distance(spectrum, expected):
    """(|p|, error over the norm) of the best p in spectrum = p expected."""
    projection = np.vdot(expected, spectrum) / np.vdot(expected, expected)
    return abs(projection), np.linalg.norm(spectrum - projection * expected) / np.linalg.norm(spectrum)


def test_an_echo_is_that_of_the_signal_model_up_to_its_phase():
    """At 60 m: the range bin and u alone say nearly all."""
    radar = load_radar("avr-qdm-110")
    u, row = radar.grid.u[304], 400.3
    snapshots = torch.zeros(1, 630, 48, dtype=torch.complex64)
    truth = OnlinePoints(radar, "taylor-30", 48)._echoes([targets([row], [u], [1.0], first=0.0)], snapshots)[0]
    level, error = distance(signal_model(radar, row, u)[398:404], snapshots[0, 398:404].numpy())
    assert level == pytest.approx(1.0, abs=0.01)
    assert error < 0.1
    # The truth reads the same amplitude at the same place.
    assert truth.max().item() == pytest.approx(abs(hann_spectrum(np.array([0.3])))[0], rel=0.01)
    peak_row, peak_bin = np.unravel_index(int(truth.argmax()), (630, 450))
    assert peak_row == 400
    assert radar.grid.u[peak_bin] == u


@pytest.mark.parametrize("place", [160, 225, 300])
def test_a_close_echo_has_the_curvature_of_the_signal_model(place):
    """At 4 m, in the strongest row, in front of the radar: what a plane wave misses is there."""
    radar = load_radar("avr-qdm-110")
    u = radar.grid.u[place]
    row = float(round(4.0 / radar.waveform.range_step_m))
    points = OnlinePoints(radar, "taylor-30", 48)
    curved, plane = (torch.zeros(1, 8, 48, dtype=torch.complex64) for _ in range(2))
    points._echoes([targets([4.0], [u], [1.0], first=row - 4.0)], curved)
    points._echoes([targets([4.0], [u], [1.0])], plane)
    spectrum = signal_model(radar, row, u)[int(row)]
    level, error = distance(spectrum, curved[0, 4].numpy())
    assert level == pytest.approx(1.0, abs=0.02)
    assert error < 0.05
    assert distance(spectrum, plane[0, 4].numpy())[1] > 0.1


def test_of_tx_in_turns_an_echo_has_the_phase_that_compensation_leaves():
    """A target a third of a cell off the centre of its Doppler cell, through the whole chain of eq. (1)."""
    turn = {"multiplexing": "tdm", "chirp_duration_s": 40e-6, "chirp_interval_s": 120e-6, "chirps": 8}
    radar = load_radar("avr-qdm-110")
    radar = radar.model_copy(update={"waveform": radar.waveform.model_copy(update={**turn, "samples": 640})})
    waveform, row = radar.waveform, 400.0
    rate = (2 + 1 / 3) * waveform.velocity_step_mps
    start = row * waveform.range_step_m - rate * waveform.mid_frame_s
    cube = if_signal(radar, np.array([[start, 0.0, 0.0]]), np.array([[rate, 0.0, 0.0]]), np.ones(1))
    seen = range_doppler(cube.astype(np.complex64), radar)[400, 4 + 2]
    points = OnlinePoints(radar, "taylor-30", 48)
    drawn, still = (torch.zeros(1, 630, 48, dtype=torch.complex64) for _ in range(2))
    points._echoes([targets([row], [0.0], [1.0], first=0.0)], drawn, np.array([1 / 3]))
    points._echoes([targets([row], [0.0], [1.0], first=0.0)], still)
    assert distance(seen, drawn[0, 400].numpy())[1] < 0.01
    assert distance(seen, still[0, 400].numpy())[1] > 0.05
    crops = points(1, 7, range(6), 24, CPU)
    at_once = radar.model_copy(update={"waveform": waveform.model_copy(update={"multiplexing": "simultaneous"})})
    ideal = OnlinePoints(at_once, "taylor-30", 48)(1, 7, range(6), 24, CPU)
    assert torch.equal(crops.image, ideal.image)
    assert not torch.equal(crops.range_channel, ideal.range_channel)
    torch.testing.assert_close(crops.range_channel[..., ::3], ideal.range_channel[..., ::3], atol=1e-3, rtol=1e-4)


def test_echoes_add_and_a_row_outside_reaches_in():
    one, other = see([4.2], [0.1], [1.0])[0], see([5.1], [-0.3], [2j])[0]
    both = see([4.2, 5.1], [0.1, -0.3], [1.0, 2j])[0]
    torch.testing.assert_close(both, one + other)
    outside = see([-0.5], [0.0], [1.0])[0]
    assert outside[0, 0].abs().min() > 0.5
    beyond = abs(hann_spectrum(np.arange(NEIGHBOURS[-1] + 0.5, 20.0)))
    assert 20 * np.log10(beyond.max()) < -48.0


def test_spots_stand_on_points_that_can_be_seen_and_on_maxima_of_extended_targets():
    points = OnlinePoints(RADAR, "none", 6)
    grid = RADAR.grid
    given = targets([4.0, 9.0], [grid.u[5], grid.u[12]], [10.0, 0.1], extended=[[0.0, grid.u[3], 2.0 * grid.step]])
    image = np.zeros((24, 20), np.float32)
    image[0, 3] = image[15, 3] = image[4, 6] = 10.0  # of the extended target, too far in range, too far in both
    found = points._spots([given], image[None])[0].numpy()
    assert np.argwhere(found == 1.0).tolist() == [[0, 3], [4, 5]]


def test_a_crop_is_a_function_of_seed_step_and_place_alone():
    points = OnlinePoints(RADAR, "none", 6)
    whole = points(1, 7, range(4), 24, CPU)
    part = points(1, 7, range(2, 4), 24, CPU)
    assert torch.equal(whole.range_channel[2:], part.range_channel)
    assert torch.equal(whole.image[2:], part.image)
    assert torch.equal(whole.spots[2:], part.spots)
    assert whole.spots.shape == whole.image.shape
    for other in (points(2, 7, range(4), 24, CPU), points(1, 8, range(4), 24, CPU)):
        assert not torch.equal(whole.range_channel, other.range_channel)
    assert whole.image.shape == (4, 24, 20)
    assert whole.image.amax(dim=(1, 2)).max() == 1.0
    assert whole.image_peak.dtype == torch.float64


def test_noise_has_unit_power_and_the_truth_none(monkeypatch):
    monkeypatch.setattr("trainer.training.online_points.GROUPS_PER_ROW", (1e-9, 2e-9))
    crops = OnlinePoints(RADAR, "none", 6)(0, 0, range(40), 24, CPU)
    assert crops.range_channel.abs().square().mean().item() == pytest.approx(1.0, abs=0.05)
    assert not crops.image.any()
    assert not crops.spots.any()
    assert crops.image_peak.tolist() == [1.0] * 40


PAPER, ROWS = Radar(), 160
CELL = line_array(PAPER).resolution_cell


@pytest.fixture(scope="module")
def drawn():
    return [draw_targets(np.random.default_rng(seed), ROWS, PAPER) for seed in range(300)]


def test_every_target_lies_within_its_ranges(drawn):
    waveform = PAPER.waveform
    last = waveform.range_bins
    for targets in drawn:
        lengths = {len(targets.u), len(targets.amplitude), len(targets.point)}
        assert lengths == {len(targets.row)}
        assert (np.abs(targets.u) <= 1.0).all()
        # A group lies within the crop and one row before it, its points about it.
        spread = 6.0 * module.RANGE_SPREAD_BINS
        assert ((targets.row >= -1.0 - spread) & (targets.row <= ROWS + spread)).all()
        assert targets.first_row * waveform.range_step_m >= module.NEAREST_M - 1e-9
        assert targets.first_row <= last + 1e-9
        assert (~targets.point).sum() == SCATTERERS * len(targets.extended)
    level_db = 20.0 * np.log10(np.concatenate([np.abs(t.amplitude[t.point]) for t in drawn]))
    assert LEVEL_DB[0] - module.SPAN_DB <= level_db.min() < LEVEL_DB[0]
    assert LEVEL_DB[1] < level_db.max() <= LEVEL_DB[1] + FLASH_DB


def test_shares_are_those_stated(drawn):
    """Points of one group without a spread in range share their row exactly; so groups can be told from outside."""
    extended = sum(len(targets.extended) for targets in drawn)
    groups, flashes = [], 0
    for targets in drawn:
        row, point = targets.row, targets.point
        for value in np.unique(row[point]):
            members = point & (row == value)
            if members.sum() > 1:  # its points share a row: none of them is spread
                groups.append((np.sort(targets.u[members]), 20.0 * np.log10(np.abs(targets.amplitude[members]))))
        flashes += int((20.0 * np.log10(np.abs(targets.amplitude[point])) > LEVEL_DB[1]).sum() > 0)
    assert len(groups) > 1000
    sizes = np.bincount([len(u) for u, _ in groups], minlength=MOST_POINTS + 1)[2:]
    np.testing.assert_allclose(sizes / sizes.sum(), 1.0 / (MOST_POINTS - 1), atol=0.05)
    near_equal = np.mean([np.ptp(level) <= module.NEAR_SPAN_DB for _, level in groups if len(level) == MOST_POINTS])
    assert near_equal == pytest.approx(module.NEAR_EQUAL, abs=0.1)
    # Points over the whole axis leave wider gaps than those of a cluster.
    clustered = np.mean([np.diff(u).max() <= module.GAP_CELLS[1] * CELL for u, _ in groups if len(u) == MOST_POINTS])
    assert clustered == pytest.approx(module.CLUSTERED, abs=0.1)
    total = extended + 2.0 * len(groups) * MOST_POINTS / (MOST_POINTS - 1)  # half of all groups are spread in range
    assert extended / total == pytest.approx(module.EXTENDED, abs=0.03)
    assert flashes > 0


def test_pairs_of_one_cluster_keep_their_distance(monkeypatch):
    monkeypatch.setattr(module, "CLUSTERED", 1.0)
    gaps = []
    for seed in range(400):
        _, u, amplitude, point = module._points(np.random.default_rng(seed), 3.0, CELL, 20.0)
        assert point.all()
        assert 20.0 * np.log10(np.abs(amplitude).max()) == pytest.approx(20.0)
        if len(u) == 2 and np.abs(u).max() < 1.0:
            gaps.append(np.ptp(u) / CELL)
    low, high = module.GAP_CELLS
    assert low * (1 - 1e-9) <= min(gaps)
    assert max(gaps) <= high * (1 + 1e-9)
    # A uniform logarithm: half of them below the geometric mean.
    assert np.mean(np.array(gaps) < np.sqrt(low * high)) == pytest.approx(0.5, abs=0.2)


def test_an_extended_target_holds_the_cells_over_its_width(drawn):
    widths = np.concatenate([2.0 * targets.extended[:, 2] for targets in drawn]) / CELL
    assert EXTENT_CELLS[0] <= widths.min() < 0.5
    assert 3.0 < widths.max() <= EXTENT_CELLS[1]
    power = [np.sum(np.abs(module._surface(np.random.default_rng(n), 0.0, 0.0, 0.1, 20.0)[2]) ** 2) for n in range(500)]
    assert np.mean(power) == pytest.approx(100.0, rel=0.05)
    targets = next(found for found in drawn if len(found.extended))
    rows, u = np.rint(targets.extended[:, 0]).astype(int), targets.extended[:, 1]
    assert targets.in_extended(rows, u).all()
    none = np.empty(0)
    alone = module.Targets(
        none, none, none.astype(complex), none.astype(bool), 0.0, extended=np.array([[7.2, 0.1, 0.05]])
    )
    found = alone.in_extended(np.array([6, 7, 8, 9, 7, 7]), np.array([0.1, 0.14, 0.06, 0.1, 0.16, 0.04]))
    assert found.tolist() == [True, True, True, False, False, False]


def test_a_radar_that_sees_less_than_the_nearest_range_gets_targets_all_the_same(monkeypatch):
    monkeypatch.setattr(module, "NEAREST_M", 1e3)
    targets = draw_targets(np.random.default_rng(0), 2000, RADAR)
    assert len(targets.row)
    assert targets.first_row == pytest.approx(RADAR.waveform.range_bins)
