"""An order's inputs made ready: scenes opened and merged, frames dealt, effects planned.

Rendering, tracing, ``plan``, the accuracy sweep and the error budget all start from here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

import numpy as np

from datafactory.effects.plan import EffectPlan
from datafactory.frame.deal import Deal
from datafactory.frame.points import PointTargets
from datafactory.frame.prepared import PreparedScene, Sample
from datafactory.paths.curved_surfaces import curved_surfaces_of
from datafactory.paths.merged_scene import merge_scene
from datafactory.run.order import Order
from datafactory.run.planning import Looking, plan_of, sample_of
from datafactory.run.stored import StoredPaths, stored_paths
from datafactory.scenes.ground import Ground, free_ground
from datafactory.scenes.materials.table import MaterialMapping, MaterialTable
from datafactory.scenes.poses import Pose
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from shared.dataset.locations import Location

Announce = Callable[[str], None]


@dataclass(frozen=True)
class Prepared:
    """What a run starts from.

    :param scenes: those that are traced; none where paths were traced before
    :param deal: which frame is which
    :param samples: the frames of each scene that its plan was made from; none where paths were traced before
    :param plans: what is simulated of each scene, and why
    :param stored: shard and row of every scene frame whose paths were traced before
    :param arguments: what of it determines the bytes, by the names that the user knows
    :param entries: the manifest's ``scenes``
    """

    scenes: tuple[PreparedScene, ...]
    deal: Deal
    samples: tuple[Sample, ...]
    plans: tuple[EffectPlan, ...]
    stored: tuple[tuple[Location, int], ...]
    arguments: dict[str, Any]
    entries: list[dict[str, Any]]


def prepare(
    order: Order,
    table: MaterialTable,
    announce: Announce = lambda line: None,
    looked: Callable[[int, int], None] = lambda done, total: None,
) -> Prepared:
    """Make an order's inputs ready.

    :param looked: takes frames looked at for the plan, and how many there are to look at
    :raises InputError: whatever is wrong with a scene or with a folder of traced paths
    """
    if order.paths is not None:
        return _from_stored(order, stored_paths(order, order.paths))
    opened = [scene if isinstance(scene, Scene) else open_scene(scene) for scene in order.scenes]
    scenes = tuple(prepared_scene(scene, table, announce) for scene in opened)
    for scene in opened:
        if said := _late_poses(scene, order.poses):
            announce(said)
    deal = deal_of(order, opened)
    samples = tuple(sample_of(deal, number, scene) for number, scene in enumerate(scenes))
    looking = Looking(sum(len(sample.frames) for sample in samples), looked)
    plans = tuple(plan_of(order, sample, announce, looking) for sample in samples)
    arguments = {
        **_common_arguments(order),
        "scenes": [{"scene": scene.name, "content": scene.content} for scene in scenes],
        "materials": [scene.materials.to_json() for scene in scenes],
        "frames": order.frames,
        "poses": [asdict(pose) for pose in order.poses],
        "trace": asdict(order.settings.trace),
        **_planned_arguments(plans),
    }
    entries = [
        {**_entry(source, scene.materials), "effect_plan": plan.to_json()}
        for source, scene, plan in zip(opened, scenes, plans, strict=True)
    ]
    return Prepared(scenes, deal, samples, plans, (), arguments, entries)


def deal_of(order: Order, scenes: Sequence[Scene]) -> Deal:
    """How the frames of an order are dealt to its scenes."""
    grounds: tuple[Ground, ...] = () if order.poses else tuple(free_ground(scene) for scene in scenes)
    return Deal(
        seed=order.seed,
        pattern=order.split,
        scenes=len(scenes),
        frames=order.frames,
        poses=order.poses,
        grounds=grounds,
        points=order.points,
        targets=order.targets,
    )


def _from_stored(order: Order, stored: StoredPaths) -> Prepared:
    deal = Deal(
        seed=order.seed,
        pattern=order.split,
        scenes=len(stored.entries),
        traced=stored.scene_numbers,
        points=order.points,
        targets=order.targets,
    )
    arguments = {
        **_common_arguments(order),
        "paths": list(stored.checksums),
        **_planned_arguments(stored.plans),
    }
    return Prepared((), deal, (), stored.plans, stored.places, arguments, stored.entries)


def _planned_arguments(plans: Sequence[EffectPlan]) -> dict[str, Any]:
    """What of the plans determines the bytes."""
    return {
        "effects": [plan.effects.names for plan in plans],
        "effects_by_frame": [
            None if plan.by_frame is None else {"budget_db": plan.budget_db, **asdict(plan.by_frame)} for plan in plans
        ],
    }


def _common_arguments(order: Order) -> dict[str, Any]:
    return {
        "points": order.points,
        "targets": [_as_lists(targets) for targets in order.targets],
        "seed": order.seed,
        "split": order.split,
        "radar": order.radar.model_dump(mode="json"),
        "versions": {name: version(name) for name in ("sparseradar-datafactory", "sionna-rt")},
    }


def _as_lists(targets: PointTargets) -> dict[str, Any]:
    arrays = {name: values.tolist() for name, values in vars(targets).items() if name != "models"}
    return arrays | ({"models": [repr(target) for target in targets.models]} if targets.models else {})


def prepared_scene(scene: Scene, table: MaterialTable, announce: Announce) -> PreparedScene:
    """A scene merged, its materials mapped; what was ignored or assumed is announced."""
    materials = table.map_materials([item.material for item in scene.objects])
    for warning in scene.warnings:
        announce(f"{scene.name}: {warning}")
    pairs = ", ".join(f"{name or '(none)'} -> {material.name}" for name, (material, _) in materials.entries.items())
    announce(f"{scene.name}: {len(scene.objects)} objects, {scene.triangle_count} triangles; materials {pairs}")
    unknown = ", ".join(name or "(none)" for name in materials.unknown)
    if unknown:
        announce(f"{scene.name}: unknown materials given the default: {unknown}")
    merged = merge_scene(scene, materials)
    for note in curved_surfaces_of(merged).notes():
        announce(f"{scene.name}: {note}")
    return PreparedScene(scene.name, scene.content_hash(), merged, materials)


def _late_poses(scene: Scene, poses: Sequence[Pose]) -> str:
    """What to say of poses at which everything that had samples stands still; "" without such."""
    motions = [item.motion for item in scene.objects] + [target.motion for target in scene.targets]
    ends_s = max((motion.ends_s for motion in motions if motion is not None), default=np.inf)
    late = sum(pose.time_s >= ends_s for pose in poses)
    if not late:
        return ""
    return (
        f"{scene.name}: {late} of {len(poses)} poses are not before {ends_s:g} s, from when on what has samples rests"
    )


def _entry(scene: Scene, materials: MaterialMapping) -> dict[str, Any]:
    return {
        "name": scene.name,
        "source": scene.source,
        "content_sha256": scene.content_hash(),
        "objects": len(scene.objects),
        "triangles": scene.triangle_count,
        "point_targets": len(scene.targets),
        "warnings": list(scene.warnings),
        "materials": materials.to_json(),
    }
