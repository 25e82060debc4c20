"""Hard cases of geometry: far from the origin, degenerate meshes, sensors where none should stand.

References are mirror images in closed form, or the same scene without what makes it hard.
"""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from hardcases.case import HardCase
from hardcases.tools import (
    MIRROR,
    UTM,
    frame_of,
    not_finite,
    not_finite_paths,
    read_back,
    small_radar,
    stage_of,
    traced,
    wall_ahead,
)
from oracles import relative_error
from sionna_scenes import plate
from small_radar import write_small_radar
from typer.testing import CliRunner

from datafactory.cli.app import app
from datafactory.paths.table import PathTable
from datafactory.scenes.poses import Pose
from datafactory.scenes.readers.common import Notes, place_mesh
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import SceneObject
from datafactory.synthesis.cube import cube_of_paths


def _specular_level_db(paths: PathTable, reference: PathTable) -> float:
    """Difference between the sums of specular amplitudes [dB]."""
    sums = [np.abs(table.specular.amplitude.sum()) for table in (paths, reference)]
    return abs(float(20.0 * np.log10(sums[0] / sums[1])))


def _diffuse_level_db(paths: PathTable, reference: PathTable) -> float:
    """Difference between the sums of diffuse power [dB]."""
    sums = [float((np.abs(table.scattered.amplitude) ** 2).sum()) for table in (paths, reference)]
    return abs(float(10.0 * np.log10(sums[0] / sums[1])))


def _far_away() -> float:
    """Error of a mirror's image [m] in a scene 5500 km from its origin, against the world's own plane."""
    wall = wall_ahead()
    paths = traced([replace(wall, vertices=wall.vertices + np.asarray(UTM))], Pose(UTM))
    return float(np.abs(paths.specular.image[0] - [20.0, 0.0, 0.0]).max())


def _millimetres() -> float:
    """Relative difference between the cubes of a wall given in millimetres and in metres."""
    wall, cubes = wall_ahead(), []
    for metres in (1.0, 0.001):
        (item,) = read_back({"wall": (wall.vertices, wall.triangles)}, metres)
        cubes.append(cube_of_paths(traced([replace(item, material=MIRROR)]), small_radar()))
    return relative_error(cubes[1], cubes[0])


def _unstated_units() -> float:
    """Readers of formats without units that do not remark on a street of 60 m given in millimetres."""
    street = trimesh.creation.box((60_000.0, 20_000.0, 10_000.0))
    silent = 0
    with tempfile.TemporaryDirectory() as folder:
        street.export(Path(folder) / "street.ply")
        street.export(Path(folder) / "street.obj")
        shape = '<shape type="ply"><string name="filename" value="street.ply"/></shape>'
        (Path(folder) / "street.xml").write_text(f'<scene version="3.0.0">{shape}</scene>', encoding="utf-8")
        for name in ("street.ply", "street.obj", "street.xml"):
            warnings = open_scene(str(Path(folder) / name)).warnings
            silent += not any("check its units" in warning for warning in warnings)
    return float(silent)


def _coarse_vertices() -> float:
    """Readers that do not give the figure for float32 vertices 500 km away, or give one where nothing is coarse.

    The same box stands far away in float32 numbers, then near its own origin under a float64 translation or in doubles.
    Stages of USD are told apart by ``tests/datafactory/scenes/test_scenes_usd.py``.
    """
    box = trimesh.creation.box((2.0, 2.0, 2.0))
    far = box.copy()
    far.apply_translation((500_000.0, 0.0, 0.0))
    wrong = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        far.export(folder / "far.ply")
        box.export(folder / "near.ply")
        far.export(folder / "doubles.obj")
        far.export(folder / "coarse.glb")
        trimesh.Scene([trimesh.Trimesh(box.vertices, box.faces)]).export(folder / "near.glb")
        for mesh in ("far", "near"):
            shift = '<transform name="to_world"><translate x="500000"/></transform>' if mesh == "near" else ""
            shape = f'<shape type="ply"><string name="filename" value="{mesh}.ply"/>{shift}</shape>'
            (folder / f"{mesh}.xml").write_text(f'<scene version="3.0.0">{shape}</scene>', encoding="utf-8")
        coarse = ("far.ply", "coarse.glb", "far.xml")
        for file in (*coarse, "near.ply", "near.glb", "near.xml", "doubles.obj"):
            said = any("31 mm apart" in warning for warning in open_scene(str(folder / file)).warnings)
            wrong += said != (file in coarse)
    return float(wrong)


def _degenerate_triangles() -> float:
    """Level error [dB] of a wall with zero-area triangles, needles and every vertex doubled, against the wall alone."""
    wall = wall_ahead(material="rough")
    n = len(wall.vertices)
    vertices = np.concatenate([wall.vertices, wall.vertices, [[10.0, 0.0, 0.0], [10.0, 1.0, 0.0], [10.0, 2.0, 0.0]]])
    needle = [[10.0, -20.0, 1.0], [10.0, 20.0, 1.0], [10.0, 0.0, 1.0 + 1e-9]]
    vertices = np.concatenate([vertices, needle])
    extra = [[0, 0, 1], [2 * n, 2 * n + 1, 2 * n + 2], [0, n, 1], [2 * n + 3, 2 * n + 4, 2 * n + 5]]
    triangles = np.concatenate([wall.triangles[:1], wall.triangles[1:] + n, extra])
    notes = Notes()
    vertices, kept, _ = place_mesh(vertices, triangles, np.eye(4), notes)
    if notes.sentences() != ("3 triangles without area dropped",):  # the needle has an area, and is traced
        return np.inf
    return _diffuse_level_db(traced([replace(wall, vertices=vertices, triangles=kept)]), traced([wall]))


def _thin_triangles() -> float:
    """Level error [dB] of a wall cut into 2000 slivers of 60 m by 3 cm, against the wall alone."""
    wall, strips = wall_ahead(material="rough"), 1000
    y = np.linspace(-30.0, 30.0, strips + 1)
    low = np.stack([np.full_like(y, 10.0), y, np.full_like(y, -30.0)], axis=1)
    high = low + np.array([0.0, 0.0, 60.0])
    i, n = np.arange(strips), strips + 1
    triangles = np.concatenate(
        [np.stack([i, i + 1, n + i + 1], axis=1), np.stack([i, n + i + 1, n + i], axis=1)]
    ).astype(np.int32)
    return _diffuse_level_db(
        traced([replace(wall, vertices=np.concatenate([low, high]), triangles=triangles)]), traced([wall])
    )


def _walls(hard: Callable[[SceneObject, SceneObject], list[SceneObject]]) -> float:
    """Level error [dB] of what is made of a wall and the same with its normals turned, mirror and rough."""
    errors = []
    for material, compare in ((MIRROR, _specular_level_db), ("rough", _diffuse_level_db)):
        wall = wall_ahead(material=material)
        away = replace(wall, name="back", triangles=wall.triangles[:, ::-1].copy())
        errors.append(compare(traced(hard(wall, away)), traced([wall])))
    return max(errors)


def _misplaced_sensor(objects: Sequence[SceneObject], depth: int = 3) -> float:
    """Values not finite in the paths and the frame of a sensor where none should stand, with a wall 10 m ahead."""
    paths = traced([*objects, wall_ahead()], depth=depth)
    if not len(paths.specular):
        return np.inf
    radar = small_radar()
    frame = frame_of(paths.within(radar).illuminated(radar.front_end), radar)
    return float(not_finite_paths(paths) + not_finite(frame))


def _utm_command() -> float:
    """Exit status of a whole run on a scene at UTM coordinates, its poses drawn by the program."""
    ground = plate("ground", (0.0, 0.0, 0.0), (30.0, 0.0, 0.0), (0.0, 30.0, 0.0), MIRROR)
    house = plate("house", (12.0, 0.0, 3.0), (0.0, 20.0, 0.0), (0.0, 0.0, 3.0), MIRROR)
    with tempfile.TemporaryDirectory() as name:
        scene = Path(name) / "utm.usda"
        meshes = {item.name: (item.vertices, item.triangles) for item in (ground, house)}
        scene.write_text(stage_of(meshes, offset=UTM), encoding="utf-8")
        few = ("--radar", write_small_radar(Path(name)), "--frames", 1, "--rays", 2000, "--workers", 1)
        done = CliRunner().invoke(app, [*map(str, ("render", scene, *few, "--out", Path(name) / "data"))])
    return float(done.exit_code) if not done.stderr.strip() else np.inf


FLOOR = plate("floor", (0.0, 0.0, 0.0), (30.0, 0.0, 0.0), (0.0, 30.0, 0.0), "rough")
AHEAD = plate("ahead", (30.0, 0.0, 0.0), (30.0, 0.0, 0.0), (0.0, 30.0, 0.0), "rough")
AROUND = (wall_ahead(0.05, "rough", "front"), wall_ahead(-0.05, "rough", "rear"))

CASES = (
    HardCase("scene at UTM coordinates", "float32 coordinates are half a metre apart", 1e-5, "m", _far_away),
    HardCase("UTM scene, whole run", "ground search and poses far from 0", 0.0, "exit status", _utm_command),
    HardCase("float32 vertices 500 km away", "3 cm apart, silently", 0.0, "wrong remarks", _coarse_vertices),
    HardCase("scene in millimetres", "sizes and epsilons in metres", 1e-5, "relative", _millimetres),
    HardCase("millimetres without a unit", "a thousandfold scene, silently", 0.0, "silent readers", _unstated_units),
    HardCase("zero areas, needles, double vertices", "normals of no length", 0.01, "dB", _degenerate_triangles),
    HardCase("slivers of 60 m by 6 cm", "rays slip between triangles", 0.05, "dB", _thin_triangles),
    HardCase("flipped normals", "one-sided reflection", 1e-4, "dB", lambda: _walls(lambda _, away: [away])),
    HardCase("coplanar facing walls", "an echo counted twice", 1e-3, "dB", lambda: _walls(lambda *both: list(both))),
    HardCase("sensor inside a wall", "segments of centimetres", 0.0, "not finite", lambda: _misplaced_sensor(AROUND)),
    HardCase("sensor on a surface", "a ray of length 0", 0.0, "not finite", lambda: _misplaced_sensor([FLOOR])),
    HardCase("sensor touching an edge", "as above, at an edge", 0.0, "not finite", lambda: _misplaced_sensor([AHEAD])),
)  # fmt: skip
