"""How much a frame would change without an effect, against slow sums; what it is then made with; boxes, noise."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from oracles import delays
from path_tables import a_table
from prepared_scenes import prepared_scene
from usd_files import translated, write_usda

from datafactory import load_radar, render
from datafactory.effects.catalogue import ALL, NAMES, NO_CHOICE, PATH_EFFECTS, SIGNAL_EFFECTS, EffectSet
from datafactory.effects.plan import Loss, plan_of_frame
from datafactory.frame import decision
from datafactory.frame.chain import ChainSettings, SceneSource, make_frames
from datafactory.frame.deal import Deal
from datafactory.frame.decision import Decided, doppler_called_for, path_effects
from datafactory.frame.measurement import Processing, boxes_of
from datafactory.frame.points import target_list
from datafactory.paths.candidates import EDGE, PANE, TWICE, Candidates
from datafactory.paths.cells import cell_power
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import (
    DIFFRACTED,
    DIFFUSE,
    REFRACTED,
    SPECULAR,
    PathTable,
    ScatteredPaths,
    SpecularPaths,
)
from datafactory.scenes.boxes import SeenThing
from datafactory.scenes.poses import Pose
from shared.dataset.folder import open_dataset
from shared.radar import FrontEnd, Radar
from shared.radar.waveform import Waveform
from shared.signal.spectrum import range_doppler

LIGHT_MPS = 299_792_458.0
SPEEDS_MPS = np.array([0.0, 0.02, 0.1, 0.35, 1.0, 3.3, 7.0, 11.0])
RADAR, WAVEFORM = Radar(), Waveform()
FINER = 16
"""How much finer than its bins a spectrum is sampled by the references."""


def hann(count: int) -> np.ndarray:
    """Periodic Hann window whose samples add up to 1."""
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(count) / count)
    return window / window.sum()


def response_change(phase_cycles: np.ndarray) -> float:
    """max |DFT of w (exp(j 2 pi phase) - 1)| over frequencies in steps of 1 / FINER bins, by explicit sums."""
    count = len(phase_cycles)
    bins = np.arange(-8 * FINER, 8 * FINER + 1) / FINER
    kernel = np.exp(-2j * np.pi * bins[:, None] * np.arange(count) / count)
    return float(np.abs(kernel @ (hann(count) * (np.exp(2j * np.pi * phase_cycles) - 1.0))).max())


@pytest.mark.parametrize(
    ("change", "count", "duration_s"),
    [
        (decision.doppler_change, WAVEFORM.chirps, WAVEFORM.chirps * WAVEFORM.chirp_interval_s),
        (decision.intra_chirp_change, WAVEFORM.samples, WAVEFORM.chirp_duration_s),
    ],
)
def test_the_change_by_motion_is_that_of_windowed_chirps_and_samples(change, count: int, duration_s: float) -> None:
    """Their phases 2 v t / lambda, t from mid-frame of chirps, from mid-sweep of samples, against none at all."""
    time_s = (np.arange(count) / count - 0.5) * duration_s
    slow = [response_change(2.0 * speed * time_s / WAVEFORM.wavelength_m) for speed in SPEEDS_MPS]
    for sign in (1.0, -1.0):
        np.testing.assert_allclose(change(sign * SPEEDS_MPS, WAVEFORM), slow, rtol=5e-3, atol=1e-12)


def test_the_change_by_range_migration_is_that_of_the_sum_over_chirps_and_samples() -> None:
    """The beat phase 2 B v t s / (c T_c) of a target that moves v t from mid-frame, s from mid-sweep."""
    chirps, samples = WAVEFORM.chirps, 128
    time_s = (np.arange(chirps) - chirps / 2) * WAVEFORM.chirp_interval_s
    share = np.arange(samples) / samples - 0.5
    bins = np.arange(-4 * 8, 4 * 8 + 1) / 8
    over_chirps, over_samples = (
        np.exp(-2j * np.pi * bins[:, None] * np.arange(count) / count) * hann(count) for count in (chirps, samples)
    )
    slow = []
    for speed in SPEEDS_MPS:
        cycles = 2.0 * WAVEFORM.bandwidth_hz * speed * np.outer(time_s, share) / LIGHT_MPS
        slow.append(np.abs(over_chirps @ (np.exp(2j * np.pi * cycles) - 1.0) @ over_samples.T).max())
    fast = decision.migration_change(SPEEDS_MPS, WAVEFORM)
    np.testing.assert_allclose(fast, slow, rtol=0.02, atol=1e-12)


def image_changes(table: PathTable, radar: Radar) -> np.ndarray:
    """[K] largest change of each path's delay-and-sum image, unit amplitudes, a phase common to all channels removed.

    Channel by channel: the exact length of the delay law against its first-order development in the elements' places.
    """
    tx, rx = (np.array(places) for places in (radar.array.tx_m, radar.array.rx_m))
    k = 2.0 * np.pi / radar.waveform.wavelength_m
    u = np.linspace(-1.0, 1.0, 1601)
    elements = [(i, j) for j in range(len(rx)) for i in range(len(tx))]
    steering = np.exp(1j * k * np.outer(u, [tx[i][1] + rx[j][1] for i, j in elements])) / len(elements)
    found = []
    for path in range(len(table)):
        exact, plane = [], []
        for i, j in elements:
            ends: tuple[tuple[np.ndarray, np.ndarray], ...]
            if path < len(table.scattered):
                ends = (table.scattered.tx_point[path], tx[i]), (table.scattered.rx_point[path], rx[j])
            else:
                s = path - len(table.scattered)
                # |x_j - s - H x_i| is the distance of s from x_j - H x_i.
                ends = ((table.specular.image[s], rx[j] - table.specular.axes[s] @ tx[i]),)
            exact.append(sum(np.linalg.norm(point - element) for point, element in ends))
            plane.append(sum(np.linalg.norm(p) - p @ element / np.linalg.norm(p) for p, element in ends))
        exact_wave, plane_wave = (np.exp(1j * k * np.array(length)) for length in (exact, plane))
        common = np.vdot(plane_wave, exact_wave)
        found.append(np.abs(steering @ (exact_wave - common / abs(common) * plane_wave)).max())
    return np.array(found)


def test_the_change_by_plane_waves_bounds_that_of_the_full_array_s_image(monkeypatch) -> None:
    radar, table = Radar(), a_table(np.random.default_rng(5))
    actual = image_changes(table, radar)
    bound = decision.plane_wave_change(table, radar.array, radar.waveform.wavelength_m)
    assert np.all(actual <= bound * (1.0 + 1e-9))
    # A beam cannot gather all of the error, but a good part: 2.6 to 5.3 dB less over three such tables.
    assert np.all(actual >= 0.5 * bound)
    monkeypatch.setattr(decision, "BLOCK", 3)
    np.testing.assert_allclose(decision.plane_wave_change(table, radar.array, radar.waveform.wavelength_m), bound)


def test_range_rates_are_half_of_the_paths_rates(generator) -> None:
    """The larger of the mean rates over both halves of the frame, seen from the origin."""
    table, here = a_table(generator), np.zeros(3)
    half_s = 0.5 * WAVEFORM.chirps * WAVEFORM.chirp_interval_s
    found = [delays(table, here, here, time_s) for time_s in (0.0, half_s, 2.0 * half_s)]
    rates = 0.5 * LIGHT_MPS * np.abs(np.diff(found, axis=0)) / half_s
    np.testing.assert_allclose(decision.range_rates_mps(table, WAVEFORM), rates.max(axis=0), rtol=1e-6, atol=1e-6)


def test_the_change_by_the_pattern_is_that_of_the_illuminated_amplitudes(generator) -> None:
    """The same paths lit with and without the pattern, over the amplitude with it."""
    radar, table = Radar(), a_table(generator)

    def lit(front_end: FrontEnd) -> np.ndarray:
        illuminated = table.illuminated(front_end)
        return illuminated.every("amplitude")

    with_pattern = lit(radar.front_end)
    without = lit(radar.front_end.with_boresight_gain())
    expected = np.abs(without - with_pattern) / np.abs(with_pattern)
    assert expected.max() > 10.0 * expected.min() > 0.0
    np.testing.assert_allclose(decision.pattern_change(table, radar), expected, rtol=1e-9)


WINDOW = "taylor-30"


def a_street(generator: np.random.Generator, speed_mps: float, nearest_m: float) -> PathTable:
    """Two thousand echoes from near to 80 m, as strong as distance makes them, and a dozen with mirrors."""
    count = 2000
    range_m = generator.uniform(nearest_m, 80.0, count)
    u = generator.uniform(-0.8, 0.8, count)
    point = range_m[:, None] * np.stack([np.sqrt(1.0 - u**2), u, np.zeros(count)], axis=1)
    amplitude = 1e-3 * range_m**-2 * generator.normal(size=count)
    scattered = ScatteredPaths.of_points(point, np.tile([-speed_mps, 0.0, 0.0], (count, 1)), amplitude)
    mirrors = a_table(generator).specular
    strength = 1e-4 * generator.uniform(size=len(mirrors)) / mirrors.range_m() ** 2
    still = np.zeros((len(mirrors), 3)) if speed_mps == 0.0 else mirrors.image_velocity
    return PathTable(scattered, replace(mirrors, amplitude=strength.astype(complex), image_velocity=still))


@pytest.mark.parametrize("below_db", [-10.0, -50.0])
@pytest.mark.parametrize("nearest_m", [0.7, 40.0])
@pytest.mark.parametrize("speed_mps", [0.01, 0.1, 1.0, 10.0])
def test_doppler_is_called_for_by_the_sum_over_a_cell(speed_mps: float, nearest_m: float, below_db: float) -> None:
    """The rule spelt out: every path's change by its range rate, summed in every cell."""
    paths = a_street(np.random.default_rng([int(100 * speed_mps), int(nearest_m)]), speed_mps, nearest_m)
    limit = 10.0 ** (below_db / 10.0) * float(cell_power(paths, RADAR, WINDOW).max())
    share = decision.doppler_change(decision.range_rates_mps(paths, RADAR.waveform), RADAR.waveform) ** 2
    expected = bool((cell_power(paths, RADAR, WINDOW, share) > limit).any())
    assert doppler_called_for(paths, RADAR, WINDOW, limit) == expected


def test_the_cases_above_decide_both_ways() -> None:
    """Otherwise the comparison says nothing."""
    slow, fast = (a_street(np.random.default_rng(3), speed, 40.0) for speed in (0.01, 10.0))
    slow = PathTable(slow.scattered)
    limit = 0.1 * float(cell_power(slow, RADAR, WINDOW).max())
    assert not doppler_called_for(slow, RADAR, WINDOW, limit)
    assert doppler_called_for(slow, RADAR, WINDOW, 0.0)
    assert doppler_called_for(fast, RADAR, WINDOW, limit)
    # A standing frame is standing whatever the limit.
    for limit_w in (0.0, 1e-12):
        for radar in (RADAR, RADAR.of_one_chirp):
            assert not doppler_called_for(a_street(np.random.default_rng(3), 0.0, 2.0), radar, WINDOW, limit_w)


@pytest.mark.parametrize(("share", "moves"), [(0.9, True), (1.1, False)])
@pytest.mark.parametrize("speed_mps", [0.5, 20.0])
def test_one_chirp_shows_the_motion_within_it(speed_mps: float, share: float, moves: bool) -> None:
    """Where what it changes exceeds the limit, all of it together; where nothing may be left out, if anything moves."""
    radar = RADAR.of_one_chirp
    paths = PathTable(a_street(np.random.default_rng(3), speed_mps, 40.0).scattered)
    change = decision.intra_chirp_change(decision.range_rates_mps(paths, radar.waveform), radar.waveform) ** 2
    limit = share * float(cell_power(paths, radar, WINDOW, change).max())
    assert doppler_called_for(paths, radar, WINDOW, limit) == moves
    assert doppler_called_for(paths, radar, WINDOW, 0.0)


APPROACHING = f"""def Xform "Target" {{
    custom float radar:rcs_dbsm = 10
    custom double3 radar:velocity = (-50, 0, 0)
    {translated(15, 1, 0)}
}}"""


@pytest.mark.usefixtures("variant")
@pytest.mark.parametrize("chirps", [1, 16])
@pytest.mark.parametrize("budget_db", [None, -30.0], ids=["all", "auto"])
def test_an_echo_is_displaced_by_its_motion_within_a_chirp(
    tmp_path: Path, chirps: int, budget_db: float | None
) -> None:
    """By 2 v T_c / lambda bins towards the sensor, 2.1 at 50 m/s, in input and truth; one chirp tells no velocity."""
    waveform = WAVEFORM.model_copy(update={"chirps": chirps, "range_bins": 128})
    radar, scene = RADAR.model_copy(update={"waveform": waveform}), prepared_scene(write_usda(tmp_path, APPROACHING))
    place = waveform.mid_frame_s * -50.0 + np.hypot(15.0, 1.0)
    bins = 2.0 * 50.0 * waveform.chirp_duration_s / waveform.wavelength_m
    frame = Deal(scenes=1, poses=(Pose((0.0, 0.0, 0.0)),)).frame(0)
    quiet = replace(ALL.settings(ChainSettings(TraceSettings(rays=1000), Processing(noise=False))), budget_db=budget_db)
    for settings, moved in ((quiet, bins), (ALL.without("doppler").settings(quiet), 0.0)):
        ((made, counts),) = make_frames([SceneSource(frame, scene, settings)], radar)
        for seen in (np.abs(made.range_channel[0]).sum(axis=1), made.image.max(axis=1)):
            assert int(seen.argmax()) == pytest.approx(place / waveform.range_step_m - moved, abs=0.6)
        has = {name: bool(counts[f"frames_with_{name}"]) for name in (*NO_CHOICE, "doppler")}
        several = moved > 0.0 and chirps > 1
        assert has == {
            "doppler": several, "range_migration": several, "intra_chirp_motion": moved > 0.0, "near_field": True,
        }  # fmt: skip
    told = plan_of_frame(SceneSource(frame, scene, replace(quiet, budget_db=-30.0)), radar)
    assert (told.effects["doppler"], told.losses["doppler"] == Loss()) == (chirps > 1, chirps == 1)
    assert told.effects["intra_chirp_motion"]
    assert told.losses["intra_chirp_motion"].change_db > -3.0


def test_rows_stay_with_their_candidates_and_panes_take_with_them_what_they_let_through() -> None:
    place = np.array([[20.0, 0.0, 0.0]])
    groups = [Candidates.group(family, Candidates.of(family, place, np.ones(1))) for family in (PANE, TWICE)]
    candidates = Candidates.joined([Candidates.of(EDGE, np.tile(place, (2, 1)), np.ones(2)), *groups])
    rows = ScatteredPaths.of_points(np.tile(place, (6, 1)), np.zeros((6, 3)), np.ones(6))
    kinds = np.array([DIFFUSE, DIFFRACTED, DIFFRACTED, DIFFUSE | REFRACTED, DIFFUSE, DIFFUSE | REFRACTED], np.uint8)
    rows = replace(
        rows, kinds=kinds, candidate=np.array([-1, 0, 1, 2, 4, -1], np.int32), object_index=np.arange(6, dtype=np.int32)
    )
    table = PathTable(rows, candidates=candidates)

    def kept(*worth: bool) -> list[int]:
        return Decided(1.0, np.array(worth)).kept(table).scattered.object_index.tolist()

    assert kept(True, True, True, True, True, True) == [0, 1, 2, 3, 4, 5]
    assert kept(False, True, True, True, False, False) == [0, 2, 3, 5]
    assert kept(True, False, False, False, True, True) == [0, 1, 4]  # what passed panes goes, whoever's row it is


def test_a_frame_has_an_effect_where_a_path_of_it_is_left() -> None:
    place = np.array([[20.0, 0.0, 0.0]])
    rough = replace(ScatteredPaths.of_points(place, 0.0 * place, np.ones(1)), kinds=np.array([DIFFUSE], np.uint8))
    assert {name for name, on in path_effects(PathTable(rough)).items() if on} == {"diffuse"}
    twice = replace(rough, depth=np.array([2], np.int8))
    assert {name for name, on in path_effects(PathTable(twice)).items() if on} == {"diffuse", "multi_bounce"}
    none = path_effects(PathTable(ScatteredPaths.none()))
    assert not any(none.values())
    assert sorted(none) == sorted(PATH_EFFECTS)
    assert sorted((*PATH_EFFECTS, *SIGNAL_EFFECTS)) == sorted(NAMES)


@pytest.mark.parametrize("name", SIGNAL_EFFECTS)
def test_settings_say_which_effects_of_the_signal_they_have(name: str) -> None:
    """The way back from :meth:`EffectSet.settings`; what comes with Doppler goes with it."""
    for effects in (ALL, ALL.without(name), EffectSet.of({name})):
        on = {each for each, value in effects.settings(ChainSettings()).signal_effects(RADAR).items() if value}
        expected = {"near_field", *({"doppler", *NO_CHOICE} if "doppler" in effects.names else ())}
        assert on == expected | {"antenna_pattern", "noise"} & {*effects.names}


AXES = {"forward": (1.0, 0.0, 0.0), "left": (0.0, 1.0, 0.0), "up": (0.0, 0.0, 1.0)}
CAR = SeenThing("/Car", "car", (20.0, 4.0, 0.2), (4.0, 2.0, 1.5), velocity=(-8.0, 3.0, 0.0), indices=(0, 2), **AXES)
NOTHING = PathTable(ScatteredPaths.none(), objects=("body", "wall", "wheel"))


def test_a_box_and_a_target_at_one_place_agree_at_mid_frame() -> None:
    ((box,), _) = boxes_of([CAR], NOTHING, RADAR)
    (target,) = target_list(np.array([CAR.center]), np.array([CAR.velocity]), np.zeros(1), ["/Car"], RADAR)
    range_m = float(np.linalg.norm(box.center))
    assert range_m == pytest.approx(target.range_m, abs=1e-12)
    assert box.center[1] / range_m == pytest.approx(target.u, abs=1e-12)
    assert np.dot(box.center, box.velocity) / range_m == pytest.approx(target.velocity_mps, abs=1e-12)
    assert (box.size, box.class_name, box.object, box.yaw) == (CAR.size, "car", "/Car", 0.0)
    turned = replace(CAR, forward=(0.0, -1.0, 0.0), left=(1.0, 0.0, 0.0))
    ((box,), _) = boxes_of([turned], NOTHING, RADAR)  # yaw is the heading in the radar frame
    assert box.yaw == pytest.approx(-np.pi / 2)


def test_power_is_that_of_the_paths_off_its_own_parts() -> None:
    """Two off the body, one off the wheel, one mirrored by the wheel; the wall's and the unknown's are not its own."""
    index = np.array([0, 0, 1, 2, -1], dtype=np.int32)
    scattered = ScatteredPaths.of_points(
        np.ones((5, 3)), np.zeros((5, 3)), 1j * np.array([1.0, 2.0, 5.0, 3.0, 7.0]), index
    )
    image, still, axes, wheel = np.ones((1, 3)), np.zeros((1, 3)), np.eye(3)[None], np.array([2], dtype=np.int32)
    specular = SpecularPaths.of(image, still, axes, np.array([4.0 + 0j]), wheel, SPECULAR)
    ((box,), _) = boxes_of([CAR], replace(NOTHING, scattered=scattered, specular=specular), RADAR)
    assert box.power == pytest.approx(1.0 + 4.0 + 9.0 + 16.0)
    ((hidden,), _) = boxes_of([CAR], NOTHING, RADAR)
    assert hidden.power == 0.0


@pytest.mark.parametrize(
    ("center", "kept"),
    [
        ((20.0, 4.0, 0.0), True),
        ((-20.0, 4.0, 0.0), False),  # behind
        ((200.0, 0.0, 0.0), False),  # beyond the range
        ((96.0, 0.0, 0.0), True),  # its rear is within
        ((4.0, 16.0, 0.0), False),  # u = 0.97
        ((5.0, 9.2, 0.0), True),  # u = 0.88, a corner at 0.8
    ],
)
def test_what_is_out_of_view_is_counted(center: tuple[float, float, float], kept: bool) -> None:
    thing = replace(CAR, center=center, velocity=(0.0, 0.0, 0.0))
    boxes, counts = boxes_of([thing], NOTHING, RADAR)
    assert (len(boxes), counts) == (int(kept), {"boxes": int(kept), "boxes_out_of_view": int(not kept)})


CONVERTING = """
[waveform]
samples = 256
chirps = 64
range_bins = 100
[front_end]
converter = { bits = 8, full_scale_dbm = -50 }
"""


@pytest.mark.parametrize("text", [CONVERTING, CONVERTING.partition("[front_end]")[0]], ids=["converter", "none"])
def test_the_noise_of_a_frame_is_that_of_its_cells(tmp_path: Path, text: str) -> None:
    """A converter whose step is 2.5 deviations of the receiver's noise; thousands of points were listed of it."""
    (tmp_path / "radar.toml").write_text(text, encoding="utf-8")
    radar = load_radar(str(tmp_path / "radar.toml"))
    render(None, tmp_path / "data", radar=radar, frames=0, points=1, split="0:0:1", store="cube")
    (frame,) = open_dataset(tmp_path / "data").frames("test")
    assert frame.cube is not None
    cells = np.abs(range_doppler(frame.cube, radar)) ** 2
    assert frame.noise_power == pytest.approx(np.median(cells) / np.log(2.0), rel=0.05, abs=0.0)
