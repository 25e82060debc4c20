"""The effect scenes: reproducible bytes, what stands in them, and the geometry that their expectations rest on.

The tracer is not used: whether a face mirrors, an edge sends back, a wedge hides or a pane is crossed is decided here
by plane geometry alone.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator
from itertools import pairwise, permutations
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from effect_scenes import levels
from effect_scenes.write_expected import EXPECTED, described, write_expected
from numpy.typing import NDArray

from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose, read_poses
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar
from shared.signal import round_trip_delays

SCENES = Path(__file__).resolve().parents[2] / "scenes"
EFFECTS = SCENES / "effects"

# Scene: materials of its objects; point targets as (position, RCS [dBsm], velocity); the radar's speed [m/s].
CONTENT: dict[str, tuple[tuple[str, ...], tuple[tuple[Any, float, Any], ...], float]] = {
    "wall": (("concrete",), (), 0.0),
    "plate": (("metal",), (), 0.0),
    "dihedral": (("metal",), (), 0.0),
    "square_corner": (("metal",), (), 0.0),
    "three_faces": (("metal",), (), 0.0),
    "trihedral": ((), (((60.0, 0.0, 0.5), 26.51, (0.0, 0.0, 0.0)),), 0.0),
    "reflector_behind_pane": (("glass", "metal"), (), 0.0),
    "target_behind_pane": (("acrylic",), (((60.0, 0.0, 0.5), 26.51, (0.0, 0.0, 0.0)),), 0.0),
    "corner": (("concrete",), (((60.0, 0.27, 0.5), 24.7, (0.0, 0.0, 0.0)),), 0.0),
    "parked_car": (("metal",), (), 0.0),
    "moving_car": ((), (((36.0, 0.0, 0.5), 14.6, (11.0, 0.0, 0.0)),), 0.0),
    "creeping_target": ((), (((60.0, 0.0, 0.5), -1.4, (-0.1, 0.0, 0.0)),), 0.0),
    "moving_ego": (("asphalt", "concrete", "concrete", "metal", "metal"), (), 11.0),
    "target_1m": ((), (((1.0, 0.0, 0.5), -29.0, (0.0, 0.0, 0.0)),), 0.0),
    "target_80m": ((), (((80.0, 0.0, 0.5), -1.4, (0.0, 0.0, 0.0)),), 0.0),
    "empty_field": (("vegetation",), (), 0.0),
}

# Written down once more, by hand: what expected.json must say.
CALLED_FOR = {
    "wall": "specular diffuse diffraction",
    "plate": "specular diffuse diffraction",
    "dihedral": "specular diffuse multi_bounce diffraction",
    "square_corner": "specular diffuse multi_bounce diffraction corners",
    "three_faces": "specular diffuse multi_bounce diffraction corners",
    "trihedral": "rcs_targets",
    "reflector_behind_pane": "specular diffuse refraction diffraction",
    "target_behind_pane": "diffuse refraction diffraction rcs_targets",
    "corner": "diffuse diffraction rcs_targets",
    "parked_car": "diffuse diffraction",
    "moving_car": "doppler range_migration intra_chirp_motion rcs_targets",
    "creeping_target": "doppler range_migration intra_chirp_motion rcs_targets",
    "moving_ego": "specular diffuse multi_bounce diffraction doppler range_migration intra_chirp_motion",
    "target_1m": "rcs_targets",
    "target_80m": "rcs_targets",
    "empty_field": "diffuse",
}
"""Beside what is always there: near field, patterns, noise."""

ONE_MIRROR = {"wall", "plate", "reflector_behind_pane", "moving_ego"}
EDGES_SEND_BACK = {
    "wall", "plate", "dihedral", "square_corner", "reflector_behind_pane", "target_behind_pane", "corner",
}  # fmt: skip
"""Scenes with such edges."""


@pytest.fixture(scope="module")
def make_effects() -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(SCENES))
        import make_effects

        yield make_effects


@pytest.fixture(scope="module")
def expected() -> dict[str, Any]:
    return json.loads(EXPECTED.read_text(encoding="utf-8"))


def scene_of(name: str) -> Scene:
    return open_scene(str(EFFECTS / f"{name}.usda"))


def poses_of(name: str) -> tuple[Pose, ...]:
    return read_poses(EFFECTS / f"{name}.poses.json")


def triangles_of(scene: Scene) -> NDArray[np.float64]:
    """[T, 3, 3] corners [m]."""
    parts = [item.vertices[item.triangles] for item in scene.objects]
    return np.concatenate([np.zeros((0, 3, 3)), *parts])


def inside(triangles: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """[T] whether the point [T, 3] in each triangle's plane lies within it, its outline included."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    normal = np.cross(b - a, c - a)
    sides = [np.einsum("ti,ti->t", np.cross(q - p, points - p), normal) for p, q in ((a, b), (b, c), (c, a))]
    return np.all(np.stack(sides) >= -1e-9 * np.einsum("ti,ti->t", normal, normal), axis=0)


def feet(triangles: NDArray[np.float64], sensor: NDArray[np.float64]) -> NDArray[np.bool_]:
    """[T] whether the perpendicular from the sensor meets the triangle: there it mirrors the radar to itself."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    height = np.einsum("ti,ti->t", sensor - triangles[:, 0], normal)
    return inside(triangles, sensor - height[:, None] * normal)


def crossings(triangles: NDArray[np.float64], start: NDArray[np.float64], stop: NDArray[np.float64]) -> int:
    """Number of plane faces that the straight line crosses; a hit on the diagonal of a quadrilateral counts once."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    along = normal @ (stop - start)
    where = np.einsum("ti,ti->t", triangles[:, 0] - start, normal) / np.where(along == 0.0, np.inf, along)
    hit = (where > 1e-9) & (where < 1.0 - 1e-9)
    hit &= inside(triangles, start + where[:, None] * (stop - start))
    return len(np.unique(np.round(where[hit], 9)))


def sharp_edges(scene: Scene) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Edges of one face alone, or between faces of different planes, as their two ends [m]."""
    found: dict[tuple, list[NDArray[np.float64]]] = {}
    for triangle in triangles_of(scene):
        normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        for a, b in ((0, 1), (1, 2), (2, 0)):
            ends = tuple(sorted(tuple(np.round(triangle[i], 4).tolist()) for i in (a, b)))
            found.setdefault(ends, []).append(normal / np.linalg.norm(normal))
    flat = [ends for ends, normals in found.items() if len(normals) == 2 and abs(normals[0] @ normals[1]) > 1.0 - 1e-9]
    return [(np.array(a), np.array(b)) for a, b in found if (a, b) not in set(flat)]


def sends_back(edge: tuple[NDArray[np.float64], NDArray[np.float64]], sensor: NDArray[np.float64]) -> bool:
    """Whether the line of sight meets the edge at a right angle, ahead of the sensor and within its range.

    Keller's cone has the angle of incidence: the way back lies on it only at 90 degrees.
    """
    start, stop = edge
    share = (sensor - start) @ (stop - start) / ((stop - start) @ (stop - start))
    point = start + share * (stop - start)
    reach = Radar().waveform.ranges_m[-1]
    return bool(0.0 <= share <= 1.0 and point[0] > sensor[0] and np.linalg.norm(point - sensor) < reach)


def test_the_expectations_are_what_their_script_writes(tmp_path: Path) -> None:
    write_expected(tmp_path / "expected.json")
    assert (tmp_path / "expected.json").read_bytes() == EXPECTED.read_bytes()


def test_the_committed_files_are_what_the_script_writes(make_effects: ModuleType, tmp_path: Path) -> None:
    make_effects.write_effects(tmp_path)
    written = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    committed = {path.name: path.read_bytes() for path in EFFECTS.iterdir()}
    assert written.keys() == committed.keys()
    assert [name for name in written if written[name] != committed[name]] == []


def test_the_scenes_are_those_listed(expected: dict[str, Any], make_effects: ModuleType) -> None:
    assert {path.stem for path in EFFECTS.glob("*.usda")} == set(CONTENT) == set(expected["scenes"]) == set(CALLED_FOR)
    assert list(expected["scenes"]) == [scene.name for scene in make_effects.scenes()]
    assert described(EFFECTS) == {scene.name: scene.shows for scene in make_effects.scenes()}


@pytest.mark.parametrize("name", CONTENT)
def test_a_scene_holds_what_it_should(name: str) -> None:
    materials, targets, _ = CONTENT[name]
    scene = scene_of(name)
    assert tuple(item.material for item in scene.objects) == materials
    assert not any(item.moves for item in scene.objects)
    assert [(target.position, target.velocity) for target in scene.targets] == [(item[0], item[2]) for item in targets]
    assert [target.rcs_dbsm for target in scene.targets] == pytest.approx([item[1] for item in targets], abs=1e-6)
    assert scene.triangle_count <= 60
    pictures = [warning for warning in scene.warnings if "a point target (radar:rcs_dbsm) stands for them" in warning]
    assert list(scene.warnings) == pictures
    assert len(pictures) == (name in ("trihedral", "target_behind_pane", "moving_car"))


def test_every_material_is_in_the_table_by_its_own_name() -> None:
    table = load_materials()
    named = {item.material for name in CONTENT for item in scene_of(name).objects}
    assert {table.lookup(name)[1] for name in named} == {"name"}


@pytest.mark.parametrize("name", CONTENT)
def test_poses_stand_half_a_metre_high_and_look_ahead(name: str) -> None:
    poses = poses_of(name)
    assert len(poses) == 3
    assert len({pose.position for pose in poses}) == 3
    for pose in poses:
        assert pose.position[1:] == (0.0, 0.5)
        assert -1.0 <= pose.position[0] <= 1.1
        assert abs(pose.yaw_deg) <= 2.0
        assert pose.velocity == (CONTENT[name][2], 0.0, 0.0)


def test_driving_poses_lie_on_one_course() -> None:
    for before, after in pairwise(poses_of("moving_ego")):
        travelled = after.position[0] - before.position[0]
        assert travelled == pytest.approx(before.velocity[0] * (after.time_s - before.time_s), rel=1e-9)


def test_nothing_that_moves_leaves_the_radar_s_unambiguous_velocities() -> None:
    limit = Radar().waveform.wavelength_m / (4.0 * Radar().waveform.chirp_interval_s)
    for name, (_, targets, ego) in CONTENT.items():
        speeds = [float(np.linalg.norm(velocity)) for _, _, velocity in targets]
        assert max([ego, *speeds]) < limit, name


@pytest.mark.parametrize("name", CONTENT)
def test_the_effects_called_for(name: str, expected: dict[str, Any]) -> None:
    said = expected["scenes"][name]
    always = {"near_field", "antenna_pattern", "noise"}
    assert [effect for effect in said["effects"] if effect not in always] == CALLED_FOR[name].split()
    assert always < set(said["effects"])
    assert list(said["reasons"]) == list(expected["rules"])


DECIDED = ("multi_bounce", "refraction", "diffraction", "corners", "rcs_targets", "doppler")


@pytest.mark.parametrize("name", CONTENT)
def test_no_effect_stands_near_the_limit(name: str, expected: dict[str, Any]) -> None:
    """By 5 dB of the budget, by 3 dB of the frame's own limit: the edges of two scenes stand 3.6 dB above that."""
    said = expected["scenes"][name]
    for effect, reason in said["reasons"].items():
        change = reason["change_db"]
        if effect in DECIDED and change is not None and said["limit_db"] is not None and not reason["more"]:
            assert (effect in said["effects"]) == (change > said["limit_db"]), effect
            assert abs(change - said["limit_db"]) > 3.0, effect
        assert change is None or abs(change - expected["budget_db"]) > 5.0, effect
        assert reason["reason"]
        assert "\n" not in reason["reason"]


@pytest.mark.parametrize("name", CONTENT)
def test_structural_facts(name: str, expected: dict[str, Any]) -> None:
    """What is absent or present by construction, read from the opened scene and not from the script."""
    scene, effects = scene_of(name), set(expected["scenes"][name]["effects"])
    assert ("rcs_targets" in effects) == bool(scene.targets)
    moves = any(any(pose.velocity) for pose in poses_of(name)) or any(any(item.velocity) for item in scene.targets)
    assert ("doppler" in effects) == moves
    assert ("refraction" in effects) == any(item.material in ("glass", "acrylic") for item in scene.objects)
    assert scene.objects or not effects & {"specular", "diffuse", "multi_bounce", "diffraction", "corners"}


@pytest.mark.parametrize("name", [name for name in CONTENT if CONTENT[name][0]])
def test_faces_that_mirror_the_radar_to_itself(name: str) -> None:
    triangles = triangles_of(scene_of(name))
    mirrors = {bool(feet(triangles, np.array(pose.position)).any()) for pose in poses_of(name)}
    assert mirrors == {name in ONE_MIRROR}


@pytest.mark.parametrize("name", [name for name in CONTENT if CONTENT[name][0]])
def test_edges_that_send_back(name: str) -> None:
    edges = sharp_edges(scene_of(name))
    found = {any(sends_back(edge, np.array(pose.position)) for edge in edges) for pose in poses_of(name)}
    assert found == {name in EDGES_SEND_BACK}


def test_the_dihedral_is_seen_by_two_bounces_each_way_round() -> None:
    """Image method: the radar mirrored in one face and then in the other is seen through both."""
    faces = triangles_of(scene_of("dihedral")).reshape(2, 2, 3, 3)
    for pose in poses_of("dihedral"):
        sensor = np.array(pose.position)
        apex = 60.0 - sensor[0]
        for first, second in permutations((0, 1)):
            images = [sensor]
            for face in (faces[first], faces[second]):
                normal = np.cross(face[0, 1] - face[0, 0], face[0, 2] - face[0, 0])
                normal /= np.linalg.norm(normal)
                images.append(images[-1] - 2.0 * ((images[-1] - face[0, 0]) @ normal) * normal)
            seen = images[2] - sensor
            assert np.linalg.norm(seen) / 2.0 == pytest.approx(apex * math.cos(math.radians(5.0)), rel=1e-5)
            # The same after a turn about the vertical: the line from the image crosses the second face, and from there
            # the line to the first image crosses the first.
            assert crossings(faces[second], sensor, images[2]) == 1
            normal = np.cross(*(faces[second][0, i] - faces[second][0, 0] for i in (1, 2)))
            share = ((faces[second][0, 0] - sensor) @ normal) / (seen @ normal)
            assert crossings(faces[first], sensor + share * seen, images[1]) == 1


@pytest.mark.parametrize("name", ["reflector_behind_pane", "target_behind_pane"])
def test_a_pane_is_one_sheet_across_the_line_of_sight(name: str) -> None:
    scene = scene_of(name)
    pane = next(item for item in scene.objects if item.material in ("glass", "acrylic"))
    for pose in poses_of(name):
        behind = np.array(scene.targets[0].position if scene.targets else (80.0, 0.0, 0.5))
        assert crossings(pane.vertices[pane.triangles], np.array(pose.position), behind) == 1


def test_the_glass_front_covers_the_reflector() -> None:
    pane, reflector = scene_of("reflector_behind_pane").objects
    for pose in poses_of("reflector_behind_pane"):
        for corner in reflector.vertices:
            assert crossings(pane.vertices[pane.triangles], np.array(pose.position), corner) == 1


def test_the_hidden_target_is_just_behind_the_edge() -> None:
    scene = scene_of("corner")
    target = np.array(scene.targets[0].position)
    edge = np.array([30.0, 0.0, 0.5])
    back = [item for item in sharp_edges(scene) if sends_back(item, np.array([0.0, 0.0, 0.5]))]
    assert any(np.allclose(start[:2], edge[:2]) and np.allclose(stop[:2], edge[:2]) for start, stop in back)
    for pose in poses_of("corner"):
        sensor = np.array(pose.position)
        assert crossings(triangles_of(scene), sensor, target) == 2  # in at the front, out at the back
        beside = edge - [0.0, 1e-3, 0.0]
        assert crossings(triangles_of(scene), sensor, beside) == crossings(triangles_of(scene), beside, target) == 0


def test_a_target_that_hides_nothing_is_in_plain_sight() -> None:
    counts = Counter({name: len(scene_of(name).objects) for name in CONTENT if CONTENT[name][1]})
    assert {name for name, count in counts.items() if count} == {"target_behind_pane", "corner"}


def test_levels_of_mirrors_and_points_agree_with_the_image() -> None:
    """The image of the radar 2 R away: P_t G^2 (lambda / (8 pi R))^2, for any R."""
    front_end = Radar().front_end
    gain = float(front_end.tx_pattern.power_gain(np.array([1.0, 0.0, 0.0])))
    for range_m in (0.5, 60.0):
        image = front_end.transmit_power_w * (gain * Radar().waveform.wavelength_m / (8.0 * math.pi * range_m)) ** 2
        level = levels.point_dbw(range_m, levels.plane_rcs_dbsm(range_m))
        assert level == pytest.approx(10.0 * math.log10(image), abs=1e-9)


def test_the_near_field_change_is_that_of_exact_delays() -> None:
    """Against the slow reference's delays, at boresight where the plane wave has none: largest at the array's ends."""
    radar = Radar()
    delays = round_trip_delays(radar, np.array([80.0, 0.0, 0.0]), np.zeros(3))[:, 0]
    phase = 2.0 * math.pi * radar.waveform.mid_sweep_hz * (delays - 160.0 / SPEED_OF_LIGHT)
    signal = np.exp(1j * phase)
    mean = signal.mean()
    bound = 20.0 * math.log10(np.abs(signal - mean / abs(mean)).mean())  # a sum is at most the sum of magnitudes
    assert bound - 6.0 < levels.near_field_change_db(80.0) < bound
    ranges = [1.0, 5.0, 20.0, 80.0]
    changes = [levels.near_field_change_db(range_m) for range_m in ranges]
    assert changes == sorted(changes, reverse=True)
    # The error is a quadratic phase, proportional to 1 / R where it is small.
    assert changes[2] - changes[3] == pytest.approx(20.0 * math.log10(4.0), abs=0.1)


def test_changes_by_motion_have_their_limits() -> None:
    """Small phases: the change is proportional to the speed; half a Doppler bin and more changes everything."""
    for change in (levels.doppler_change_db, levels.migration_change_db, levels.intra_chirp_change_db):
        assert change(2e-3) - change(1e-3) == pytest.approx(20.0 * math.log10(2.0), abs=0.01)
    assert levels.doppler_change_db(5.0) == pytest.approx(0.0, abs=0.2)


def test_shadow_pane_and_edge_have_their_limits() -> None:
    assert levels.shadow_db(0.0, 30.0, 30.0) == pytest.approx(-20.0 * math.log10(2.0), abs=1e-9)
    assert levels.shadow_db(-5.0, 30.0, 30.0) == pytest.approx(0.0, abs=0.2)
    # ITU-R P.526-15 eq. (31), good to 0.1 dB for nu > -0.78: nu = sqrt(2) where clearance^2 = lambda d1 d2 / (d1 + d2).
    clearance = math.sqrt(levels.WAVELENGTH_M * 15.0)
    approximate = 6.9 + 20.0 * math.log10(math.hypot(math.sqrt(2.0) - 0.1, 1.0) + math.sqrt(2.0) - 0.1)
    assert levels.shadow_db(clearance, 30.0, 30.0) == pytest.approx(-approximate, abs=0.1)
    assert levels.pane_db("concrete", 30.0) < -100.0
    assert -2.0 < levels.pane_db("acrylic", 30.0) < 0.0
    # No wedge at all: an exterior angle of 180 deg without a reflection boundary nearby sends nothing back.
    assert levels.edge_rcs_dbsm(60.0, 1.0, 45.0, 1.0) < -200.0
