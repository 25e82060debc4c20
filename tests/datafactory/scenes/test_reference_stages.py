"""Public USD files that nobody here made, where they lie beside the checkout: counts, sizes, materials, motion."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdShade, UsdSkel

from datafactory.scenes.readers.open import open_scene
from shared.physics.errors import InputError

REFERENCE = Path(__file__).resolve().parents[3] / ".." / "shared" / "data" / "usd"
pytestmark = pytest.mark.skipif(not REFERENCE.is_dir(), reason="the reference stages are not beside the checkout")
START = Usd.TimeCode.EarliestTime()

# Prims with a shape and their faces, in the file; objects, triangles, named materials and size [m], as read. A mesh is
# an object for each of its materials. None of these files has instances, but for those of variants.
STATED = {
    "BoxAnimated.usdz": (2, 254, 2, 254, 2, (1.0, 1.0, 1.0)),
    "CesiumMan.usdz": (1, 4672, 1, 4672, 1, (0.505, 0.896, 1.458)),
    "McUsd/McUsd.usda": (23, 440, 23, 880, 23, (13.0, 13.0, 3.0)),
    "KIT/vehicles/4wd/asset/4wdBodyAsset.usda": (1, 612, 6, 611, 6, (218.504, 398.789, 179.802)),
    "KIT/vehicles/4wd/asset/4wdFullAsset.usda": (5, 1940, 14, 1939, 6, (274.189, 398.789, 234.92)),
    "KIT/vehicles/4wd/geo/4wdGeo.usd": (1, 612, 6, 611, 0, (5.55, 10.129, 4.567)),
    "KIT/vehicles/ambulance/asset/ambulanceBodyAsset.usda": (1, 551, 7, 545, 7, (226.378, 466.536, 230.217)),
    "KIT/vehicles/ambulance/asset/ambulanceFullAsset.usda": (5, 1879, 15, 1873, 7, (316.189, 466.536, 285.433)),
    "KIT/vehicles/ambulance/geo/ambulanceGeo.usd": (1, 551, 7, 545, 0, (5.75, 11.85, 5.848)),
    "KIT/vehicles/formula/asset/formulaBodyAsset.usda": (1, 268, 4, 259, 4, (242.126, 498.401, 142.321)),
    "KIT/vehicles/formula/asset/formulaFullAsset.usda": (5, 1212, 16, 1203, 4, (265.433, 498.401, 165.439)),
    "KIT/vehicles/formula/geo/formulaGeo.usda": (1, 268, 4, 259, 0, (6.15, 12.659, 3.615)),
    "KIT/vehicles/sedan/asset/sedanBodyAsset.usda": (1, 415, 5, 415, 5, (226.378, 466.536, 171.26)),
    "KIT/vehicles/sedan/asset/sedanFullAsset.usda": (5, 1359, 13, 1359, 6, (226.378, 466.536, 226.378)),
    "KIT/vehicles/sedan/geo/sedanGeo.usda": (1, 415, 5, 415, 0, (5.75, 11.85, 4.35)),
    "KIT/vehicles/tractor/asset/tractorBodyAsset.usda": (2, 660, 7, 645, 6, (263.701, 473.472, 273.281)),
    "KIT/vehicles/tractor/asset/tractorFullAsset.usda": (6, 1988, 15, 1973, 6, (276.189, 473.472, 273.281)),
    "KIT/vehicles/tractor/geo/tractorGeo.usd": (2, 660, 7, 645, 0, (6.698, 12.026, 6.941)),
    "KIT/vehicles/truckFlat/asset/truckFlatBodyAsset.usda": (1, 480, 6, 476, 6, (218.504, 482.284, 202.756)),
    "KIT/vehicles/truckFlat/asset/truckFlatFullAsset.usda": (5, 1424, 14, 1420, 6, (218.504, 482.284, 257.874)),
    "KIT/vehicles/truckFlat/geo/flatTruckGeo.usd": (1, 480, 6, 476, 0, (5.55, 12.25, 5.15)),
    "KIT/vehicles/van/asset/vanBodyAsset.usda": (1, 549, 6, 547, 6, (210.63, 466.536, 202.756)),
    "KIT/vehicles/van/asset/vanFullAsset.usda": (5, 1877, 14, 1875, 6, (210.63, 466.536, 257.874)),
    "KIT/vehicles/van/geo/vanGeo.usd": (1, 549, 6, 547, 0, (421.26, 933.071, 405.512)),
    "KIT/vehicles/vehicleVariants.usda": (6, 1988, 15, 1973, 6, (276.189, 473.472, 273.281)),
    "KIT/wheels/wheelBlack/asset/wheelBlackAsset.usda": (1, 332, 2, 332, 2, (40.118, 110.236, 110.236)),
    "KIT/wheels/wheelBlack/geo/wheelBlackGeo.usd": (1, 332, 2, 332, 0, (1.019, 2.8, 2.8)),
    "KIT/wheels/wheelLargeRim/asset/wheelLargeRimAsset.usda": (1, 236, 2, 236, 2, (40.827, 110.236, 110.236)),
    "KIT/wheels/wheelLargeRim/geo/wheelLargeRimGeo.usd": (1, 236, 2, 236, 0, (1.037, 2.8, 2.8)),
    "KIT/wheels/wheelNormal/asset/wheelNormalAsset.usda": (1, 236, 2, 236, 2, (39.37, 110.236, 110.236)),
    "KIT/wheels/wheelNormal/geo/wheelNormalGeo.usda": (1, 236, 2, 236, 0, (1.0, 2.8, 2.8)),
    "KIT/wheels/wheelRed/asset/wheelRedAsset.usda": (1, 236, 3, 236, 3, (47.717, 110.236, 110.236)),
    "KIT/wheels/wheelRed/geo/wheelRedGeo.usd": (1, 236, 3, 236, 0, (1.212, 2.8, 2.8)),
    "KIT/wheels/wheelVariants.usda": (1, 332, 2, 332, 2, (74.095, 110.236, 110.236)),
    "KIT/wheels/wheelVintage/asset/wheelVintageAsset.usda": (1, 236, 3, 236, 3, (43.307, 110.236, 110.236)),
    "KIT/wheels/wheelVintage/geo/wheelVintageGeo.usd": (1, 236, 3, 236, 0, (1.1, 2.8, 2.8)),
    "KIT/wheels/wheelWide/asset/wheelWideAsset.usda": (1, 332, 2, 332, 2, (74.095, 110.236, 110.236)),
    "KIT/wheels/wheelWide/geo/wheelWideGeo.usd": (1, 332, 2, 332, 0, (1.882, 2.8, 2.8)),
    "all_primitives.usda": (5, 0, 5, 8460, 0, (0.095, 0.02, 0.02)),
    "meshes/5_face.usda": (1, 6, 1, 13, 0, (0.012, 0.012, 0.012)),
    "meshes/doubleSided_quad.usda": (2, 2, 2, 4, 0, (0.04, 0.0, 0.04)),
    "meshes/mixed.usda": (1, 11, 1, 12, 0, (0.01, 0.01, 0.01)),
    "meshes/normalsTypes.usda": (17, 102, 17, 204, 0, (0.33, 0.01, 0.01)),
    "meshes/pointsTypes.usda": (16, 192, 8, 96, 0, (0.29, 0.01, 0.01)),
    "meshes/quads.usda": (1, 6, 1, 12, 0, (0.01, 0.01, 0.01)),
    "meshes/singleSided.usda": (2, 2, 2, 4, 0, (0.04, 0.0, 0.04)),
    "meshes/subdiv_bilinear.usda": (1, 6, 1, 12, 0, (0.01, 0.01, 0.01)),
    "meshes/subdiv_catmullClark.usda": (1, 6, 1, 12, 0, (0.01, 0.01, 0.01)),
    "meshes/subdiv_loop_quads.usda": (1, 6, 1, 12, 0, (0.01, 0.01, 0.01)),
    "meshes/subdiv_loop_triangles.usda": (1, 12, 1, 12, 0, (0.01, 0.01, 0.01)),
    "meshes/subdiv_none.usda": (1, 6, 1, 12, 0, (0.01, 0.01, 0.01)),
    "meshes/triangles.usda": (1, 12, 1, 12, 0, (0.01, 0.01, 0.01)),
}  # fmt: skip


def path_of(name: str) -> Path:
    return REFERENCE / name.replace("KIT", "Vehicles/USD_Mini_Car_Kit/assets", 1)


def shapes(stage: Usd.Stage) -> Iterator[Usd.Prim]:
    """Visible prims with a shape, those within instances too."""
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        if prim.IsA(UsdGeom.Gprim) and UsdGeom.Imageable(prim).ComputeVisibility(START) != UsdGeom.Tokens.invisible:
            yield prim


def sides(prim: Usd.Prim) -> np.ndarray:
    """[F] how many sides each face of a mesh has; none of what is no mesh."""
    counts = UsdGeom.Mesh(prim).GetFaceVertexCountsAttr().Get(START) if prim.IsA(UsdGeom.Mesh) else None
    return np.array(counts if counts is not None else [], dtype=int)


def has_points(prim: Usd.Prim) -> bool:
    points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(START) or [])
    return points.ndim == 2 and points.shape[1] == 3


def bound_materials(stage: Usd.Stage) -> set[str]:
    """Names of the materials that USD itself resolves for the shapes and their subsets."""
    found = set()
    for prim in shapes(stage):
        subsets = [subset.GetPrim() for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets()]
        for bound in (prim, *subsets):
            material, _ = UsdShade.MaterialBindingAPI(bound).ComputeBoundMaterial()
            if material:
                found.add(str(material.GetPrim().GetName()))
    return found


def test_every_file_that_can_be_read_is_stated() -> None:
    read, refused = set(), 0
    for path in sorted(REFERENCE.rglob("*.usd*")):
        try:
            open_scene(str(path))
        except InputError:
            refused += 1
        else:
            read.add(path)
    assert read == {path_of(name) for name in STATED}
    # Nine files of materials alone, six that refer to a file kept elsewhere, one mesh without points.
    assert refused == 16


@pytest.mark.parametrize("name", STATED)
def test_a_file_has_its_stated_counts_sizes_and_materials(name: str) -> None:
    """The table against USD's own account of the file, and the reader's scene against both."""
    prims, faces, objects, triangles, materials, size = STATED[name]
    stage = Usd.Stage.Open(str(path_of(name)))
    assert len(list(shapes(stage))) == prims
    assert sum(len(sides(prim)) for prim in shapes(stage)) == faces
    scene = open_scene(str(path_of(name)))
    names = [item.name for item in scene.objects] + [target.name for target in scene.targets]
    assert len(set(names)) == len(names) == objects
    assert scene.triangle_count == triangles
    np.testing.assert_allclose(np.subtract(*scene.bounds()[::-1]), size, atol=1e-3)
    named = {item.material for item in scene.objects} - {""}
    assert len(named) == materials
    assert named == bound_materials(stage)


@pytest.mark.parametrize("name", [name for name in STATED if name.startswith(("KIT", "McUsd", "meshes", "BoxAnim"))])
def test_no_triangle_and_no_corner_is_lost(name: str) -> None:
    """A face of n sides is n - 2 triangles; corners are where USD's own transforms put them."""
    stage = Usd.Stage.Open(str(path_of(name)))
    scene = open_scene(str(path_of(name)))
    dropped = [re.match(r"(\d+) triangles without area dropped", text) for text in scene.warnings]
    without_area = sum(int(match[1]) for match in dropped if match)
    meshes = [prim for prim in shapes(stage) if has_points(prim)]
    assert scene.triangle_count + without_area == sum(int((sides(prim) - 2).sum()) for prim in meshes)
    places, cache = [], UsdGeom.XformCache(stage.GetStartTimeCode())
    for prim in meshes:
        points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(START), dtype=float)
        used = points[np.array(UsdGeom.Mesh(prim).GetFaceVertexIndicesAttr().Get(START), dtype=int)]
        matrix = np.array(cache.GetLocalToWorldTransform(prim))
        places.append(used @ matrix[:3, :3] + matrix[3, :3])
    x, y, z = UsdGeom.GetStageMetersPerUnit(stage) * np.concatenate(places).T
    world = np.stack([x, y, z] if UsdGeom.GetStageUpAxis(stage) == "Z" else [x, -z, y], axis=1)
    low, high = scene.bounds()
    tolerance = 1e-6 * np.abs(world).max()
    np.testing.assert_allclose(world.min(axis=0), low, atol=tolerance)
    np.testing.assert_allclose(world.max(axis=0), high, atol=tolerance)


def test_the_box_within_the_box_rises() -> None:
    box = {item.material: item for item in open_scene(str(REFERENCE / "BoxAnimated.usdz")).objects}
    assert box["inner"].velocity == pytest.approx((0, 0, 2.52 / 30 * 24), abs=1e-6)
    assert not box["outer"].moves


@pytest.mark.parametrize("code", [1.0, 13.0, 30.0])
def test_a_skinned_walker_is_where_the_skeleton_puts_it(code: float) -> None:
    """Point by point against UsdSkel's own query; Y up, in metres, 24 codes a second from code 1 on."""
    path = str(REFERENCE / "CesiumMan.usdz")
    (man,) = open_scene(path).objects
    usd_stage, time = Usd.Stage.Open(path), Usd.TimeCode(code)
    root = UsdSkel.Root(next(prim for prim in usd_stage.Traverse() if prim.IsA(UsdSkel.Root)))
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    (binding,) = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)
    (skin,) = binding.GetSkinningTargets()
    points = UsdGeom.Mesh(skin.GetPrim()).GetPointsAttr().Get(time)
    skin.ComputeSkinnedPoints(cache.GetSkelQuery(binding.GetSkeleton()).ComputeSkinningTransforms(time), points, time)
    place = np.array(UsdGeom.XformCache(time).GetLocalToWorldTransform(binding.GetSkeleton().GetPrim()))
    x, y, z = (np.array(points) @ place[:3, :3] + place[3, :3]).T
    now = man.at((code - 1.0) / 24.0)
    np.testing.assert_allclose(now.vertices, np.stack([x, -z, y], axis=1), atol=1e-6)
    later = man.at((code - 1.0) / 24.0 + 1e-6).vertices
    np.testing.assert_allclose(now.velocities, (later - now.vertices) / 1e-6, atol=1e-6)


def test_a_sedan_of_466_metres_is_told() -> None:
    folder = REFERENCE / "Vehicles" / "USD_Mini_Car_Kit" / "assets" / "vehicles" / "sedan"
    scene = open_scene(str(folder / "asset" / "sedanBodyAsset.usda"))
    assert any("467 x" in warning or "x 467 x" in warning for warning in scene.warnings)
    assert {item.material for item in scene.objects} >= {"redMaterial", "windowMaterial"}


def test_a_reference_matrix_with_its_missing_layer_put_in_place(tmp_path: Path) -> None:
    """The file refers to ../../../_common/axis.usda, which the collection keeps elsewhere."""
    deep = tmp_path / "a" / "b" / "c"
    deep.mkdir(parents=True)
    (tmp_path / "_common").mkdir()
    (tmp_path / "_common" / "axis.usda").write_text('#usda 1.0\n(\n defaultPrim = "x"\n)\ndef Scope "x" {\n}\n')
    shutil.copy(REFERENCE / "transforms" / "weird_matrix_transform.usda", deep / "stage.usda")
    item = open_scene(str(deep / "stage.usda")).objects[0]
    # Row vectors: the cube's centre goes to the matrix's last row (13, 14, 15) cm, y up.
    np.testing.assert_allclose(item.vertices.mean(axis=0), [0.13, -0.15, 0.14], atol=1e-12)
    # x row (1, 2, 3), y row (5, 6, 7), z row (9, 10, 11) span 15 = 1 + 5 + 9 in x.
    assert np.ptp(item.vertices[:, 0]) == pytest.approx(0.15)
