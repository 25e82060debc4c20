"""One scene written with X, Y or Z up, in metres or centimetres: the radar sees the same paths in each.

The scene has what effects are made of: rough ground, a wall and its edge on it, a corner of three metal plates, round
bodies, a pane, what drives, what drives and turns, a cross section alone, and a walker. All points lie on a lattice of
2^-14 m, whose numbers float32 holds exactly in either unit: the stages are one scene to the last digit, and what
differs is the conversion's rounding.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from curved_bodies import Mesh, cylinder, sphere
from numpy.typing import ArrayLike, NDArray
from oracles import LIGHT_MPS, scattered_delays, specular_delays
from usd_files import TWINS, Twin, read

from datafactory.paths.merged_scene import merge_scene
from datafactory.paths.rays import RayFan
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import CORNER, DIFFRACTED, DIFFUSE, REFRACTED, SPECULAR, TARGET, PathTable
from datafactory.paths.trace import trace
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import Scene

pytestmark = pytest.mark.usefixtures("variant")

SOME = TWINS[::2]
"""Each axis that may be up once; all six are held to one another where stages are read."""
LATTICE_M = 2.0**-14
RAYS = 3000
POSE = Pose((0.5, -0.25, 0.75), yaw_deg=4.0, pitch_deg=1.0, velocity=(6.0, 0.5, 0.0), time_s=0.375)
FRAME_S = 0.01


def plate(*corners: tuple[float, float, float]) -> Mesh:
    return np.array(corners, dtype=float), np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)


def mesh(twin: Twin, name: str, of: Mesh, material: str, *lines: str) -> str:
    """A mesh prim of world points [m]; ``lines`` place and move it."""
    points = np.round(of[0] / LATTICE_M) * LATTICE_M
    triangles = ", ".join(map(str, of[1].reshape(-1).tolist()))
    return f"""def Mesh "{name}" {{
      point3f[] points = {twin.places(points)}
      int[] faceVertexCounts = [{", ".join(["3"] * len(of[1]))}]
      int[] faceVertexIndices = [{triangles}]
      uniform token subdivisionScheme = "none"
      custom token radar:material = "{material}"
      {chr(10).join(lines)}
    }}"""


def driven(twin: Twin, first: ArrayLike, then: ArrayLike, turns_deg: float = 0.0) -> str:
    """From place to place [m] within a second, and about the world's z if it turns."""
    about = f"xformOp:rotate{twin.up}"  # the stage's axis that is up
    turn = f"double {about}.timeSamples = {{ 0: 0, 24: {turns_deg} }}" if turns_deg else ""
    order = f'["xformOp:translate", "{about}"]' if turns_deg else '["xformOp:translate"]'
    return f"""double3 xformOp:translate.timeSamples = {{ 0: {twin.place(first)}, 24: {twin.place(then)} }}
      {turn}
      uniform token[] xformOpOrder = {order}"""


def stage(twin: Twin) -> str:
    corner = np.array([12.0, -5.0, 0.25])
    a, b, c = corner + 0.5 * np.array([(0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
    box = cylinder(0.75, 1.0, 4)  # four sides: nothing of it is round
    parts = [
        mesh(twin, "ground", plate((-2, -16, 0), (34, -16, 0), (34, 16, 0), (-2, 16, 0)), "asphalt"),
        mesh(twin, "wall", plate((26, -12, 0), (26, -12, 6), (26, 12, 6), (26, 12, 0)), "concrete"),
        *(
            mesh(twin, f"plate{n}", plate(tuple(corner), tuple(p), tuple(p + q - corner), tuple(q)), "metal")
            for n, (p, q) in enumerate(((a, c), (c, b), (b, a)))
        ),
        mesh(twin, "pane", plate((7, 2, 0.25), (7, 5, 0.25), (7, 5, 2.25), (7, 2, 2.25)), "glass"),
        mesh(twin, "column", cylinder(0.2, 3.0, 24), "metal", driven(twin, (9, 4, 1.5), (9, 4, 1.5))),
        mesh(twin, "ball", sphere(0.4, 32), "metal", driven(twin, (15, 1, 1.25), (15, 7, 1.25))),
        mesh(twin, "box", box, "metal", driven(twin, (14, -2, 0.75), (11, -2.5, 0.75), 90.0)),
        f"""def Xform "post" {{
          custom float radar:rcs_dbsm = 3
          custom double3 radar:velocity = {twin.turned((-1.0, 2.0, 0.5))}
          double3 xformOp:translate = {twin.place((18.0, 6.0, 1.0))}
          uniform token[] xformOpOrder = ["xformOp:translate"]
        }}""",
        f"""def Xform "walker" {{
          custom token radar:target = "pedestrian"
          {driven(twin, (10.0, -1.0, 0.0), (10.0, 0.5, 0.0))}
        }}""",
    ]
    return "\n".join(parts)


def opened(folder: Path, twin: Twin, body: str) -> Scene:
    return read(folder, body, f"{twin.metadata}\n timeCodesPerSecond = 24")


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> dict[Twin, Scene]:
    folders: dict[Twin, Path] = {twin: tmp_path_factory.mktemp("twin") for twin in SOME}
    return {
        twin: read(folder, stage(twin), f"{twin.metadata}\n timeCodesPerSecond = 24")
        for twin, folder in folders.items()
    }


def traced(scene: Scene) -> PathTable:
    materials = load_materials().map_materials([item.material for item in scene.objects])
    settings = TraceSettings(rays=RAYS, depth=2, refraction=True, diffraction=True, corners=True)
    return trace(
        merge_scene(scene, materials), POSE, 77.5e9, settings, RayFan(RAYS), seed=1, target_seed=2
    )  # fmt: skip


@pytest.fixture(scope="module")
def tables(scenes: dict[Twin, Scene], variant: str) -> dict[Twin, PathTable]:
    return {twin: traced(scene) for twin, scene in scenes.items()}


def measured(table: PathTable) -> dict[str, NDArray[np.float64]]:
    """What a radar has of each path: delay as a length and its rate, direction of arrival, amplitude."""
    here = np.zeros(3)
    scattered, specular = table.scattered, table.specular
    laws: tuple[tuple[Any, Any], ...] = ((scattered_delays, scattered), (specular_delays, specular))
    length, later = (
        LIGHT_MPS * np.concatenate([of(paths, here, here, time_s) for of, paths in laws]) for time_s in (0.0, FRAME_S)
    )
    seen = np.concatenate([scattered.rx_point, specular.image])
    amplitude = np.concatenate([scattered.amplitude, specular.amplitude])
    return {
        "length [m]": length,
        "rate [m/s]": (later - length) / FRAME_S,
        "direction": seen / np.linalg.norm(seen, axis=1, keepdims=True),
        "amplitude": np.stack([amplitude.real, amplitude.imag], axis=1) / np.abs(amplitude).max(),
    }


def test_the_scene_has_paths_of_every_kind(tables: dict[Twin, PathTable]) -> None:
    table = tables[SOME[0]]
    kinds = np.concatenate([table.scattered.kinds, table.specular.kinds])
    for kind in (SPECULAR, DIFFUSE, REFRACTED, DIFFRACTED, TARGET, CORNER):
        assert np.count_nonzero(kinds & kind), kind
    assert table.counts["curved_mirrors"] == 2
    assert len(table) > 1000
    assert {table.objects[n].strip("/") for n in table.scattered.object_index if n >= 0} >= {"post", "walker", "box"}
    assert np.ptp(measured(table)["rate [m/s]"]) > 10.0


@pytest.mark.parametrize("twin", SOME[1:], ids=str)
def test_twins_give_the_same_paths(tables: dict[Twin, PathTable], twin: Twin) -> None:
    """To rounding: each path has the delay, Doppler, direction and amplitude of the same path of the first twin."""
    first, table = tables[SOME[0]], tables[twin]
    assert table.objects == first.objects
    assert table.counts == first.counts
    for kind in ("scattered", "specular"):
        for name in ("object_index", "kinds", "depth"):
            np.testing.assert_array_equal(getattr(getattr(table, kind), name), getattr(getattr(first, kind), name))
    for name, expected in measured(first).items():
        np.testing.assert_allclose(measured(table)[name], expected, rtol=0.0, atol=1e-9, err_msg=name)


def test_a_stage_that_is_no_twin_is_told(tables: dict[Twin, PathTable], tmp_path: Path) -> None:
    """A wall a millimetre further away is more than the bound of the comparison, by six powers of ten."""
    twin = SOME[0]
    table = traced(opened(tmp_path, twin, stage(twin).replace("(26.0,", "(26.001,")))
    wall = table.objects.index("/wall")
    mirrors = [item.specular for item in (table, tables[twin])]
    near, far = (item.take((item.object_index == wall) & (item.depth == 1)).range_m() for item in mirrors)
    assert abs(near - far) == pytest.approx(1e-3, rel=0.05)  # float32 of the rays
