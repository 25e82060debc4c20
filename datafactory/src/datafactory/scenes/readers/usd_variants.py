"""The variants of a USD stage that the user selects, over what the file selects."""

from __future__ import annotations

from collections import defaultdict

from datafactory.scenes.readers.common import MAXIMUM_NESTING
from datafactory.scenes.usd_library import Usd
from shared.physics.errors import InputError


def select_variants(usd_stage: Usd.Stage, variants: tuple[tuple[str, str], ...]) -> None:
    """Select variants on every prim that has them, in a layer of this session.

    A variant may bring in prims with further sets, so that it is repeated until nothing changes. Instances that have
    such a prim in them become plain prims: nothing can be selected within an instance.

    :param variants: (set, variant)
    :raises InputError: no prim has the set, or none of its sets has the variant
    """
    if not variants:
        return
    usd_stage.SetEditTarget(Usd.EditTarget(usd_stage.GetSessionLayer()))
    known: dict[str, set[str]] = defaultdict(set)
    for _ in range(MAXIMUM_NESTING):
        changed = False
        for prim in list(usd_stage.Traverse()):
            for name, variant in _differing(prim, variants, known):
                prim.GetVariantSet(name).SetVariantSelection(variant)
                changed = True
        for prototype in usd_stage.GetPrototypes():
            inner = (prim for prim in Usd.PrimRange(prototype) if prim != prototype)
            if any([_differing(prim, variants, known) for prim in inner]):
                for instance in prototype.GetInstances():
                    if not instance.IsInPrototype():
                        instance.SetInstanceable(False)
                        changed = True
        if not changed:
            break
    for name, variant in variants:
        if name not in known:
            sets = ", ".join(sorted(known)) or "none: the file has no variant sets"
            raise InputError("--variant", f"no prim has a variant set {name!r}", sets)
        if variant not in known[name]:
            raise InputError("--variant", f"{name} has no variant {variant!r}", ", ".join(sorted(known[name])))


def _differing(
    prim: Usd.Prim, variants: tuple[tuple[str, str], ...], known: dict[str, set[str]]
) -> list[tuple[str, str]]:
    """Those of the variants that the prim has and does not select; ``known`` takes all that it has."""
    if not prim or not prim.HasVariantSets():
        return []
    sets = prim.GetVariantSets()
    for name in sets.GetNames():
        known[name].update(sets.GetVariantSet(name).GetVariantNames())
    wanted = [(name, variant) for name, variant in variants if sets.HasVariantSet(name)]
    return [
        (name, variant)
        for name, variant in wanted
        if variant in sets.GetVariantSet(name).GetVariantNames()
        and sets.GetVariantSet(name).GetVariantSelection() != variant
    ]
