"""Rolling wheels: kinematics, Doppler spectrum, which of them a radar sees, how files and scenes ask for them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from usd_files import read

from datafactory.frame.points import read_targets
from datafactory.scenes.scene import PointTarget
from datafactory.scenes.targets.bodies import Motion
from datafactory.scenes.targets.models import POINTS, Car, Cyclist, Pedestrian, options_of, rolling_wheels, target_model
from datafactory.synthesis.cube import cube_of_paths
from shared.radar import Radar
from shared.signal.spectrum import range_doppler

RADIUS_M = 0.32
HUBS = np.array([[1.4, 0.8, RADIUS_M], [-1.4, 0.8, RADIUS_M]])
ONE = np.ones(2)


def test_the_rim_rolls_without_slip() -> None:
    """Velocities are differences of places, 0 where the wheel touches the ground and 2 v at the top."""
    speed, step = 9.0, 1e-6
    before, now, after = (rolling_wheels(HUBS, RADIUS_M, ONE, Motion(speed, 0.7 + t, 5)) for t in (-step, 0.0, step))
    np.testing.assert_allclose(now.velocity, (after.position - before.position) / (2.0 * step), atol=1e-5)
    over_ground = now.velocity + np.array([speed, 0.0, 0.0])
    height = now.position[:, 2] / (2.0 * RADIUS_M)
    np.testing.assert_allclose(np.linalg.norm(over_ground, axis=1), 2.0 * speed * np.sqrt(height), atol=1e-9)
    np.testing.assert_allclose(over_ground[:, 0], 2.0 * speed * height, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(now.position - np.repeat(HUBS, POINTS, axis=0), axis=1), RADIUS_M)


def spectrum_of(tmp_path: Path, *entries: dict[str, object], seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Velocity axis [m/s] and power over it of what a file of targets gives, summed over range and channels."""
    file = tmp_path / "targets.json"
    file.write_text(json.dumps([list(entries)]))
    (targets,) = read_targets(file)
    full = Radar()
    waveform = full.waveform.model_copy(update={"samples": 256, "range_bins": 256})
    radar = full.model_copy(update={"waveform": waveform})
    spectra = range_doppler(cube_of_paths(targets.echo_points(radar, seed).path_table(radar), radar, 1e-4), radar)
    return waveform.velocities_mps, (np.abs(spectra) ** 2).sum(axis=(0, 2))


def test_the_spectrum_of_a_wheel_reaches_from_rest_to_twice_the_speed(tmp_path: Path) -> None:
    """A bicycle that drives away along the line of sight: support 0 to 2 v, mean v."""
    speed = 4.0
    entry = {"x": 20.0, "y": 0.0, "vx": speed, "model": "cyclist", "wheel_radius_m": 0.35}
    velocity, power = spectrum_of(tmp_path, entry)
    cell = float(velocity[1] - velocity[0])
    within = (velocity > -2.0 * cell) & (velocity < 2.0 * speed + 2.0 * cell)
    assert power[~within].sum() / power.sum() < 1e-4
    rising = np.cumsum(power) / power.sum()
    lowest, highest = np.interp([0.02, 0.98], rising, velocity)
    assert lowest < 0.15 * speed
    assert highest > 1.85 * speed
    # Of each wheel 24 points at random angles: their mean is off by v / sqrt(2 x 48), over six seeds by 0.04 v.
    means = [np.average(velocity, weights=spectrum_of(tmp_path, entry, seed=seed)[1]) for seed in range(6)]
    assert np.mean(means) == pytest.approx(speed, abs=0.12 * speed)
    rigid = spectrum_of(tmp_path, {**{k: v for k, v in entry.items() if k != "wheel_radius_m"}})
    spread = [np.sqrt((p * (v - speed) ** 2).sum() / p.sum()) for v, p in ((velocity, power), rigid)]
    assert spread[1] < cell
    assert spread[0] > 0.4 * speed


def test_what_is_low_is_hidden() -> None:
    parts = rolling_wheels(HUBS, RADIUS_M, ONE, Motion(9.0, 0.1, 5), hidden_below_m=0.2)
    assert ((parts.position[:, 2] < 0.2) == (parts.rcs_m2 == 0.0)).all()
    assert 0 < (parts.rcs_m2 == 0.0).sum() < len(parts.rcs_m2) / 2


@pytest.mark.parametrize(("radar", "heard"), [((15.0, 0.0, 0.5), (0, 1)), ((-15.0, 0.5, 0.5), (2, 3)),
                                              ((2.0, 9.0, 0.5), (0, 2)), ((2.0, -9.0, 0.5), (1, 3))])  # fmt: skip
def test_a_car_shows_the_wheels_on_the_radars_side(radar: tuple[float, float, float], heard: tuple[int, int]) -> None:
    parts = Car(RADIUS_M).parts(np.array(radar), Motion(9.0))
    level = parts.rcs_m2.reshape(4, POINTS).sum(axis=1)
    assert tuple(np.flatnonzero(level)) == heard
    np.testing.assert_allclose(level[list(heard)], 0.1)


def test_a_bicycles_wheels_keep_its_level() -> None:
    radar = np.array([3.0, 12.0, 0.5])
    rigid = Cyclist().echoes(radar, 4e-3)[1].sum()
    turning = Cyclist(0.35)
    assert turning.echoes(radar, 4e-3)[1].sum() + turning.parts(radar, Motion(5.0)).rcs_m2.sum() == pytest.approx(rigid)


def test_options_are_off_unless_stated() -> None:
    assert [repr(model) for model in (Car(), Cyclist(), Pedestrian())] == ["Car()", "Cyclist()", "Pedestrian()"]
    assert target_model("car", {"wheel_radius_m": 0.3}) == Car(0.3)
    assert set(options_of("car")) == {"wheel_radius_m", "wheel_hidden_below_m"}


def test_a_scene_states_options_as_attributes(tmp_path: Path) -> None:
    scene = read(
        tmp_path,
        """def Xform "car" {
            custom string radar:target = "car"
            custom double radar:wheel_radius_m = 0.31
            custom double3 radar:velocity = (8, 0, 0)
        }
        def Xform "walker" {
            custom string radar:target = "pedestrian"
            custom float radar:stature_m = 1.75
            custom float radar:gait_phase = 0.25
            custom double3 radar:velocity = (1.4, 0, 0)
        }""",
    )
    assert [target.model for target in scene.targets] == [Car(0.31), Pedestrian(1.75, 0.25)]
    stated = [replace(target, model=Pedestrian()) for target in scene.targets]
    assert replace(scene, targets=tuple(stated)).content_hash() != scene.content_hash()


def test_a_file_of_targets_may_name_models(tmp_path: Path) -> None:
    entries = [
        {"x": 9.0, "y": 1.0, "z": -0.5, "vx": -1.2, "vy": 0.5, "model": "pedestrian", "stature_m": 1.75},
        {"x": 5.0, "y": 0.0, "rcs_dbsm": 3.0},
        {"x": 20.0, "y": 0.0, "model": "trihedral", "edge_m": 0.1, "heading_deg": 180},
    ]
    (tmp_path / "targets.json").write_text(json.dumps([entries]))
    (targets,) = read_targets(tmp_path / "targets.json")
    assert len(targets.position) == 1
    human, corner = targets.models
    assert isinstance(human, PointTarget)
    np.testing.assert_allclose(human.axes[0], [-12.0 / 13.0, 5.0 / 13.0, 0.0])
    radar = Radar()
    placed = targets.echo_points(radar, 7)
    assert len(placed.position) == 1 + 16 + 1
    assert placed.position.tobytes() == targets.echo_points(radar, 7).position.tobytes()
    assert placed.position.tobytes() != targets.echo_points(radar, 8).position.tobytes()
    assert len(placed.truth(radar)) == 18
    assert corner.axes[0][0] == -1.0
