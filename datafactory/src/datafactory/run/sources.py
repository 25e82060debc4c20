"""Where frames come from: scenes made ready once, paths traced before, point targets."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from datafactory.effects.catalogue import PATH_EFFECTS, EffectSet
from datafactory.effects.evidence import Evidence, Probe
from datafactory.effects.plan import EffectPlan, by_choice, decide
from datafactory.effects.planning import gathered, looked_at
from datafactory.frame.points import PointTargets
from datafactory.frame.seeds import frame_seed, generator
from datafactory.paths.merged_scene import stage_of
from datafactory.run.job import (
    PointFrame,
    Recipe,
    SceneFrame,
    SceneWork,
    StoredFrame,
)
from datafactory.run.order import Order
from datafactory.run.shards import parse_split_pattern, split_of
from datafactory.scenes.ground import free_ground
from datafactory.scenes.materials.table import MaterialTable
from datafactory.scenes.poses import sample_pose
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from shared.dataset.folder import MANIFEST, ShardRecord, read_manifest
from shared.physics.errors import InputError

PATHS = "paths"
"""Folder of traced paths, beside the splits."""

Announce = Callable[[str], None]


@dataclass(frozen=True)
class Sources:
    """Where the frames come from: scenes made ready, or paths traced before.

    :param recipes: one a frame
    :param arguments: what of it determines the bytes, by the names that the user knows
    :param entries: the manifest's ``scenes``
    :param probes: first frame of every scene with its plan, to say afterwards what the plan saved
    """

    works: tuple[SceneWork, ...]
    recipes: tuple[Recipe, ...]
    arguments: dict[str, Any]
    entries: list[dict[str, Any]]
    probes: tuple[tuple[str, Probe, EffectSet], ...] = ()


def scene_of(index: int, scenes: int, pattern: str) -> int:
    """Scene of frame ``index``: in turn, so that every split has frames of every scene.

    Four scenes in turn under eight splits in turn would meet always alike, all test frames in the last scene. Where the
    numbers have a common divisor the turn begins one scene later each time that both have come round.

    :param scenes: their number
    :param pattern: see :func:`datafactory.run.shards.split_of`
    """
    splits = sum(parse_split_pattern(pattern))
    rounds = index // math.lcm(scenes, splits) if math.gcd(scenes, splits) > 1 else 0
    return (index + rounds) % scenes


def sources_of(order: Order, table: MaterialTable, announce: Announce) -> Sources:
    points: list[Recipe] = [PointFrame(targets) for targets in order.targets] or [PointFrame()] * order.points
    common = {"points": order.points, "targets": [_as_lists(targets) for targets in order.targets]}
    common |= {"seed": order.seed, "split": order.split, "radar": order.radar.model_dump(mode="json")}
    common |= {"versions": {name: version(name) for name in ("sparseradar-datafactory", "sionna-rt")}}
    if order.paths is not None:
        return _stored(order, order.paths, points, common)
    scenes = [open_scene(source) for source in order.scenes]
    prepared = [_prepare(scene, table, draw=not order.poses, announce=announce) for scene in scenes]
    plans = [
        _plan(order, index, scene, work, announce)
        for index, (scene, work) in enumerate(zip(scenes, prepared, strict=True))
    ]
    works = tuple(replace(work, effects=plan.effects) for work, plan in zip(prepared, plans, strict=True))
    recipes = (
        [SceneFrame(index % len(scenes), pose) for index, pose in enumerate(order.poses)]
        if order.poses
        else [SceneFrame(scene_of(index, len(scenes), order.split), None) for index in range(order.frames)]
    )
    arguments = {
        **common,
        "scenes": [{"scene": scene.name, "content": scene.content_hash()} for scene in scenes],
        "materials": [work.materials.to_json() for work in works],
        "frames": order.frames,
        "poses": [asdict(pose) for pose in order.poses],
        "trace": asdict(order.trace),
        "effects": [work.effects.names for work in works],
    }
    entries = [
        {**_scene_entry(scene, work), "effect_plan": plan.to_json()}
        for scene, work, plan in zip(scenes, works, plans, strict=True)
    ]
    probes = tuple(
        (work.name, probe, work.effects)
        for work, probe in zip(works, (_probe(order, index, work) for index, work in enumerate(works)), strict=True)
        if probe.poses
    )
    return Sources(works, (*recipes, *points), arguments, entries, probes)


def _stored(order: Order, folder: Path, points: list[Recipe], common: dict[str, Any]) -> Sources:
    """Paths traced before, with the effects that they were traced with, or those asked for where they hold them."""
    manifest = read_manifest(folder)
    records = [ShardRecord.model_validate(item) for item in manifest["shards"] if item["path"].startswith(PATHS)]
    if not records:
        raise InputError(folder, "holds no traced paths", "a folder written by datafactory trace")
    try:
        traced, wanted = manifest["arguments"]["radar"]["front_end"], order.radar.front_end
        plans = [
            EffectSet.of({item["effect"] for item in entry["effect_plan"]["effects"] if item["on"]})
            for entry in manifest["scenes"]
        ]
    except (KeyError, TypeError) as error:
        problem = f"its entries arguments.radar.front_end and scenes.effect_plan are not understood ({error!r})"
        raise InputError(folder / MANIFEST, problem, "paths traced by this version") from None
    for field in ("tx_polarization", "rx_polarization"):
        if traced.get(field, "V") != getattr(wanted, field):
            problem = (
                f"paths were traced with {field} = {traced.get(field, 'V')!r}, the radar has {getattr(wanted, field)!r}"
            )
            raise InputError(folder, problem, "the same polarisation, or datafactory trace with this radar")
    entries = manifest["scenes"]
    if order.effects is not None:
        for entry, effects in zip(entries, plans, strict=True):
            _require_same_paths(folder, entry["name"], effects, order.effects)
        plans = [order.effects] * len(plans)
        entries = [{**entry, "effect_plan": by_choice(entry["name"], order.effects).to_json()} for entry in entries]
    stored, frame = list[Recipe](), 0
    for record in records:
        for row in range(record.rows):
            stored.append(StoredFrame(folder / record.path, row, plans[frame % len(plans)]))
            frame += 1
    names = [effects.names for effects in plans]
    arguments = {**common, "paths": [item.sha256 for item in records], "effects": names}
    return Sources((), (*stored, *points), arguments, entries)


def _require_same_paths(folder: Path, scene: str, traced: EffectSet, asked: EffectSet) -> None:
    """Which paths there are was settled when they were traced."""
    for name in PATH_EFFECTS:
        if getattr(traced, name) != getattr(asked, name):
            had, wants = ("with", "without") if getattr(traced, name) else ("without", "with")
            problem = f"the paths of {scene} were traced {had} {name}, --effects asks for frames {wants} it"
            raise InputError(folder, problem, "--effects auto, or datafactory trace with these effects")


def scene_plan(
    order: Order, table: MaterialTable, announce: Announce
) -> tuple[Probe, EffectPlan, Mapping[str, Evidence]]:
    """The plan of an order's first scene, with what it was made from."""
    scene = open_scene(order.scenes[0])
    work = _prepare(scene, table, draw=not order.poses, announce=lambda line: None)
    probe = _probe(order, 0, work)
    evidence = gathered(scene.content_hash(), probe, announce)
    return probe, decide(scene.name, evidence, order.budget_db), evidence


def _plan(order: Order, index: int, scene: Scene, work: SceneWork, announce: Announce) -> EffectPlan:
    """What is simulated of the order's scene number ``index``: what was asked for, or what its own frames call for."""
    if order.effects is not None:
        return by_choice(scene.name, order.effects)
    plan = decide(scene.name, gathered(scene.content_hash(), _probe(order, index, work), announce), order.budget_db)
    left_out = ", ".join(item.effect for item in plan.decisions if not item.on) or "nothing"
    simulated = ", ".join(plan.effects.names) or "none"
    announce(f"{scene.name}: effects {simulated}; left out {left_out} (datafactory plan says why)")
    return plan


def _probe(order: Order, index: int, work: SceneWork) -> Probe:
    chosen = looked_at(range(index, len(order.poses) or order.frames, len(order.scenes)))
    if work.ground is not None:
        poses = tuple(
            sample_pose(work.ground, split_of(frame, order.split), generator(frame_seed(order.seed, frame), "pose"))
            for frame in chosen
        )
    else:
        poses = tuple(order.poses[frame] for frame in chosen)
    front_end = order.radar.front_end
    settings = replace(order.trace, polarization=(front_end.tx_polarization, front_end.rx_polarization))
    return Probe(work.stage, work.materials, poses, order.radar, settings, order.seed)


def _as_lists(targets: PointTargets) -> dict[str, Any]:
    return {name: values.tolist() for name, values in vars(targets).items()}


def _prepare(scene: Scene, table: MaterialTable, draw: bool, announce: Callable[[str], None]) -> SceneWork:
    materials = table.map_materials([item.material for item in scene.objects])
    for warning in scene.warnings:
        announce(f"{scene.name}: {warning}")
    pairs = ", ".join(f"{name or '(none)'} -> {material.name}" for name, (material, _) in materials.entries.items())
    announce(f"{scene.name}: {len(scene.objects)} objects, {scene.triangle_count} triangles; materials {pairs}")
    unknown = ", ".join(name or "(none)" for name in materials.unknown)
    if unknown:
        announce(f"{scene.name}: unknown materials given the default: {unknown}")
    return SceneWork(scene.name, stage_of(scene, materials), materials, free_ground(scene) if draw else None)


def _scene_entry(scene: Scene, work: SceneWork) -> dict[str, Any]:
    return {
        "name": scene.name,
        "source": scene.source,
        "content_sha256": scene.content_hash(),
        "objects": len(scene.objects),
        "triangles": scene.triangle_count,
        "point_targets": len(scene.targets),
        "warnings": list(scene.warnings),
        "materials": work.materials.to_json(),
    }
