"""Public USD files that nobody here made, where they lie beside the checkout: counts, sizes, materials, motion."""

import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdShade, UsdSkel

from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from shared.physics.errors import InputError

REFERENCE = Path(__file__).resolve().parents[3] / ".." / "shared" / "data" / "usd"
pytestmark = pytest.mark.skipif(not REFERENCE.is_dir(), reason="the reference stages are not beside the checkout")
START = Usd.TimeCode.EarliestTime()

NAMES = sorted(str(path.relative_to(REFERENCE)) for path in REFERENCE.rglob("*.usd*"))
REFUSED = {
    # of materials alone
    *(f"Vehicles/USD_Mini_Car_Kit/materials/{name}.usda" for name in (
        "backLight", "blue", "frontLight", "green", "lightGrey", "mediumGrey", "red", "white", "window",
    )),
    # refer to a file kept elsewhere
    *(f"transforms/{name}.usda" for name in (
        "complex_transform", "matrix_transform", "scopes_and_xforms_nested", "simple_transform",
        "weird_matrix_transform", "xforms_nested",
    )),
    "meshes/empty.usda",  # a mesh without points
}  # fmt: skip


@lru_cache
def opened(name: str) -> Scene | None:
    """The scene of a file; None where it is refused, as one without geometry is."""
    try:
        return open_scene(str(REFERENCE / name))
    except InputError:
        return None


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


def test_every_file_but_those_without_geometry_is_read() -> None:
    assert {name for name in NAMES if opened(name) is None} == REFUSED
    assert len(NAMES) == 68


@pytest.mark.parametrize("name", NAMES)
def test_a_file_has_its_materials_and_an_object_for_each(name: str) -> None:
    """As USD itself resolves them; a mesh is an object for each of its materials, and no name is given twice."""
    scene = opened(name)
    if scene is None:
        return
    stage = Usd.Stage.Open(str(REFERENCE / name))
    names = [item.name for item in scene.objects] + [target.name for target in scene.targets]
    assert len(set(names)) == len(names)
    meshes = [prim for prim in shapes(stage) if has_points(prim) or not prim.IsA(UsdGeom.Mesh)]
    assert len(names) >= len(meshes) > 0
    assert {item.material for item in scene.objects} - {""} == bound_materials(stage)


@pytest.mark.parametrize(
    "name", [name for name in NAMES if name.startswith(("Vehicles", "McUsd", "meshes", "BoxAnim"))]
)
def test_no_triangle_and_no_corner_is_lost(name: str) -> None:
    """A face of n sides is n - 2 triangles; corners are where USD's own transforms put them."""
    scene = opened(name)
    if scene is None:
        return
    stage = Usd.Stage.Open(str(REFERENCE / name))
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
