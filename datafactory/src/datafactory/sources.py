"""Where frames come from: scenes made ready once, paths traced before, point targets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

from datafactory.order import Order
from datafactory.paths.stage import stage_of
from datafactory.points import PointTargets
from datafactory.scenes.ground import free_ground
from datafactory.scenes.materials import MaterialTable
from datafactory.scenes.open import open_scene
from datafactory.scenes.scene import Scene
from datafactory.worker import (
    PointFrame,
    Recipe,
    SceneFrame,
    SceneWork,
    StoredFrame,
)
from shared.dataset_folder import ShardRecord, read_manifest
from shared.errors import InputError

PATHS = "paths"
"""Folder of traced paths, beside the splits."""

Announce = Callable[[str], None]


@dataclass(frozen=True)
class Sources:
    """Where the frames come from: scenes made ready, or paths traced before.

    :param recipes: one a frame
    :param arguments: what of it determines the bytes, by the names that the user knows
    :param entries: the manifest's ``scenes``
    """

    works: tuple[SceneWork, ...]
    recipes: tuple[Recipe, ...]
    arguments: dict[str, Any]
    entries: list[dict[str, Any]]


def sources_of(order: Order, table: MaterialTable, announce: Announce) -> Sources:
    points: list[Recipe] = [PointFrame(targets) for targets in order.targets] or [PointFrame()] * order.points
    common = {"points": order.points, "targets": [_as_lists(targets) for targets in order.targets]}
    common |= {"seed": order.seed, "split": order.split, "radar": order.radar.model_dump(mode="json")}
    common |= {"versions": {name: version(name) for name in ("sparseradar-datafactory", "sionna-rt")}}
    if order.paths is not None:
        manifest = read_manifest(order.paths)
        records = [ShardRecord.model_validate(item) for item in manifest["shards"] if item["path"].startswith(PATHS)]
        if not records:
            raise InputError(order.paths, "holds no traced paths", "a folder written by datafactory trace")
        stored = [StoredFrame(order.paths / item.path, row) for item in records for row in range(item.rows)]
        arguments = {**common, "paths": [item.sha256 for item in records]}
        return Sources((), (*stored, *points), arguments, manifest["scenes"])
    scenes = [open_scene(source) for source in order.scenes]
    works = tuple(_prepare(scene, table, draw=not order.poses, announce=announce) for scene in scenes)
    recipes = [
        SceneFrame(index % len(scenes), order.poses[index] if order.poses else None)
        for index in range(len(order.poses) or order.frames)
    ]
    arguments = {
        **common,
        "scenes": [{"scene": scene.name, "content": scene.content_hash()} for scene in scenes],
        "materials": [work.materials.to_json() for work in works],
        "frames": order.frames,
        "poses": [asdict(pose) for pose in order.poses],
        "trace": asdict(order.trace),
    }
    entries = [_scene_entry(scene, work) for scene, work in zip(scenes, works, strict=True)]
    return Sources(works, (*recipes, *points), arguments, entries)


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
