"""``trainer predict --points``: one detection for each target."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from paper_arrays import ARRAYS, RADAR, U

from shared.physics.errors import InputError
from shared.radar import Radar
from shared.radar.arrays import AntennaArray, line
from shared.signal.spectrum import select_doppler
from shared.signal.windows import cell_noise_power, hann, hann_envelope_db, hann_response
from trainer.data.arrays import choose_array
from trainer.data.cfar import cfar_cells
from trainer.data.measurements import Cells
from trainer.data.simulation import amplitude_of, in_plane, snapshot
from trainer.estimators.array import line_array
from trainer.estimators.base import ESTIMATORS
from trainer.estimators.fitting import alternating
from trainer.run.detection_files import records
from trainer.run.detections import Detections, Sought, _shown, find_detections, line_probability
from trainer.run.targets_once import Centres, Lines

ARRAY = ARRAYS["sparse6"]
CHANNELS = choose_array("sparse6", RADAR).channels(RADAR)
NOISE = cell_noise_power(RADAR)
STEP = RADAR.waveform.range_step_m


def detect(
    snapshots: NDArray[np.complexfloating],
    velocity: NDArray[np.floating],
    probability=None,
    radar: Radar = RADAR,
    **sought: float,
) -> Detections:
    """From delay-and-sum images of snapshots [D, R, C]."""
    chosen = snapshots[..., CHANNELS]
    image = np.stack([ESTIMATORS["das"]().image(peak, ARRAY, U, NOISE) for peak in chosen])
    cells = Cells(chosen, velocity)
    return find_detections(image, probability, cells, radar, ARRAY, Sought(NOISE, **sought))


def at_rest(ranges: list[float], u: list[float], snr_db: list[float], seed: int = 0) -> NDArray[np.complex64]:
    """[1, R, C] of resting targets at these ranges [bins], with noise."""
    amplitudes = np.array([amplitude_of(level, RADAR) for level in snr_db]) * np.exp(1j * np.arange(len(u)))
    positions = in_plane(STEP * np.array(ranges), np.array(u))
    return snapshot(RADAR, positions, amplitudes, np.random.default_rng(seed))[None]


def test_each_target_is_one_detection_where_it_stands() -> None:
    """Among them a pair half a cell apart, and one 35 dB below the strongest, three range bins from it."""
    cell = ARRAYS["full"].resolution_cell
    ranges = [100.0, 200.3, 200.3, 300.45, 303.45, 400.7]
    u = [-0.4, 0.1, 0.1 + 0.5 * cell, 0.3, -0.3, 0.7]
    snr_db = [20.0, 30.0, 30.0, 50.0, 15.0, 25.0]
    found = detect(at_rest(ranges, u, snr_db), np.zeros((1, 630)))
    assert (np.diff(found.amplitude_db) <= 0.0).all()
    for bins, angle, level in zip(ranges, u, snr_db, strict=True):
        near = (np.abs(found.u - angle) < 0.2 * cell) & (np.abs(found.range_m / STEP - bins) < 0.6)
        assert near.sum() == 1
        (index,) = np.flatnonzero(near)
        # A range bin shows a target up to 1.4 dB too low; noise adds to it.
        expected = 20.0 * np.log10(amplitude_of(level, RADAR))
        assert found.amplitude_db[index] == pytest.approx(expected, abs=2.5)
        assert abs(found.u[index] - angle) < 5.0 * found.u_std[index] + 1e-3
    # At most one false line in 630 rows of noise is stated; the front's curvature and range sidelobes may add one.
    assert len(found) <= len(u) + 2
    assert ((found.probability > 0.5) & (found.probability < 1.0)).all()
    assert np.argmax(found.snr_db) == np.argmax(found.probability) == 0
    assert not found.velocity.any()


def test_of_a_tx_beside_the_rx_a_wide_sweep_lists_each_target_once() -> None:
    """All channels walk through the bins together there, 1.4 bins at u = 0.7: nothing but the targets is strong."""
    array = AntennaArray(tx_m=((0.0, -0.15, 0.0),), rx_m=line(2e-3 * np.arange(-8.0, 8.0)))
    waveform = RADAR.waveform.model_copy(update={"bandwidth_hz": 4e9, "samples": 256, "range_bins": 256})
    radar = Radar(array=array, waveform=waveform)
    range_m, u = np.arange(3.0, 9.5), np.array([0.7, 0.5, 0.3, 0.1, -0.3, -0.5, -0.7])
    seen = snapshot(radar, in_plane(range_m, u), np.full(7, amplitude_of(30.0, radar)), np.random.default_rng(1))[None]
    elements, power = line_array(radar), cell_noise_power(radar)
    image = ESTIMATORS["das"]().image(seen[0], elements, U, power)[None]
    found = find_detections(image, None, Cells(seen, np.zeros((1, 256), np.float32)), radar, elements, Sought(power))
    order = np.argsort(found.range_m[:7])
    np.testing.assert_allclose(found.range_m[:7][order], range_m, atol=0.003)
    np.testing.assert_allclose(found.u[:7][order], u, atol=0.003)
    assert found.snr_db[7:].max(initial=0.0) < 20.0


def test_elements_that_err_make_no_ghosts_for_who_is_told_of_it() -> None:
    """-20 dB by errors of TX and RX, of which lines are found at the reflector's range where nobody is told."""
    ghosts = {-30.0: 0, -20.0: 0}
    for seed in range(4):
        generator = np.random.default_rng(seed)
        error = np.ones(48, dtype=np.complex128)
        for element in (RADAR.array.channel_tx, RADAR.array.channel_rx):
            drawn = generator.standard_normal((element.max() + 1, 2)) @ [0.5, 0.5j]
            error += 0.1 * drawn[element]
        seen = at_rest([150.2, 300.0], [0.1, -0.5], [50.0, 20.0], seed) * error
        for told in ghosts:
            found = detect(seen, np.zeros((1, 630)), model_error_db=told)
            assert (np.abs(found.u[0] - 0.1), np.abs(found.range_m / STEP - 300.0).min()) < (0.01, 0.6)
            ghosts[told] += int((np.abs(found.range_m / STEP - 150.2) < 1.0).sum()) - 1
    assert ghosts[-30.0] >= 8
    assert ghosts[-20.0] == 0


def test_sidebands_of_an_oscillator_are_no_echoes(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reflector's phase noise stands at its angle in every range bin; what rises out of it there is an echo."""
    generator = np.random.default_rng(3)
    seen = at_rest([150.0, 400.0, 450.0], [0.1, -0.5, 0.1], [90.0, 20.0, 35.0])
    drawn = generator.standard_normal((seen.shape[1] + 2, 2)) @ [0.5**0.5, 1j * 0.5**0.5]
    windowed = (drawn[1:-1] - 0.5 * drawn[:-2] - 0.5 * drawn[2:]) / 1.5**0.5
    front = seen[0, 150] / np.abs(seen[0, 150])
    seen = seen + amplitude_of(8.0, RADAR) * windowed[:, None] * front

    def far(found: Detections) -> list[float]:
        beyond = np.abs(found.range_m / STEP - 150.0) > 60.0
        return sorted((found.range_m[beyond] / STEP).round())

    assert far(detect(seen, np.zeros((1, 630)))) == [400.0, 450.0]
    monkeypatch.setattr("trainer.run.detections.SIDEBANDS_DB", np.inf)
    assert len(far(detect(seen, np.zeros((1, 630))))) > 50


def test_what_leaks_from_tx_to_rx_at_range_zero_is_no_target() -> None:
    generator = np.random.default_rng(4)
    seen = at_rest([200.0], [0.1], [30.0])
    leakage = amplitude_of(40.0, RADAR) * np.exp(2j * np.pi * generator.random(seen.shape[2]))
    seen[0, :2] += np.array([1.0, -0.5])[:, None] * leakage
    found = detect(seen, np.zeros((1, 630)))
    assert found.range_m / STEP == pytest.approx([200.0], abs=0.1)


@pytest.mark.parametrize("place", [0.0, 0.3])
def test_what_leaks_is_no_target_at_the_far_end_of_an_axis_that_comes_round(place: float) -> None:
    """Of complex samples all bins are kept: the last ones show what stands at range zero as well, a converter's offset
    among it."""
    waveform = RADAR.waveform.model_copy(update={"samples": 630})
    radar, bins = RADAR.model_copy(update={"waveform": waveform}), np.arange(630)
    from_leakage = (bins - place + 315.0) % 630.0 - 315.0
    seen = at_rest([200.0], [0.1], [30.0])
    leakage = amplitude_of(40.0, RADAR) * np.exp(2j * np.pi * np.random.default_rng(4).random(seen.shape[2]))
    seen[0] += (alternating(bins) * hann_response(from_leakage))[:, None] * leakage
    found = detect(seen, np.zeros((1, 630)), radar=radar)
    assert found.range_m / STEP == pytest.approx([200.0], abs=0.1)


def test_range_is_interpolated_where_both_neighbours_show_the_target() -> None:
    for offset in (-0.4, 0.0, 0.25):
        found = detect(at_rest([150.0 + offset], [0.2], [35.0]), np.zeros((1, 630)))
        assert found.range_m[0] / STEP == pytest.approx(150.0 + offset, abs=0.06)
        assert abs(found.range_m[0] / STEP - 150.0 - offset) < 5.0 * found.range_std[0] / STEP + 1e-3
        assert found.velocity_std[0] == pytest.approx(RADAR.waveform.velocity_step_mps / math.sqrt(12.0))


def test_range_is_that_of_the_bin_where_no_neighbour_shows_the_target() -> None:
    """No two neighbouring bins have a peak at one Doppler cell."""
    velocity = RADAR.waveform.velocity_step_mps * (np.arange(630.0) % 64.0)
    found = detect(at_rest([150.3], [0.2], [35.0]), velocity[None])
    assert found.range_m[0] == pytest.approx(150.0 * STEP)
    np.testing.assert_allclose(found.range_m / STEP, np.rint(found.range_m / STEP), rtol=1e-12)
    np.testing.assert_allclose(found.range_std, STEP / math.sqrt(12.0))


@pytest.mark.parametrize(
    ("held", "offset_std", "shown"), [(False, 0.44, False), (False, 0.2, True), (True, 0.44, True), (True, 0.6, False)]
)
def test_a_line_that_its_bin_does_not_measure_needs_a_better_range(held: bool, offset_std: float, shown: bool) -> None:
    """1.39 bins above a centre, as ghosts of strong sidelobes stood; the bin between may hold the Doppler cell."""
    cells = np.array([[0, 0, 0 if held else 7, 9]])
    centres = Centres(cells, np.ones(cells.shape, bool), np.array([0]), np.array([1]))
    one = np.ones(1)
    line = Lines(
        chirps=64, around=np.inf, place=2.39 * one, cell=np.array([0]), group=np.array([0]), energy=one, noise=one,
        u=0.1 * one, offset=1.39 * one, level_db=one, u_std=0.01 * one, offset_std=offset_std * one, shift=0.0 * one,
        shift_std=one,
    )  # fmt: skip
    assert _shown(line, centres, RADAR).tolist() == [shown]


@pytest.mark.parametrize("seed", range(3))
def test_a_strong_target_between_bins_is_one_line_whose_place_its_cells_tell(seed: int) -> None:
    """Half a bin from two centres: beyond OWN_BINS its sidelobes would be more, within half a bin it would be none."""
    found = detect(at_rest([150.5], [0.2], [60.0], seed), np.zeros((1, 630)))
    assert (found.range_std <= 0.5 * STEP).all()  # PLACED_BINS
    assert found.range_m / STEP == pytest.approx([150.5], abs=0.06)  # OWN_BINS


@pytest.mark.parametrize("seed", range(3))
def test_a_target_in_the_bin_beside_a_stronger_one_is_fitted_in_its_group(seed: int) -> None:
    """Only the strongest of three neighbouring bins is a centre: what stands in the others is told there, once."""
    ranges, u = [150.1, 151.0, 148.9], [0.2, -0.4, 0.6]
    found = detect(at_rest(ranges, u, [40.0, 25.0, 20.0], seed), np.zeros((1, 630)))
    for bins, angle in zip(ranges, u, strict=True):
        (index,) = np.flatnonzero(np.abs(found.u - angle) < 0.02)
        assert abs(found.range_m[index] / STEP - bins) < 5.0 * found.range_std[index] / STEP + 1e-2
        assert found.range_std[index] < 0.2 * STEP


def test_the_detection_head_is_asked_where_a_line_stands() -> None:
    """In the bin beside the centre of its group."""
    seen, told = at_rest([150.1, 151.0], [0.2, -0.4], [40.0, 20.0]), {}
    for sure in (150, 151):
        probability = np.full((1, 630, len(U)), 1e-3)
        probability[0, sure] = 1.0 - 1e-3
        found = detect(seen, np.zeros((1, 630)), probability)
        (told[sure],) = found.probability[np.abs(found.u + 0.4) < 0.02]
    assert told[151] > told[150] + 0.05


def test_a_pair_between_bins_is_two_in_one_of_its_bins_and_stays_two() -> None:
    """Half a cell apart, 19.5 dB, eight pairs a frame, random phases: nine in ten were two when bins were fitted each
    by itself and the stronger merged line won."""
    generator, cell, two, false = np.random.default_rng(21), ARRAYS["full"].resolution_cell, 0, 0
    for seed in range(6):
        ranges = np.arange(60.0, 260.0, 25.0) + generator.uniform(-0.5, 0.5, 8)
        centres = generator.uniform(-0.6, 0.6, 8)
        u = (centres[:, None] + 0.25 * cell * np.array([-1.0, 1.0])).ravel()
        phases = np.exp(2j * np.pi * generator.random(16))
        positions = in_plane(STEP * np.repeat(ranges, 2), u)
        rows = snapshot(RADAR, positions, amplitude_of(19.5, RADAR) * phases, np.random.default_rng(seed))
        found = detect(rows[None], np.zeros((1, 630)))
        for place, centre in zip(ranges, centres, strict=True):
            near = (np.abs(found.range_m / STEP - place) < 1.0) & (np.abs(found.u - centre) < cell)
            two += int(np.count_nonzero(near) == 2)
        off = np.abs(found.range_m[:, None] / STEP - ranges).min(axis=1)
        false += int(np.count_nonzero(off > 3.0))
    assert two >= 46
    assert false <= 6


def test_sidelobes_over_range_and_doppler_are_no_targets() -> None:
    quiet = detect(at_rest([150.3], [0.2], [60.0]), np.zeros((1, 630)))
    assert np.count_nonzero(np.abs(quiet.u - 0.2) < 0.02) == 1
    # The same row again at other Doppler cells: 40 dB below four cells off, and 20 dB below twenty cells off.
    one = at_rest([150.0], [0.2], [45.0])
    peaks = np.concatenate([one, 0.01 * one, 0.1 * one, one])
    step = RADAR.waveform.velocity_step_mps
    velocity = step * np.repeat([[0.0], [4.0], [20.0], [0.0]], 630, axis=1)
    found = detect(peaks, velocity)
    near = np.abs(found.u - 0.2) < 0.02
    np.testing.assert_allclose(sorted(found.velocity[near]), [0.0, 20.0 * step])


def test_the_envelope_is_above_the_window_everywhere() -> None:
    spectrum = np.abs(np.fft.fft(hann(64), 64 * 32)) / 32.0
    bins = np.arange(len(spectrum) // 4) / 32.0
    assert (20.0 * np.log10(spectrum[: len(bins)] + 1e-20) <= hann_envelope_db(bins) + 0.05).all()
    assert hann_envelope_db(np.array([2.36]))[0] == pytest.approx(-31.0, abs=1.0)


def test_noise_alone_and_nothing_at_all() -> None:
    assert len(detect(np.concatenate([at_rest([100.0], [0.0], [-300.0], seed) for seed in range(3)]),
                      np.arange(3.0)[:, None] * np.ones((3, 630)))) <= 6  # fmt: skip
    empty = detect(np.zeros((3, 630, 48), np.complex64), np.zeros((3, 630)))
    assert len(empty) == 0
    assert records(empty) == []


@pytest.mark.parametrize("name", ["sparse6", "full"])
@pytest.mark.parametrize("every_cell", [False, True], ids=["peaks", "all"])
def test_noise_alone_lists_as_many_lines_as_asked(name: str, every_cell: bool) -> None:
    """Of Hann windowed noise: within three standard deviations of a Poisson count."""
    frames, asked, listed = 5, 10.0, 0
    channels = choose_array(name, RADAR).channels(RADAR)
    for seed in range(frames):
        draw = np.random.default_rng(seed)
        white = draw.standard_normal((630, 128, 48, 2), dtype=np.float32).view(np.complex64)[..., 0]
        for axis in (0, 1):
            white -= 0.5 * (np.roll(white, 1, axis) + np.roll(white, -1, axis))
        spectra = white * np.float32(np.sqrt(0.5 * NOISE) / 1.5)
        chosen, centre = cfar_cells(spectra) if every_cell else (select_doppler(spectra, NOISE), None)
        cells = Cells(chosen.range_channel[..., channels], chosen.velocities_mps(RADAR.waveform), centre)
        image = np.ones((*cells.velocity.shape, RADAR.grid.bins))
        listed += len(find_detections(image, None, cells, RADAR, ARRAYS[name], Sought(NOISE, false_alarms=asked)))
    assert listed == pytest.approx(asked * frames, abs=3.0 * math.sqrt(asked * frames))


def test_probability_orders_candidates_and_is_read_beside_the_line() -> None:
    place = 300
    probability = np.zeros((1, 630, 450), np.float32)
    probability[0, 150, place] = 0.8
    found = detect(at_rest([150.0], [U[place] + 0.001], [30.0]), np.zeros((1, 630)), probability)
    assert found.probability[0] == pytest.approx(
        line_probability(found.snr_db[:1], found.unlike_ways_db[:1], np.array([0.8]))[0]
    )
    assert found.probability[0] > line_probability(found.snr_db[:1], found.unlike_ways_db[:1], np.array([0.1]))[0]


def test_shapes_that_do_not_fit_are_refused() -> None:
    cells = Cells(np.zeros((1, 6, 18), np.complex64), np.zeros((1, 6), np.float32))
    with pytest.raises(InputError, match="detections"):
        find_detections(np.zeros((1, 5, 450)), None, cells, RADAR, ARRAY, Sought(NOISE))
