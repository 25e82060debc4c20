"""Skinned meshes posed at every time, by USD's own baking.

``UsdSkel.BakeSkinning`` writes the points that a skeleton's animation makes of a mesh, as samples at the animation's
own times, into a layer of this session. From then on the mesh is one with moving points, straight from sample to
sample. Nothing can be written into a native instance: those with skeletons in them become plain prims first.
"""

from __future__ import annotations

from datafactory.scenes.readers.common import MAXIMUM_NESTING, MAXIMUM_SAMPLED, Notes
from datafactory.scenes.usd_library import Gf, Usd, UsdGeom, UsdSkel


def bake_skinning(usd_stage: Usd.Stage, notes: Notes) -> None:
    """Bake the skinned meshes of a USD stage, as many as ``MAXIMUM_SAMPLED`` coordinates hold; the rest is said."""
    usd_stage.SetEditTarget(Usd.EditTarget(usd_stage.GetSessionLayer()))
    for _ in range(MAXIMUM_NESTING):  # instances within instances come to light one level at a time
        instances = _instances_with_skeletons(usd_stage)
        if not instances:
            break
        for prim in instances:
            prim.SetInstanceable(False)
    total = 0
    for prim in [item for item in usd_stage.Traverse() if item.IsA(UsdSkel.Root)]:
        size = _sampled(prim)
        if total + size > MAXIMUM_SAMPLED:
            notes.count(f"# skeletons left in their rest pose: only {MAXIMUM_SAMPLED} coordinates may be sampled")
            continue
        total += size
        UsdSkel.BakeSkinning(UsdSkel.Root(prim), Gf.Interval.GetFullInterval())


def is_baked(mesh: UsdGeom.Mesh) -> bool:
    """Whether a mesh's points come from :func:`bake_skinning`."""
    session = mesh.GetPrim().GetStage().GetSessionLayer()
    return any(spec.layer == session for spec in mesh.GetPointsAttr().GetPropertyStack(Usd.TimeCode.Default()))


def _instances_with_skeletons(usd_stage: Usd.Stage) -> list[Usd.Prim]:
    """The native instances, within no other, that have a skeleton in them and can be sampled."""
    found = []
    for prototype in usd_stage.GetPrototypes():
        instances = [prim for prim in prototype.GetInstances() if not prim.IsInPrototype()]
        sizes = [_sampled(prim) for prim in Usd.PrimRange(prototype) if prim.IsA(UsdSkel.Root)]
        if not sizes:  # the root of a prototype has no type: it may be the skeleton's root in each instance
            instances = [prim for prim in instances if prim.IsA(UsdSkel.Root)]
            sizes = [_sampled(prototype)]
        if sum(sizes) * len(instances) <= MAXIMUM_SAMPLED:
            found += instances
    return found


def _sampled(root: Usd.Prim) -> int:
    """Coordinates that baking will write, at most: samples of all animations times points of all meshes."""
    samples = points = 0
    for prim in Usd.PrimRange(root):
        if prim.IsA(UsdSkel.Animation):
            animation = UsdSkel.Animation(prim)
            attributes = (animation.GetTranslationsAttr(), animation.GetRotationsAttr(), animation.GetScalesAttr())
            samples = max(samples, *(attribute.GetNumTimeSamples() for attribute in attributes))
        elif prim.IsA(UsdGeom.Mesh):
            values = UsdGeom.Mesh(prim).GetPointsAttr().Get(Usd.TimeCode.EarliestTime())
            points += len(values) if values is not None else 0
    return 3 * samples * points
