"""The procedural city and the shipped scenes: closed parts, resolvable materials, stated places, reproducible bytes."""

from __future__ import annotations

import importlib.util
import math
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import trimesh
from pxr import Usd, UsdGeom, UsdShade

from datafactory.scenes.city import parts
from datafactory.scenes.city.city import City, write_city
from datafactory.scenes.city.shapes import Surface, framed_pane, prism, stepped_surface, welded
from datafactory.scenes.city.usd import MATERIAL_COLOURS
from shared.physics.errors import InputError
from shared.physics.units import SPEED_OF_LIGHT

SCENES = Path(__file__).resolve().parents[3] / "scenes"
USD_SCENES = ("street.usda", "test_range.usda", "tiny.usda")


def load_make_scenes() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_scenes", SCENES / "make_scenes.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up there
    spec.loader.exec_module(module)
    return module


def as_mesh(surface: Surface) -> trimesh.Trimesh:
    return trimesh.Trimesh(surface.vertices, surface.triangles(), process=False)


def house_style(gabled: bool = False) -> parts.HouseStyle:
    return parts.HouseStyle(11.0, 10.0, 3, "brick", "wood", gabled, door_bay=1)


PARTS = {
    "house flat": parts.house(house_style()),
    "house gabled": parts.house(house_style(gabled=True)),
    **{name: parts.car(shape) for name, shape in parts.CAR_SHAPES.items()},
    "lamp": parts.lamp_post(),
    **{f"sign {kind}": parts.sign(kind) for kind in ("round", "triangle", "panel")},
    "bollard": parts.bollard(),
    "bin": parts.litter_bin(),
    "tree": parts.tree(np.random.default_rng(3)),
    "pedestrian": parts.pedestrian(),
    "cyclist": parts.cyclist(),
}


@pytest.mark.parametrize("name", PARTS)
def test_every_body_of_a_part_is_closed_and_faces_outwards(name: str) -> None:
    mesh = as_mesh(PARTS[name])
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.area_faces.min() > 1e-6
    for body in mesh.split(repair=False):
        assert body.volume > 0


@pytest.mark.parametrize("name", PARTS)
def test_fans_are_right_because_every_face_is_planar_and_convex(name: str) -> None:
    surface = PARTS[name]
    for face in surface.faces:
        corners = surface.vertices[list(face)]
        edges = np.roll(corners, -1, axis=0) - corners
        turns = np.cross(np.roll(edges, 1, axis=0), edges)
        normal = turns.sum(axis=0) / np.linalg.norm(turns.sum(axis=0))
        assert np.all(turns @ normal > 0)
        # Vertices are kept to the millimetre, which bends a face by about as much.
        assert np.abs((corners - corners[0]) @ normal).max() < 2e-3


def test_house_volume_is_the_box_less_its_recesses() -> None:
    style = house_style()
    bay = style.width / style.bays
    half = 0.5 * min(1.4, bay - 1.0)
    window, border = 2 * half * 1.35, 0.07
    pane = (2 * half - 2 * border) * (1.35 - 2 * border)
    windows = style.bays * style.floors - 1
    recess = windows * (window * parts.FRAME_RECESS + pane * (parts.WINDOW_RECESS - parts.FRAME_RECESS))
    door = 2 * half * (2.5 - parts.PLINTH) * parts.DOOR_RECESS
    eaves = style.floors * parts.FLOOR_HEIGHT + 0.4
    expected = style.width * style.depth * eaves - recess - door
    # 1 mm of rounding over 20 m2 of openings
    assert as_mesh(parts.house(style)).volume == pytest.approx(expected, abs=0.03)


def test_gable_adds_a_triangular_prism() -> None:
    flat, gabled = (as_mesh(parts.house(house_style(gabled))).volume for gabled in (False, True))
    attic = 0.5 * 10.0 * (0.5 * 10.0 * math.tan(parts.ROOF_PITCH)) * 11.0
    assert gabled - flat == pytest.approx(attic, rel=1e-3)


@pytest.mark.parametrize("name", parts.CAR_SHAPES)
def test_cars_have_plausible_size_and_materials(name: str) -> None:
    surface = PARTS[name]
    lower, upper = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    assert 3.5 < (upper - lower)[0] < 5.2
    assert 1.6 < (upper - lower)[1] < 2.1
    assert lower[2] == pytest.approx(0.0, abs=0.02)
    assert 1.3 < upper[2] < 2.1
    assert set(surface.materials) == {"metal", "glass", "rubber"}
    assert 100 <= len(surface.triangles()) <= 300
    # Windscreen and rear window look along the street, the side windows across it.
    glass = trimesh.Trimesh(surface.vertices, surface.triangles("glass"), process=False).face_normals
    assert {tuple(np.sign(np.round(normal[:2], 2))) for normal in glass} == {(1, 0), (-1, 0), (0, 1), (0, -1)}


def test_prism_volume_and_outward_normals() -> None:
    mesh = as_mesh(prism([(0, 0), (3, 0), (0, 2)], 1.0, 5.0, "metal"))
    assert mesh.volume == pytest.approx(12.0)


def test_stepped_surface_adds_the_kerb_to_the_flat_area() -> None:
    polygons = stepped_surface([0.0, 2.0, 5.0], [0.0, 4.0], [[0.0], [0.12]], lambda i, j: ("asphalt", "concrete")[i])
    mesh = as_mesh(welded(polygons))
    assert mesh.area == pytest.approx(5.0 * 4.0 + 0.12 * 4.0)
    kerb = np.isclose(mesh.face_normals[:, 0], -1.0)
    assert kerb.sum() == 2
    assert np.all(mesh.face_normals[~kerb, 2] > 0.99)
    assert [polygon.material for polygon in polygons].count("concrete") == 2


def test_framed_pane_lies_behind_its_outline_by_the_recess() -> None:
    outline = np.array([(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (2.0, 0.0, 1.0), (0.0, 0.0, 1.0)])  # normal -y
    panes = [item for item in framed_pane(outline, 0.1, 0.05, "wood", "glass") if item.material == "glass"]
    assert len(panes) == 1
    assert panes[0].corners == pytest.approx(
        np.array([(0.1, 0.05, 0.1), (1.9, 0.05, 0.1), (1.9, 0.05, 0.9), (0.1, 0.05, 0.9)])
    )


@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_same_seed_same_bytes_and_another_seed_differs(tmp_path: Path, suffix: str) -> None:
    files = [tmp_path / f"{name}{suffix}" for name in ("first", "again", "other")]
    for path, seed in zip(files, (4, 4, 5), strict=True):
        write_city(path, seed=seed, blocks=1)
    first, again, other = (path.read_bytes() for path in files)
    assert first == again
    assert first != other


def test_city_stays_within_its_budget(tmp_path: Path) -> None:
    placements = City(0, 2).build()
    triangles = sum(len(item.surface.triangles()) for item in placements if item.surface is not None)
    assert 5_000 < triangles < 60_000
    write_city(tmp_path / "city.usda")
    assert (tmp_path / "city.usda").stat().st_size < 1_500_000


@pytest.mark.parametrize("seed", range(6))
def test_nothing_stands_where_it_should_not(seed: int) -> None:
    """Houses leave the street free, cars do not overlap, and kerbside furniture stands on the pavement."""
    placements = City(seed, 2).build()
    corners = {}
    for item in placements:
        assert item.surface is not None
        placed = item.surface.moved(item.position, _rotation(item.yaw_deg)).vertices
        corners[item.path] = placed.min(axis=0), placed.max(axis=0)
    for path, (lower, upper) in corners.items():
        if path.startswith("Houses/"):
            assert lower[1] >= 8.49 or upper[1] <= -8.49
            assert lower[0] >= 6.49 or upper[0] <= -6.49
        if path.startswith(("Trees/", "Bins/", "Bollards/")):
            foot = next(item.position for item in placements if item.path == path)
            assert 5.5 < abs(foot[1]) < 8.5
            assert foot[2] == 0.12
    cars = [bounds for path, bounds in corners.items() if path.startswith("Cars/")]
    assert len(cars) > 15
    for i, (lower, upper) in enumerate(cars):
        for other_lower, other_upper in cars[:i]:
            assert np.any(lower[:2] > other_upper[:2]) or np.any(other_lower[:2] > upper[:2])


def _rotation(yaw_deg: float) -> np.ndarray:
    yaw = math.radians(yaw_deg)
    return np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])


def test_traffic_keeps_right_and_faces_where_it_goes() -> None:
    moving = [item for item in City(1, 2).build() if any(item.velocity)]
    cars = [item for item in moving if item.path.startswith("Cars/")]
    assert len(cars) >= 4
    for item in cars:
        assert np.sign(item.velocity[0]) == -np.sign(item.position[1])
    for item in moving:
        heading = _rotation(item.yaw_deg)[:, 0]
        assert heading @ np.array(item.velocity) == pytest.approx(np.linalg.norm(item.velocity))
    people = [item for item in moving if item.path.startswith("People/")]
    assert {item.rcs_dbsm for item in people} == {-1.4, -10.0}


@pytest.mark.parametrize(
    ("name", "arguments", "words"),
    [
        ("city.obj", {}, ("city.obj", "'.obj'", ".usda")),
        ("missing/city.usda", {}, ("missing", "does not exist")),
        ("city.usda", {"seed": -1}, ("seed = -1", "at least 0")),
        ("city.usda", {"seed": 1.5}, ("seed = 1.5", "whole number")),
        ("city.usda", {"blocks": 0}, ("blocks = 0", "at least 1")),
        ("x" * 300 + ".usda", {}, ("cannot be written",)),
    ],
)
def test_bad_arguments_are_one_clear_line(
    tmp_path: Path, name: str, arguments: dict[str, int], words: tuple[str, ...]
) -> None:
    with pytest.raises(InputError) as caught:
        write_city(tmp_path / name, **arguments)
    message = str(caught.value)
    assert "\n" not in message
    assert all(word in message for word in words), message


@pytest.fixture(scope="module")
def regenerated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenes")
    load_make_scenes().write_scenes(folder)
    return folder


FULL = """
import resource, signal, sys
from pathlib import Path
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))
from datafactory.scenes.city.city import write_city
from shared.physics.errors import InputError
try:
    write_city(Path(sys.argv[1]), 0, 1)
except InputError as error:
    print(error)
"""


@pytest.mark.parametrize("suffix", ["usda", "usdc"])
def test_a_disk_that_is_full_leaves_the_file_that_was_there(tmp_path: Path, suffix: str) -> None:
    """The limit on the size of files stands for the full disk."""
    path = tmp_path / f"city.{suffix}"
    path.write_text("before")
    command = [sys.executable, "-c", FULL, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.startswith(f"{path}: cannot be written (")
    assert len(done.stdout.splitlines()) == 1
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
    assert path.read_text() == "before"


def test_committed_scenes_are_what_the_script_writes(regenerated: Path) -> None:
    fresh = {path.relative_to(regenerated) for path in regenerated.rglob("*") if path.is_file()}
    committed = {*SCENES.glob("*.usd*"), *SCENES.glob("*.xml"), *SCENES.glob("meshes/*")}
    assert {path.relative_to(SCENES) for path in committed} == fresh
    different = [
        str(path) for path in sorted(fresh) if (SCENES / path).read_bytes() != (regenerated / path).read_bytes()
    ]
    assert not different


@pytest.mark.parametrize("name", USD_SCENES)
def test_stage_is_metric_z_up_and_every_binding_resolves(name: str) -> None:
    stage = Usd.Stage.Open(str(SCENES / name))
    assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert stage.GetDefaultPrim().GetPath() == "/World"
    assert not stage.GetCompositionErrors()
    meshes = 0
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
        if not prim.IsA(UsdGeom.Mesh):
            continue
        meshes += 1
        subsets = UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets()
        for bound in [subset.GetPrim() for subset in subsets] or [prim]:
            material, _ = UsdShade.MaterialBindingAPI(bound).ComputeBoundMaterial()
            assert material, bound.GetPath()
            assert material.GetPrim().GetName() in MATERIAL_COLOURS
        if subsets:
            faces = len(UsdGeom.Mesh(prim).GetFaceVertexCountsAttr().Get())
            valid, why = UsdGeom.Subset.ValidateFamily(UsdGeom.Mesh(prim), "face", UsdShade.Tokens.materialBind)
            assert valid, why
            assert sum(len(subset.GetIndicesAttr().Get()) for subset in subsets) == faces
    assert meshes > 0


def test_street_carries_velocities_and_cross_sections() -> None:
    stage = Usd.Stage.Open(str(SCENES / "street.usda"))
    people = [prim for prim in stage.GetPrimAtPath("/World/People").GetChildren()]
    assert len(people) > 8
    cache = UsdGeom.XformCache()
    for prim in people:
        expected, torso = (-1.4, (1.1, 1.22)) if prim.GetName().startswith("Pedestrian") else (-10.0, (1.2,))
        assert prim.GetAttribute("radar:rcs_dbsm").Get() == pytest.approx(expected)
        height = cache.GetLocalToWorldTransform(prim).ExtractTranslation()[2]
        assert min(abs(height - value) for value in torso) < 1e-6
        assert prim.GetAttribute("radar:velocity").Get().GetLength() > 0.5
    cars = stage.GetPrimAtPath("/World/Cars").GetChildren()
    moving = [prim for prim in cars if prim.GetAttribute("radar:velocity").HasAuthoredValue()]
    assert 4 <= len(moving) < len(cars)


REFLECTORS = {
    # name: range [m], u, edge [m]
    "Pair_left": (5.7, 0.0406, 0.1),
    "Pair_right": (5.7, -0.0406, 0.1),
    "Single_10m": (10.0, 0.0, 0.1),
    "Single_20m": (20.0, 0.5, 0.1),
    "Single_40m": (40.0, -0.5, 0.2),
    "Single_60m": (60.0, 0.2, 0.2),
    "Single_80m": (80.0, 0.0, 0.2),
    "Moving_30m": (30.0, -0.2, 0.2),
}


def test_reflectors_stand_at_the_stated_range_and_u() -> None:
    stage = Usd.Stage.Open(str(SCENES / "test_range.usda"))
    prims = {prim.GetName(): prim for prim in stage.GetPrimAtPath("/World/Reflectors").GetChildren()}
    assert set(prims) == set(REFLECTORS)
    cache = UsdGeom.XformCache()
    wavelength = SPEED_OF_LIGHT / 77.5e9
    for name, (range_m, u, edge) in REFLECTORS.items():
        position = np.array(cache.GetLocalToWorldTransform(prims[name]).ExtractTranslation()) - (0.0, 0.0, 0.6)
        assert np.linalg.norm(position) == pytest.approx(range_m, abs=1e-9)
        assert position[1] / np.linalg.norm(position) == pytest.approx(u, abs=1e-9)
        assert position[0] > 0
        rcs_dbsm = 10.0 * math.log10(4.0 * math.pi * edge**4 / (3.0 * wavelength**2))
        assert prims[name].GetAttribute("radar:rcs_dbsm").Get() == pytest.approx(rcs_dbsm, abs=1e-4)
        velocity = prims[name].GetAttribute("radar:velocity").Get()
        assert (tuple(velocity) if velocity else (0.0, 0.0, 0.0)) == (
            (-5.0, 0.0, 0.0) if "Moving" in name else (0.0,) * 3
        )


def test_readme_states_the_reflectors_as_they_are() -> None:
    text = (SCENES / "README.md").read_text(encoding="utf-8")
    for item in load_make_scenes().REFLECTORS:
        x, y, _ = item.position
        row = f"| {item.range_m:g} | {item.u:+.4g} | {x:.4f} | {y:.4f} | {item.edge_m:g} | {item.rcs_dbsm:.2f} |"
        assert f"| `Reflectors/{item.name}` {row}" in text


def test_small_scenes_stay_small() -> None:
    assert (SCENES / "street.usda").stat().st_size < 1_500_000
    assert (SCENES / "tiny.usda").stat().st_size < 60_000
    meshes = list((SCENES / "meshes").glob("*.ply"))
    assert sum(path.stat().st_size for path in meshes) < 500_000
    # A Mitsuba shape has one material and one file: every mesh is used, and loads.
    xml = (SCENES / "street.xml").read_text(encoding="utf-8")
    assert sorted(xml.count(f"meshes/{path.name}") for path in meshes) == [1] * len(meshes)
    triangles = sum(len(trimesh.load_mesh(path, process=False).faces) for path in meshes)
    assert 3_000 < triangles < 20_000
