"""How many prims a USD file composes to, from its layers alone, before USD composes them.

References and payloads within references multiply: fifty to the fourth power takes a page of text. USD would compose
six million prims, for minutes and gigabytes. The layers are parsed here and their prims counted by multiplication. The
count is an upper bound: prims of several layers that become one count each.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from datafactory.scenes.readers.limits import MAXIMUM_NESTING, MAXIMUM_PRIMS, figure
from datafactory.scenes.usd_library import Sdf, Tf
from shared.physics.errors import InputError

Place = tuple[str, str]
"""Identifier of the root layer of a stack of layers, and a prim's path in it."""


def check_composition(path: Path) -> None:
    """Refuse a USD file that composes to more prims than can be read.

    :raises InputError: naming the first prim with too many below it, with the figure
    :raises pxr.Tf.ErrorException: the root layer cannot be parsed
    """
    layer = Sdf.Layer.FindOrOpen(str(path))
    if layer is not None:
        _Counting(path).prims(layer, Sdf.Path.absoluteRootPath, 0)


class _Counting:
    """Numbers of prims below places of layer stacks, each counted once."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known: dict[Place, int] = {}
        self._open: set[Place] = set()
        self._stacks: dict[str, list[Sdf.Layer]] = {}  # keeps the layers open until USD needs them

    def prims(self, root: Sdf.Layer, at: Sdf.Path, depth: int) -> int:
        """Prims at a path of a layer with its sublayers and below it, the prim itself included."""
        place = root.identifier, str(at)
        if place in self._known:
            return self._known[place]
        if place in self._open:  # a cycle, which USD reports
            return 0
        if depth > 4 * MAXIMUM_NESTING:
            raise InputError(self._path, f"{at}: {depth} prims or references within one another", "fewer")
        self._open.add(place)
        total = 1
        for layer in self._stack(root):
            spec = layer.GetPrimAtPath(at)
            if spec is not None:
                total += self._of_spec(root, layer, spec, depth)
        self._open.remove(place)
        if total > MAXIMUM_PRIMS:
            raise InputError(self._path, f"prim {at} composes {figure(total)} prims", f"at most {MAXIMUM_PRIMS}")
        self._known[place] = total
        return total

    def _of_spec(self, root: Sdf.Layer, layer: Sdf.Layer, spec: Sdf.PrimSpec, depth: int) -> int:
        if spec.HasInfo("active") and not spec.active:
            return 0
        total = sum(self.prims(root, child.path, depth + 1) for child in spec.nameChildren)
        for target, at in _arcs(layer, spec):  # the target's root becomes one with this prim
            total += max(self.prims(root if target is layer else target, at, depth + 1) - 1, 0)
        for variants in spec.variantSets.values():
            total += max(
                (self._of_spec(root, layer, v.primSpec, depth + 1) for v in variants.variants.values()), default=0
            )
        return total

    def _stack(self, root: Sdf.Layer) -> list[Sdf.Layer]:
        """The layer and its sublayers, sublayers of sublayers included, each once."""
        if root.identifier not in self._stacks:
            found = [root]
            for layer in found:
                for name in layer.subLayerPaths:
                    below = _opened(layer, name)
                    if below is not None and below not in found:
                        found.append(below)
            self._stacks[root.identifier] = found
        return self._stacks[root.identifier]


def _arcs(layer: Sdf.Layer, spec: Sdf.PrimSpec) -> Iterator[tuple[Sdf.Layer, Sdf.Path]]:
    """The layers and prims that a prim takes over: by reference, payload, inheritance."""
    for listed in (spec.referenceList, spec.payloadList):
        for arc in listed.GetAddedOrExplicitItems():
            target = _opened(layer, arc.assetPath) if arc.assetPath else layer
            if target is None:  # USD reports it
                continue
            at = arc.primPath or (Sdf.Path(f"/{target.defaultPrim}") if target.defaultPrim else None)
            if at is not None:
                yield target, at
    for listed in (spec.inheritPathList, spec.specializesList):
        for at in listed.GetAddedOrExplicitItems():
            yield layer, at


def _opened(layer: Sdf.Layer, name: str) -> Sdf.Layer | None:
    try:
        return Sdf.Layer.FindOrOpenRelativeToLayer(layer, name)
    except Tf.ErrorException:  # USD meets the same error when it composes
        return None
