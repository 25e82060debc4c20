"""How many objects and triangles a USD stage expands to, by multiplication, before anything is expanded."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datafactory.scenes.readers.limits import MAXIMUM_NESTING, check_counts
from datafactory.scenes.readers.usd_facts import FactsOfPrims, has_shape
from datafactory.scenes.readers.usd_prims import solid_mesh, whole_numbers
from datafactory.scenes.usd_library import Sdf, Usd, UsdGeom
from shared.physics.errors import InputError

SCENE_PRIMS = Usd.TraverseInstanceProxies()  # active, loaded, defined, not abstract
# The prims of a prototype are often overs or classes.
PROTOTYPE_PRIMS = Usd.TraverseInstanceProxies(Usd.PrimIsActive & Usd.PrimIsLoaded)
HIDDEN_PURPOSES = ("guide", "proxy")


@dataclass(frozen=True)
class Size:
    """Objects (point targets among them) and triangles of a part of a scene."""

    objects: int = 0
    triangles: int = 0

    def plus(self, other: Size, times: int = 1) -> Size:
        return Size(self.objects + times * other.objects, self.triangles + times * other.triangles)


def check_expansion(path: Path, root: Usd.Prim, facts: FactsOfPrims, start: Usd.TimeCode) -> None:
    """Refuse a USD stage whose instances and point instancers expand to more than a scene may hold.

    :param root: the stage's pseudo root
    :raises InputError: naming the first prim whose own expansion is too large, or the whole scene
    """
    size = _Counting(path, facts, start).of(root.GetFilteredChildren(SCENE_PRIMS), _Context(SCENE_PRIMS))
    check_counts(path, "the scene", size.objects, size.triangles)


@dataclass(frozen=True)
class _Context:
    """What the prims of a subtree inherit, and how deep the subtree lies within instances."""

    predicate: Usd._PrimFlagsPredicate
    purpose: str = "default"
    by_name: bool = False
    nesting: int = 0


class _Counting:
    """Sizes of subtrees; that of a prototype is counted once, however often it is repeated.

    Prims with an attribute that cannot be used count as empty: reading refuses them, with their own path.
    """

    def __init__(self, path: Path, facts: FactsOfPrims, start: Usd.TimeCode) -> None:
        self._path = path
        self._facts = facts
        self._start = start
        self._prototypes: dict[tuple[Sdf.Path, str, bool], Size] = {}
        self._solids: dict[str, int] = {}
        self._instancers: list[Sdf.Path] = []

    def of(self, prims: Iterable[Usd.Prim], context: _Context) -> Size:
        """The size of these prims and of everything below them."""
        size = Size()
        waiting = [(prim, context) for prim in prims]
        while waiting:
            prim, outer = waiting.pop()
            own = self._own(prim, outer)
            if own is None:
                continue
            part, context, goes_on = own
            size = size.plus(part)
            if goes_on and prim.IsInstance():
                size = size.plus(self._of_instance(prim, context))
            elif goes_on:
                waiting += [(child, context) for child in prim.GetFilteredChildren(context.predicate)]
        return size

    def _own(self, prim: Usd.Prim, context: _Context) -> tuple[Size, _Context, bool] | None:
        """The prim's own size, what it passes on, and whether the prims below it count; None for a hidden prim."""
        try:
            facts = self._facts.of(prim)
            if not facts.visible:
                return None
            by_name = context.by_name if facts.targets_by_name is None else facts.targets_by_name
            context = replace(context, purpose=facts.purpose or context.purpose, by_name=by_name)
            if context.purpose in HIDDEN_PURPOSES:
                return Size(), context, True
            if facts.has_rcs or self._facts.kind(prim, by_name) is not None:
                return Size(objects=1), context, False
        except InputError:
            return None
        if facts.is_instancer:
            return self._of_instancer(UsdGeom.PointInstancer(prim), context), context, False
        if has_shape(prim):
            return Size(1, self._triangles(prim)), context, True
        return Size(objects=int(prim.IsA(UsdGeom.Subset))), context, True

    def _of_instance(self, prim: Usd.Prim, context: _Context) -> Size:
        prototype = prim.GetPrototype()
        children = prototype.GetFilteredChildren(context.predicate)
        size = self._once(prototype.GetPath(), children, context)
        check_counts(self._path, f"instance {prim.GetPath()}", size.objects, size.triangles)
        return size

    def _of_instancer(self, instancer: UsdGeom.PointInstancer, context: _Context) -> Size:
        path = instancer.GetPath()
        if path in self._instancers:
            raise InputError(self._path, f"point instancer {path} is within its own prototypes", "no such loop")
        usd_stage = instancer.GetPrim().GetStage()
        prototypes = [usd_stage.GetPrimAtPath(t) for t in instancer.GetPrototypesRel().GetForwardedTargets()]
        indices = whole_numbers(instancer.GetProtoIndicesAttr(), self._start)
        self._instancers.append(path)
        size = Size()
        for index, times in sorted(Counter(indices.tolist()).items()):
            if 0 <= index < len(prototypes) and prototypes[index]:  # reading refuses the others
                prototype = prototypes[index]
                part = self._once(prototype.GetPath(), [prototype], replace(context, predicate=PROTOTYPE_PRIMS))
                size = size.plus(part, times)
        self._instancers.pop()
        check_counts(self._path, f"point instancer {path}", size.objects, size.triangles)
        return size

    def _once(self, path: Sdf.Path, prims: Iterable[Usd.Prim], context: _Context) -> Size:
        """The size of a prototype's prims, counted at the first call for its path."""
        key = path, context.purpose, context.by_name
        if key not in self._prototypes:
            if context.nesting >= MAXIMUM_NESTING:
                problem = f"{path} lies within {context.nesting} levels of instances"
                raise InputError(self._path, problem, f"fewer than {MAXIMUM_NESTING}")
            self._prototypes[key] = self.of(prims, replace(context, nesting=context.nesting + 1))
        return self._prototypes[key]

    def _triangles(self, prim: Usd.Prim) -> int:
        """Triangles of a Mesh or a solid, before any is dropped."""
        if prim.IsA(UsdGeom.Mesh):
            corners = whole_numbers(UsdGeom.Mesh(prim).GetFaceVertexCountsAttr(), self._start)
            return int(np.maximum(corners - 2, 0).sum())
        kind = str(prim.GetTypeName())
        if kind not in self._solids:
            try:
                self._solids[kind] = len(solid_mesh(prim, self._start).triangles)
            except InputError:
                return 0
        return self._solids[kind]
