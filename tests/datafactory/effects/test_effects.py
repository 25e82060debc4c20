"""Effects by name, what switching one off means, the change formulas against slow sums, and the plan's contract."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles import mirrored, scattered_delays, specular_delays

from datafactory.effects import changes, planning, timing
from datafactory.effects.catalogue import ALL, DESCRIPTIONS, NAMES, PATH_EFFECTS, EffectSet, parse_effects
from datafactory.effects.evidence import FLOOR_DB, Evidence, Probe, gather
from datafactory.effects.picture import draw
from datafactory.effects.plan import DEFAULT_BUDGET_DB, by_choice, decide
from datafactory.frame.chain import Processing
from datafactory.paths.merged_scene import stage_of
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import PathTable, ScatteredPaths, SpecularPaths
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose
from datafactory.scenes.readers.open import open_scene
from shared.physics.errors import InputError
from shared.radar import Radar
from shared.radar.antenna import IsotropicPattern
from shared.radar.front_end import FrontEnd
from shared.radar.waveform import Waveform

CONTRACT = (
    "specular", "diffuse", "multi_bounce", "refraction", "diffraction", "doppler", "range_migration",
    "intra_chirp_motion", "near_field", "antenna_pattern", "rcs_targets", "noise",
)  # fmt: skip
"""Names and order as users' scripts know them."""

LIGHT_MPS = 299_792_458.0
SPEEDS_MPS = np.array([0.0, 0.02, 0.1, 0.35, 1.0, 3.3, 7.0, 11.0])
WAVEFORM = Waveform()
FINER = 16
"""How much finer than its bins a spectrum is sampled by the references."""

EFFECT_SCENES = Path(__file__).resolve().parents[3] / "scenes" / "effects"


def a_table(generator: np.random.Generator, count: int = 12, nearest_m: float = 0.6, farthest_m: float = 30.0):
    """Scattered paths with two different ends, and specular ones by one or two tilted moving mirrors."""
    range_m = np.geomspace(nearest_m, farthest_m, count)
    u = generator.uniform(-0.8, 0.8, count)
    point = range_m[:, None] * np.stack([np.sqrt(0.95 - u**2), u, np.full(count, -np.sqrt(0.05))], axis=1)
    velocity = generator.uniform(-10.0, 10.0, (count, 3))
    scattered = replace(
        ScatteredPaths.of_points(point, velocity, generator.normal(size=count) + 1j * generator.normal(size=count)),
        tx_point=point + generator.uniform(-0.3, 0.3, (count, 3)),
        tx_velocity=generator.uniform(-10.0, 10.0, (count, 3)),
        between_m=generator.uniform(0.0, 3.0, count),
        between_rate_mps=generator.uniform(-5.0, 5.0, count),
    )
    normals = generator.normal(size=(count, 3)) + np.array([4.0, 0.0, 0.0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    reflection = np.eye(3) - 2.0 * normals[:, :, None] * normals[:, None, :]
    turned = np.where(np.arange(count)[:, None, None] % 2, reflection, reflection @ reflection[::-1])
    specular = replace(
        SpecularPaths.none(),
        image=2.0 * point,
        image_velocity=velocity,
        axes=turned,
        amplitude=np.ones(count, dtype=complex),
        depth=np.ones(count, dtype=np.int8),
        object_index=np.zeros(count, dtype=np.int32),
        kinds=np.ones(count, dtype=np.uint8),
    )
    return PathTable(scattered, specular)


def hann(count: int) -> np.ndarray:
    """Periodic Hann window whose samples add up to 1."""
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(count) / count)
    return window / window.sum()


# The catalogue


def test_the_names_are_those_of_the_contract_in_its_order() -> None:
    assert NAMES == CONTRACT == tuple(DESCRIPTIONS)
    assert set(PATH_EFFECTS) < set(CONTRACT)


def test_effects_are_read_from_the_command_line() -> None:
    assert parse_effects("auto") is None
    assert parse_effects("all") == ALL
    assert parse_effects(" noise, specular ,diffuse,") == EffectSet.of({"specular", "diffuse", "noise"})
    assert EffectSet.of({"noise", "specular"}).names == ("specular", "noise")


@pytest.mark.parametrize("text", ["nonsense", "specular,nonsense", "Specular", "auto,noise", "all,noise", "a\nb"])
def test_a_name_that_does_not_exist_is_refused(text: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_effects(text)
    wrong = next(name for name in text.split(",") if name not in NAMES)
    assert "--effects" in str(caught.value)
    assert repr(wrong) in str(caught.value)
    assert ",".join(CONTRACT) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", " ", ",", " , ,"])
def test_no_effect_at_all_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--effects"):
        parse_effects(text)


def test_one_effect_is_added_or_taken_away() -> None:
    few = EffectSet.of({"diffuse", "noise"})
    assert few.with_also("doppler").names == ("diffuse", "doppler", "noise")
    assert few.without("noise").names == ("diffuse",)
    assert few.with_also("noise") == few


def test_each_path_effect_sets_one_field_of_the_trace() -> None:
    settings = TraceSettings(rays=7, depth=3, polarization=("V", "H"))
    everything = ALL.trace(settings)
    assert everything == replace(settings, refraction=True, diffraction=True)
    for name in NAMES:
        left = ALL.without(name).trace(settings)
        fields: dict[str, dict[str, Any]] = {"multi_bounce": {"depth": 1}, "rcs_targets": {"point_targets": False}}
        expected = fields.get(name, {name: False} if name in PATH_EFFECTS else {})
        assert left == replace(everything, **expected), name


def test_what_the_user_left_out_of_the_trace_stays_out() -> None:
    settings = TraceSettings(depth=1, specular=False, diffuse=False)
    assert ALL.trace(settings) == replace(settings, refraction=True, diffraction=True)


def test_each_signal_effect_sets_one_field_of_the_processing() -> None:
    everything = ALL.processing(Processing())
    assert everything == replace(Processing(), intra_chirp_motion=True)
    for name in NAMES:
        own = ("doppler", "range_migration", "intra_chirp_motion", "near_field", "noise")
        expected: dict[str, Any] = {name: False} if name in own else {}
        assert ALL.without(name).processing(Processing()) == replace(everything, **expected), name
    assert not ALL.processing(Processing(noise=False)).noise


def test_without_its_pattern_an_element_has_the_gain_of_boresight_everywhere() -> None:
    front_end, directions = FrontEnd(), np.array([[1.0, 0.0, 0.0], [1.0, 2.0, -0.5], [0.0, 0.0, -1.0]])
    assert ALL.front_end(front_end) is front_end
    flat = ALL.without("antenna_pattern").front_end(front_end)
    for before, after in ((front_end.tx_pattern, flat.tx_pattern), (front_end.rx_pattern, flat.rx_pattern)):
        assert after.power_gain(directions) == pytest.approx(np.full(3, before.power_gain(directions[0])), rel=1e-12)
        assert before.power_gain(directions[2]) < 1e-2 * after.power_gain(directions[2])
    assert flat.transmit_power_dbm == front_end.transmit_power_dbm


# The change formulas


def response_change(phase_cycles: np.ndarray) -> float:
    """max |DFT of w (exp(j 2 pi phase) - 1)| over frequencies in steps of 1 / FINER bins, by explicit sums."""
    count = len(phase_cycles)
    bins = np.arange(-8 * FINER, 8 * FINER + 1) / FINER
    kernel = np.exp(-2j * np.pi * bins[:, None] * np.arange(count) / count)
    return float(np.abs(kernel @ (hann(count) * (np.exp(2j * np.pi * phase_cycles) - 1.0))).max())


def test_the_change_by_doppler_is_that_of_128_windowed_chirps() -> None:
    """Each chirp's phase 2 v t / lambda, t from mid-frame, against none at all."""
    time_s = (np.arange(WAVEFORM.chirps) - WAVEFORM.chirps / 2) * WAVEFORM.chirp_interval_s
    slow = [response_change(2.0 * speed * time_s / WAVEFORM.wavelength_m) for speed in SPEEDS_MPS]
    for sign in (1.0, -1.0):
        fast = changes.doppler_change(sign * SPEEDS_MPS, WAVEFORM)
        np.testing.assert_allclose(fast, slow, rtol=5e-3, atol=1e-12)


def test_the_change_by_motion_within_the_chirp_is_that_of_its_samples() -> None:
    """The same phase over one chirp, t from mid-sweep."""
    time_s = (np.arange(WAVEFORM.samples) / WAVEFORM.samples - 0.5) * WAVEFORM.chirp_duration_s
    slow = [response_change(2.0 * speed * time_s / WAVEFORM.wavelength_m) for speed in SPEEDS_MPS]
    np.testing.assert_allclose(changes.intra_chirp_change(SPEEDS_MPS, WAVEFORM), slow, rtol=5e-3, atol=1e-12)


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
    fast = changes.migration_change(SPEEDS_MPS, WAVEFORM)
    np.testing.assert_allclose(fast, slow, rtol=0.02, atol=1e-12)


def test_changes_by_motion_grow_with_speed_from_nothing_to_everything() -> None:
    speeds = np.linspace(0.0, 400.0, 400)
    for change in (changes.doppler_change, changes.intra_chirp_change):
        values = change(speeds, WAVEFORM)
        assert values[0] == 0.0
        # Once the responses no longer meet, each stands where the other has nothing.
        np.testing.assert_allclose(values[-20:], 1.0, atol=0.05)
        small = change(np.array([1e-3, 2e-3]), WAVEFORM)
        assert small[1] == pytest.approx(2.0 * small[0], rel=1e-3)


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


def test_the_change_by_plane_waves_bounds_that_of_the_full_array_s_image() -> None:
    radar, table = Radar(), a_table(np.random.default_rng(5))
    actual = image_changes(table, radar)
    bound = changes.plane_wave_change(table, radar.array, radar.waveform.wavelength_m)
    assert np.all(actual <= bound * (1.0 + 1e-9))
    # A beam cannot gather all of the error, but a good part: 2.6 to 5.3 dB less over three such tables.
    assert np.all(actual >= 0.5 * bound)


def test_the_change_by_plane_waves_falls_with_range() -> None:
    """A quadratic phase of the aperture, proportional to 1 / R: halved when the range doubles."""
    radar = Radar()
    range_m = np.array([40.0, 80.0, 160.0])
    point = range_m[:, None] * np.array([np.sqrt(0.84), 0.4, 0.0])
    table = PathTable(ScatteredPaths.of_points(point, np.zeros((3, 3)), np.ones(3)))
    change = changes.plane_wave_change(table, radar.array, radar.waveform.wavelength_m)
    np.testing.assert_allclose(change[:-1] / change[1:], 2.0, rtol=0.02)


def test_range_rates_are_half_of_the_paths_rates(generator) -> None:
    table, step_s, here = a_table(generator), 1e-6, np.zeros(3)
    delays = [
        np.concatenate(
            [scattered_delays(table.scattered, here, here, t), specular_delays(table.specular, here, here, t)]
        )
        for t in (-step_s, step_s)
    ]
    expected = 0.5 * LIGHT_MPS * (delays[1] - delays[0]) / (2.0 * step_s)
    np.testing.assert_allclose(changes.radial_mps(table), expected, rtol=1e-4, atol=1e-4)


def test_the_change_by_the_pattern_is_that_of_the_illuminated_amplitudes(generator) -> None:
    """The same paths lit with and without the pattern, over the amplitude with it."""
    radar, table = Radar(), a_table(generator)

    def lit(front_end: FrontEnd) -> np.ndarray:
        illuminated = table.illuminated(front_end)
        return np.concatenate([illuminated.scattered.amplitude, illuminated.specular.amplitude])

    with_pattern = lit(radar.front_end)
    without = lit(ALL.without("antenna_pattern").front_end(radar.front_end))
    expected = np.abs(without - with_pattern) / np.abs(with_pattern)
    assert expected.max() > 10.0 * expected.min() > 0.0
    np.testing.assert_allclose(changes.pattern_change(table, radar), expected, rtol=1e-9)


def test_an_isotropic_radar_has_no_pattern_to_change(generator) -> None:
    isotropic = FrontEnd(tx_pattern=IsotropicPattern(gain_dbi=3.0), rx_pattern=IsotropicPattern())
    radar = Radar(front_end=isotropic)
    np.testing.assert_allclose(changes.pattern_change(a_table(generator), radar), 0.0, atol=1e-12)


# A table that stands still


@pytest.mark.parametrize("time_s", [0.0, 5.2e-3, -1.0])
def test_a_table_at_rest_keeps_the_delays_of_its_moment(generator, time_s: float) -> None:
    table = a_table(generator)
    still = table.at_rest(time_s)
    assert table.moves()
    assert not still.moves()
    tx, rx = np.array([0.0, -0.048, 0.0]), np.array([0.0, 0.045, 0.0])
    for later_s in (0.0, 0.3):
        for delays, before, after in (
            (scattered_delays, table.scattered, still.scattered),
            (specular_delays, table.specular, still.specular),
        ):
            np.testing.assert_allclose(delays(after, tx, rx, later_s), delays(before, tx, rx, time_s), rtol=1e-12)
            np.testing.assert_array_equal(after.amplitude, before.amplitude)


def test_a_moving_mirror_at_rest_shows_the_image_of_its_moment() -> None:
    """A mirror at x = 10 m that recedes with 4 m/s stands at 12 m after half a second."""
    normal = np.array([1.0, 0.0, 0.0])
    specular = replace(
        SpecularPaths.none(),
        image=mirrored(np.zeros(3), (10.0 * normal, normal))[None],
        image_velocity=np.array([[8.0, 0.0, 0.0]]),
        axes=(np.eye(3) - 2.0 * np.outer(normal, normal))[None],
        amplitude=np.ones(1, dtype=complex),
        depth=np.ones(1, dtype=np.int8),
        object_index=np.zeros(1, dtype=np.int32),
        kinds=np.ones(1, dtype=np.uint8),
    )
    still = PathTable(ScatteredPaths.of_points(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)), specular).at_rest(0.5)
    np.testing.assert_allclose(still.specular.image, mirrored(np.zeros(3), (12.0 * normal, normal))[None], atol=1e-12)


# Plans


def evidence(**change_db: float) -> dict[str, Evidence]:
    """Evidence of a scene that has nothing but what is named here."""
    return {name: Evidence(change_db.get(name, FLOOR_DB), f"figures of {name}", 0.25, 0.05) for name in NAMES}


def test_an_effect_is_on_where_it_changes_more_than_the_budget() -> None:
    found = evidence(specular=0.0, diffuse=-29.9, multi_bounce=-30.0, diffraction=-30.1)
    assert decide("scene", found).effects.names == ("specular", "diffuse")
    assert decide("scene", found, -40.0).effects.names == ("specular", "diffuse", "multi_bounce", "diffraction")
    assert DEFAULT_BUDGET_DB == -30.0


def test_an_effect_is_on_where_it_fills_cells_however_far_below_the_peak() -> None:
    found = evidence(specular=0.0, diffuse=-45.0, diffraction=-45.0)
    found["diffuse"] = Evidence(-45.0, "", 0.01, 0.11)
    found["diffraction"] = Evidence(-45.0, "", 0.01, 0.09)
    plan = decide("scene", found)
    assert plan.effects.names == ("specular", "diffuse")
    assert "11 % of the cells" in plan.decisions[1].reason


def test_motion_within_the_frame_means_nothing_without_doppler() -> None:
    frozen = decide("scene", evidence(doppler=-50.0, range_migration=-10.0, intra_chirp_motion=-10.0))
    assert frozen.effects.names == ()
    reasons = {item.effect: item.reason for item in frozen.decisions}
    assert "doppler" in reasons["range_migration"]
    assert "doppler" in reasons["intra_chirp_motion"]
    moving = decide("scene", evidence(doppler=-5.0, range_migration=-10.0, intra_chirp_motion=-40.0))
    assert moving.effects.names == ("doppler", "range_migration")


def test_a_plan_in_json_is_the_contract_s(tmp_path: Path) -> None:
    plan = decide("street", evidence(diffuse=-3.14, near_field=-0.001, noise=0.0), -20.0)
    document = json.loads(json.dumps(plan.to_json()))
    assert document["scene"] == "street"
    assert document["budget_db"] == -20.0
    assert [item["effect"] for item in document["effects"]] == list(CONTRACT)
    for item in document["effects"]:
        assert set(item) == {"effect", "on", "reason", "evidence", "loss_db"}  # cost_seconds joins them in the CLI
        assert isinstance(item["on"], bool)
        assert item["reason"]
        assert "\n" not in item["reason"] + item["evidence"]
        assert item["evidence"] == f"figures of {item['effect']}"
    levels = {item["effect"]: item["loss_db"] for item in document["effects"]}
    assert levels["diffuse"] == -3.1
    assert str(levels["near_field"]) == "0.0"  # and not the minus nothing that rounding leaves
    assert plan.effects.names == ("diffuse", "near_field", "noise")


def test_a_reason_states_the_figure_and_the_budget() -> None:
    plan = decide("scene", evidence(diffuse=-12.34, diffraction=-44.4))
    reasons = {item.effect: item.reason for item in plan.decisions}
    assert "-12.3 dB" in reasons["diffuse"]
    assert "above -30 dB" in reasons["diffuse"]
    assert "-44.4 dB" in reasons["diffraction"]
    assert "within -30 dB" in reasons["diffraction"]
    assert reasons["refraction"] == "figures of refraction"


def test_a_user_s_own_choice_is_a_plan_too() -> None:
    chosen = EffectSet.of({"diffuse", "noise"})
    plan = by_choice("street", chosen)
    assert plan.effects == chosen
    assert [item.effect for item in plan.decisions] == list(CONTRACT)
    assert {item.evidence for item in plan.decisions} == {"--effects"}


def test_the_picture_of_a_plan_is_a_png_of_its_figures(tmp_path: Path) -> None:
    seconds = dict.fromkeys(NAMES, 0.1)
    draw(decide("one", evidence(diffuse=-3.0)), seconds, tmp_path / "one.png")
    draw(decide("one", evidence(diffuse=-60.0)), seconds, tmp_path / "other.png")
    one, other = ((tmp_path / name).read_bytes() for name in ("one.png", "other.png"))
    assert one.startswith(b"\x89PNG")
    assert one != other


# Evidence, and where it is kept


def a_probe(name: str = "target_80m", poses: tuple[Pose, ...] = (Pose((0.0, 0.0, 0.5)),), **radar: object) -> Probe:
    scene = open_scene(str(EFFECT_SCENES / f"{name}.usda"))
    materials = load_materials().map_materials([item.material for item in scene.objects])
    return Probe(stage_of(scene, materials), materials, poses, Radar(**radar), TraceSettings())


def test_a_probe_says_what_a_scene_lacks(variant: str) -> None:
    found = gather(a_probe()).evidence
    assert tuple(found) == NAMES
    for name in ("specular", "diffuse", "multi_bounce"):
        assert found[name] == Evidence(FLOOR_DB, "there is no surface")
    for name in ("doppler", "range_migration", "intra_chirp_motion"):
        assert found[name].text.startswith("nothing moves")
    assert found["diffraction"].text == "there is no edge"
    assert found["refraction"].change_db == FLOOR_DB
    assert found["rcs_targets"].change_db == pytest.approx(0.0, abs=1e-9)
    assert found["rcs_targets"].power_share == found["rcs_targets"].cell_share == 1.0
    assert gather(a_probe()).evidence == found


def test_a_probe_looks_at_the_radar_too(variant: str) -> None:
    isotropic = FrontEnd(tx_pattern=IsotropicPattern(), rx_pattern=IsotropicPattern())
    driving = (Pose((0.0, 0.0, 0.5), velocity=(5.0, 0.0, 0.0)),)
    found = gather(a_probe(poses=driving, front_end=isotropic, waveform=Waveform(chirps=1))).evidence
    assert found["antenna_pattern"].text == "the radar's elements are isotropic"
    assert found["doppler"].text == found["range_migration"].text == "the frame has one chirp"
    assert found["intra_chirp_motion"].change_db > -40.0


def test_a_scene_without_a_frame_is_not_judged() -> None:
    found = gather(a_probe(poses=())).evidence
    assert {item.text for item in found.values()} == {"no frame of the run stands in this scene"}
    assert decide("scene", found).effects.names == ()


def test_evidence_is_measured_once_and_the_same_from_the_cache(variant: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(planning, "user_cache", lambda: tmp_path / "first")
    said: list[str] = []
    probe = a_probe()
    measured = planning.gathered("content", probe, said.append)

    def unexpected(_: Probe) -> None:
        raise AssertionError("measured again")

    with monkeypatch.context() as patch:
        patch.setattr(planning, "gather", unexpected)
        kept = planning.gathered("content", probe, said.append)
        assert kept == measured
        assert decide("scene", kept) == decide("scene", measured)
        for other in (replace(probe, seed=1), replace(probe, poses=(Pose((0.0, 0.0, 0.6)),))):
            with pytest.raises(AssertionError, match="measured again"):
                planning.gathered("content", other, said.append)
        with pytest.raises(AssertionError, match="measured again"):
            planning.gathered("other content", probe, said.append)
    monkeypatch.setattr(planning, "user_cache", lambda: tmp_path / "second")
    assert planning.gathered("content", probe, said.append) == measured
    assert said == []


def test_damaged_evidence_is_measured_again(variant: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(planning, "user_cache", lambda: tmp_path)
    said: list[str] = []
    measured = planning.gathered("content", a_probe(), said.append)
    (file,) = (tmp_path / "effects").iterdir()
    file.write_text("{", encoding="utf-8")
    assert planning.gathered("content", a_probe(), said.append) == measured
    assert len(said) == 1
    assert file.name in said[0]


@pytest.mark.parametrize(
    ("own", "chosen"),
    [
        (range(0), ()),
        (range(5, 6), (5,)),
        (range(2), (0, 1)),
        (range(1, 100, 3), (1, 49, 97)),
        (range(9), (0, 4, 8)),
    ],
)
def test_frames_that_are_looked_at_are_spread_over_the_run(own: range, chosen: tuple[int, ...]) -> None:
    assert planning.looked_at(own) == chosen


# Time


def test_costs_are_differences_of_frames(monkeypatch) -> None:
    """By a clock of 1 s a frame and 0.5 s an effect, each costs half a second, and absent ones nothing."""
    asked: list[EffectSet] = []

    def frame_seconds(_: Probe, effects: EffectSet, *__: object) -> float:
        asked.append(effects)
        return 1.0 + 0.5 * len(effects.names)

    monkeypatch.setattr(timing, "frame_seconds", frame_seconds)
    found = evidence(specular=0.0, diffuse=-50.0, noise=0.0)
    probe = a_probe()
    planned = decide("scene", found).effects
    steps: list[tuple[int, int, str]] = []
    result = timing.costs(probe, planned, found, Processing(), lambda *step: steps.append(step))
    assert result == {name: 0.5 if name in ("specular", "diffuse", "noise") else 0.0 for name in NAMES}
    assert [step[0] for step in steps] == list(range(steps[0][1]))
    assert ALL in asked
    saved = timing.saving("scene", probe, planned, Processing())
    assert saved == timing.Saving("scene", 2.0, 1.0 + 0.5 * len(NAMES))
    assert timing.saving("scene", probe, ALL, Processing()) is None
