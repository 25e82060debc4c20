"""The shipped scenes and assets: materials, stated places and sizes, the bytes that their scripts write or they had."""

import hashlib
import sys
from pathlib import Path

import numpy as np
import pytest
from prepared_scenes import SCENES
from pxr import Usd, UsdGeom, UsdShade

from datafactory.paths.bodies import bodies_of
from datafactory.paths.merged_scene import merge_scene
from datafactory.paths.smooth import smooth_facets
from datafactory.scenes.city.usd import MATERIAL_COLOURS
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.readers.open import open_scene

sys.path.append(str(SCENES))
import make_assets
import make_scenes

USD_SCENES = ("street.usda", "test_range.usda", "tiny.usda")
STREETS = {"street.usda": "2f21b397bc498350", "street.xml": "bf87d5c6337befed"}
"""The beginnings of their SHA-256."""


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


def test_readme_states_the_reflectors_as_they_are() -> None:
    text = (SCENES / "README.md").read_text(encoding="utf-8")
    for item in make_scenes.REFLECTORS:
        x, y, _ = item.position
        row = f"| {item.range_m:g} | {item.u:+.4g} | {x:.4f} | {y:.4f} | {item.edge_m:g} | {item.rcs_dbsm:.2f} |"
        assert f"| `Reflectors/{item.name}` {row}" in text


VEHICLE = {"metal", "glass", "rubber"}

# Length, width and height [m], class, materials. Plates stand 1 cm beyond the bumpers.
STATED = {
    "saloon": ((4.72, 1.82, 1.45), "car", VEHICLE),
    "hatchback": ((4.07, 1.76, 1.48), "car", VEHICLE),
    "suv": ((4.62, 1.90, 1.68), "car", VEHICLE),
    "van": ((5.02, 1.94, 1.97), "car", VEHICLE),
    "truck": ((8.41, 2.50, 3.50), "truck", VEHICLE),
    "bus": ((12.02, 2.58, 3.10), "bus", VEHICLE),
    "lamp": ((0.24, 1.99, 7.00), "pole", {"metal"}),
    "traffic_light": ((0.31, 0.30, 3.40), "pole", {"metal", "glass"}),
    "bollard": ((0.16, 0.16, 0.95), "pole", {"metal"}),
    "sign_round": ((0.07, 0.60, 3.00), "sign", {"metal"}),
    "sign_triangle": ((0.07, 0.90, 3.02), "sign", {"metal"}),
    "sign_octagon": ((0.07, 0.84, 3.00), "sign", {"metal"}),
    "sign_panel": ((0.07, 0.60, 3.00), "sign", {"metal"}),
    "bin": ((0.44, 0.44, 0.90), "other", {"metal"}),
    "bench": ((1.80, 0.49, 0.85), "other", {"metal", "wood"}),
}


def test_every_asset_is_stated_here() -> None:
    assert {file.stem for file in (SCENES / "assets").glob("*.usda")} == STATED.keys()
    assert sum(file.stat().st_size for file in (SCENES / "assets").glob("*.usda")) < 1_000_000


@pytest.mark.parametrize("name", STATED)
def test_asset_has_its_size_class_and_materials(name: str) -> None:
    size, label, materials = STATED[name]
    scene = open_scene(f"shipped:assets/{name}")
    low, high = scene.bounds()
    np.testing.assert_allclose(high - low, size, atol=0.006)
    assert low[2] == pytest.approx(0.0, abs=1e-6)  # it stands on the ground
    assert {item.material for item in scene.objects} == materials
    assert not scene.warnings
    stage = Usd.Stage.Open(str(SCENES / "assets" / f"{name}.usda"))
    assert [
        str(prim.GetAttribute("radar:class").Get()) for prim in stage.Traverse() if prim.HasAttribute("radar:class")
    ] == [label]


@pytest.mark.parametrize(
    ("name", "share"), [("saloon", 0.55), ("suv", 0.55), ("van", 0.55), ("truck", 0.55), ("bus", 0.5), ("lamp", 0.4)]
)
def test_rounded_bodies_are_curved_mirrors(name: str, share: float) -> None:
    """None of their facets is too coarse to be one (docs/notes/curved.md)."""
    scene = open_scene(f"shipped:assets/{name}")
    (body,) = bodies_of(merge_scene(scene, load_materials().map_materials([item.material for item in scene.objects])))
    found = smooth_facets(body)
    assert np.mean(found.surface >= 0) >= share
    assert found.coarse == 0
    assert body.non_manifold == 0


def test_the_scripts_write_the_committed_files(tmp_path: Path) -> None:
    (tmp_path / "assets").mkdir()
    make_scenes.write_scenes(tmp_path)
    make_assets.main(tmp_path / "assets")
    fresh = sorted(tmp_path.rglob("*.usda"))
    assert len(fresh) == len(STATED) + len(("test_range", "tiny"))
    for path in fresh:
        assert path.read_bytes() == (SCENES / path.relative_to(tmp_path)).read_bytes(), path.name
