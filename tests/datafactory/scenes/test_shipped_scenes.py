"""The shipped scenes: resolvable materials, stated places, the bytes that their script writes or that they had."""

from __future__ import annotations

import hashlib
import math
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pxr import Usd, UsdGeom, UsdShade

from datafactory.scenes.city.usd import MATERIAL_COLOURS
from shared.physics.units import SPEED_OF_LIGHT

SCENES = Path(__file__).resolve().parents[3] / "scenes"
sys.path.append(str(SCENES))
import make_scenes  # noqa: E402

USD_SCENES = ("street.usda", "test_range.usda", "tiny.usda")
STREETS = {"street.usda": "2f21b397bc498350", "street.xml": "bf87d5c6337befed"}
"""The beginnings of their SHA-256."""


@pytest.fixture(scope="module")
def regenerated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenes")
    make_scenes.write_scenes(folder)
    return folder


def test_committed_scenes_are_what_the_script_writes(regenerated: Path) -> None:
    fresh = sorted(path.name for path in regenerated.iterdir())
    assert fresh == ["test_range.usda", "tiny.usda"]
    assert all((SCENES / name).read_bytes() == (regenerated / name).read_bytes() for name in fresh)


def test_the_streets_stay_as_they_were_drawn() -> None:
    """Datasets, figures and weights rest on these bytes."""
    digests = {name: hashlib.sha256((SCENES / name).read_bytes()).hexdigest()[:16] for name in STREETS}
    assert digests == STREETS
    meshes = b"".join(path.read_bytes() for path in sorted(SCENES.glob("meshes/*.ply")))
    assert hashlib.sha256(meshes).hexdigest()[:16] == "820c4a6cedffb638"


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
    for item in make_scenes.REFLECTORS:
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
