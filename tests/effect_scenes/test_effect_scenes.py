"""The effect scenes: reproducible bytes, and the geometry that ``expected.json`` rests on.

The tracer is not used: whether a face mirrors, an edge sends back, a wedge hides or a pane is crossed is decided here
by plane geometry alone.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from itertools import pairwise, permutations
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from prepared_scenes import EFFECT_SCENES as EFFECTS

from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose, read_poses
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from shared.radar import Radar

EXPECTED: dict[str, Any] = json.loads((Path(__file__).parent / "expected.json").read_text(encoding="utf-8"))["scenes"]

ONE_MIRROR = {"wall", "plate", "reflector_behind_pane", "moving_ego"}
"""Scenes with a face that mirrors the radar to itself."""
EDGES_SEND_BACK = {
    "wall", "plate", "dihedral", "square_corner", "reflector_behind_pane", "target_behind_pane", "corner",
}  # fmt: skip
"""Scenes with an edge that the line of sight meets at a right angle."""


@pytest.fixture(scope="module")
def make_effects() -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(EFFECTS.parent))
        import make_effects

        yield make_effects


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


def test_the_committed_files_are_what_the_script_writes(make_effects: ModuleType, tmp_path: Path) -> None:
    make_effects.write_effects(tmp_path)
    written = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    committed = {path.name: path.read_bytes() for path in EFFECTS.iterdir()}
    assert written.keys() == committed.keys()
    assert [name for name in written if written[name] != committed[name]] == []


def test_the_scenes_are_those_written_down(make_effects: ModuleType) -> None:
    shows = {name: said["shows"] for name, said in EXPECTED.items()}
    assert list(shows.items()) == [(scene.name, scene.shows) for scene in make_effects.scenes()]


@pytest.mark.parametrize("name", EXPECTED)
def test_a_scene_opens_as_it_was_meant(name: str) -> None:
    """Without a remark but that pictures of point targets are not traced, its materials by their own names."""
    scene, table = scene_of(name), load_materials()
    assert {table.lookup(item.material)[1] for item in scene.objects} <= {"name"}
    pictures = [warning for warning in scene.warnings if "a point target (radar:rcs_dbsm) stands for them" in warning]
    assert list(scene.warnings) == pictures
    assert len(pictures) == (name in ("trihedral", "target_behind_pane", "moving_car"))


@pytest.mark.parametrize("name", EXPECTED)
def test_poses_stand_half_a_metre_high_and_look_ahead(name: str) -> None:
    poses = poses_of(name)
    assert len({pose.position for pose in poses}) == len(poses) == 3
    for pose in poses:
        assert pose.position[1:] == (0.0, 0.5)
        assert -1.0 <= pose.position[0] <= 1.1
        assert abs(pose.yaw_deg) <= 2.0


def test_driving_poses_lie_on_one_course() -> None:
    for before, after in pairwise(poses_of("moving_ego")):
        travelled = after.position[0] - before.position[0]
        assert travelled == pytest.approx(before.velocity[0] * (after.time_s - before.time_s), rel=1e-9)


@pytest.mark.parametrize("name", EXPECTED)
def test_structural_facts(name: str) -> None:
    """What is absent or present by construction, read from the opened scene and not from the script."""
    scene, effects = scene_of(name), set(EXPECTED[name]["effects"])
    assert ("rcs_targets" in effects) == bool(scene.targets)
    velocities = [pose.velocity for pose in poses_of(name)] + [target.velocity for target in scene.targets]
    assert ("doppler" in effects) == any(any(velocity) for velocity in velocities)
    assert ("refraction" in effects) == any(item.material in ("glass", "acrylic") for item in scene.objects)
    assert scene.objects or not effects & {"specular", "diffuse", "multi_bounce", "diffraction", "corners"}


@pytest.mark.parametrize("name", EXPECTED)
def test_faces_that_mirror_and_edges_that_send_back(name: str) -> None:
    scene = scene_of(name)
    triangles, edges = triangles_of(scene), sharp_edges(scene)
    for pose in poses_of(name):
        sensor = np.array(pose.position)
        assert feet(triangles, sensor).any() == (name in ONE_MIRROR)
        assert any(sends_back(edge, sensor) for edge in edges) == (name in EDGES_SEND_BACK)


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
