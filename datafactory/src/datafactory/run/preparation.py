"""An order's inputs made ready: scenes opened and merged, frames dealt.

Rendering, tracing, ``plan``, the accuracy sweep and the error budget all start from here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version
from itertools import combinations
from typing import Any

import numpy as np

from datafactory.effects.catalogue import ALL, NO_CHOICE
from datafactory.frame.deal import Deal, PreparedScene, drawn_scene, generator, sequence_seed, split_of
from datafactory.frame.points import PointTargets
from datafactory.paths.merged_scene import merge_scene
from datafactory.run.memory import Load
from datafactory.run.order import Order, StoredPaths, stored_paths
from datafactory.scenes.boxes import CLEAR_M, Movers, boxed_things
from datafactory.scenes.drives import CRUISING_SPEEDS, draw_drive
from datafactory.scenes.ground import Ground
from datafactory.scenes.materials.table import MaterialMapping, MaterialTable
from datafactory.scenes.poses import DRAWN_SPEEDS, Pose
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from datafactory.scenes.tracks import nearest_m
from datafactory.scenes.traffic.population import sensor_ground
from shared.dataset.locations import Location

Announce = Callable[[str], None]


@dataclass(frozen=True)
class Prepared:
    """What a run starts from.

    :param scenes: those that are traced; none where paths were traced before
    :param deal: which frame is which
    :param stored: shard and row of every scene frame whose paths were traced before
    :param arguments: what of it determines the bytes, by the names that the user knows
    :param entries: the manifest's ``scenes``
    """

    scenes: tuple[PreparedScene, ...]
    deal: Deal
    stored: tuple[tuple[Location, int], ...]
    arguments: dict[str, Any]
    entries: list[dict[str, Any]]


def prepare(
    order: Order,
    table: MaterialTable,
    announce: Announce = lambda line: None,
) -> Prepared:
    """Make an order's inputs ready.

    :raises InputError: whatever is wrong with a scene or with a folder of traced paths
    """
    if order.traced is not None:
        return _from_stored(order, stored_paths(order, order.traced))
    if said := _named_in_vain(order):
        announce(said)
    opened = opened_scenes(order)
    scenes = tuple(prepared_scene(scene, table, announce) for scene in opened)
    for scene in opened:
        if said := _late_poses(scene, order.given):
            announce(said)
    deal = deal_of(order, opened)
    for scene in opened if order.drives is not None else ():
        if said := _late_poses(scene, [pose for track in deal.tracks for pose in track]):
            announce(said)
    for said in (*close_tracks(deal), *_poses_in_traffic(deal, opened)):
        announce(said)
    arguments = {
        **_common_arguments(order),
        "scenes": [{"scene": scene.name, "content": scene.content} for scene in scenes],
        "materials": [scene.materials.to_json() for scene in scenes],
        "frames": order.frames,
        "poses": [asdict(pose) for pose in order.poses],
        "tracks": [[asdict(pose) for pose in track] for track in order.tracks],
        "drives": None if order.drives is None else asdict(order.drives),
        "trace": asdict(order.settings.trace),
        **({} if order.speeds is None else {"speed_mps": list(order.speeds)}),
    }
    entries = [_entry(source, scene.materials) for source, scene in zip(opened, scenes, strict=True)]
    return Prepared(scenes, deal, (), arguments, entries)


def opened_scenes(order: Order) -> list[Scene]:
    """The scenes of an order, read where they are named.

    :raises InputError: a scene that cannot be read
    """
    return [scene if isinstance(scene, Scene) else open_scene(scene) for scene in order.scenes]


def load_of(order: Order, scenes: Sequence[Scene], rendered: bool = True) -> Load:
    """What decides over the memory of a run.

    :param scenes: of the order, see :func:`opened_scenes`
    :param rendered: whether cubes are made
    """
    return Load(
        order.radar,
        order.settings,
        triangles=sum(scene.triangle_count for scene in scenes),
        traced=bool(scenes),
        rendered=rendered,
        stored_rays=0 if order.traced is None else order.traced.rays,
    )


def deal_of(order: Order, scenes: Sequence[Scene]) -> Deal:
    """How the frames of an order are dealt to its scenes.

    :raises InputError: no free ground, or no lane for a drive
    """
    grounds = () if order.given else tuple(sensor_ground(scene) for scene in scenes)
    tracks = drawn_tracks(order, scenes, grounds) if order.drives is not None else order.tracks
    number_of = partial(drawn_scene, scenes=len(scenes), pattern=order.split)
    return Deal(
        seed=order.seed,
        pattern=order.split,
        scenes=len(scenes),
        frames=0 if tracks else order.frames,
        poses=order.poses,
        tracks=tracks,
        track_scenes=tuple(number_of(k) if order.drives is not None else k % len(scenes) for k in range(len(tracks))),
        grounds=grounds,
        speeds=order.speeds or DRAWN_SPEEDS,
        traffic=tuple(map(Movers, scenes)),
        points=order.points,
        targets=order.targets,
    )


def drawn_tracks(order: Order, scenes: Sequence[Scene], grounds: Sequence[Ground]) -> tuple[tuple[Pose, ...], ...]:
    """The drives of an order, the last cut where the frames end; each in its scene and in the region of its split."""
    asked = order.drives
    if asked is None or not order.frames:
        return ()
    tracks, movers = [], [Movers(scene) for scene in scenes]
    for number in range(-(-order.frames // asked.frames)):
        scene = drawn_scene(number, len(scenes), order.split)
        stream = generator(sequence_seed(order.seed, number), "pose")
        split, speeds = split_of(number, order.split), order.speeds or CRUISING_SPEEDS
        tracks.append(draw_drive(grounds[scene], movers[scene], split, asked, stream, speeds))
    over = len(tracks) * asked.frames - order.frames
    return (*tracks[:-1], tracks[-1][: asked.frames - over])


NEIGHBOURS_M = 10.0
"""Tracks of different splits in one scene that come nearer than this are told: a test would be of what was trained."""


def close_tracks(deal: Deal) -> list[str]:
    """What to say of tracks of different splits that come near each other."""
    said = []
    for one, other in combinations(range(len(deal.tracks)), 2):
        splits = split_of(one, deal.pattern), split_of(other, deal.pattern)
        if splits[0] == splits[1] or deal.track_scenes[one] != deal.track_scenes[other]:
            continue
        if (apart_m := nearest_m(deal.tracks[one], deal.tracks[other])) < NEIGHBOURS_M:
            said.append(
                f"sequences {one} ({splits[0]}) and {other} ({splits[1]}) come within {apart_m:.1f} m of each other"
            )
    return said


def deal_of_stored(order: Order, stored: StoredPaths) -> Deal:
    """How the frames of paths that were traced before are dealt: as their rows say."""
    return Deal(
        seed=order.seed,
        pattern=order.split,
        scenes=len(stored.entries),
        traced=stored.scene_numbers,
        traced_sequences=stored.sequences,
        points=order.points,
        targets=order.targets,
    )


def _from_stored(order: Order, stored: StoredPaths) -> Prepared:
    deal = deal_of_stored(order, stored)
    arguments = {
        **_common_arguments(order),
        "paths": list(stored.checksums),
    }
    return Prepared((), deal, stored.places, arguments, stored.entries)


def _common_arguments(order: Order) -> dict[str, Any]:
    return {
        "effects": "auto" if order.effects is None else order.effects.names,
        "budget_db": order.budget_db if order.effects is None else None,
        "points": order.points,
        "targets": [_as_lists(targets) for targets in order.targets],
        "seed": order.seed,
        "split": order.split,
        "radar": order.radar.model_dump(mode="json"),
        "device": order.settings.device,
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
    if scene.population is not None:
        announce(f"{scene.name}: {scene.population.line()}")
    mapped = [f"{name or '(none)'} -> {material.name}" for name, (material, _) in materials.entries.items()
              if name != material.name]  # fmt: skip
    told = f"{len(materials.entries)} materials{', ' if mapped else ''}{', '.join(mapped)}"
    announce(f"{scene.name}: {len(scene.objects)} objects, {scene.triangle_count} triangles, {told}")
    unknown = ", ".join(name or "(none)" for name in materials.unknown)
    if unknown:
        announce(f"{scene.name}: unknown materials given the default: {unknown}")
    return PreparedScene(
        scene.name, scene.content_hash(), merge_scene(scene, materials), materials, boxed_things(scene)
    )


def _named_in_vain(order: Order) -> str:
    """What to say of effects that were chosen and are no choice; "" without such."""
    if order.effects is None or order.effects == ALL:
        return ""
    named = ", ".join(name for name in NO_CHOICE if getattr(order.effects, name))
    return f"--effects: {named} made no difference: simulated wherever something to work on is" if named else ""


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


def _poses_in_traffic(deal: Deal, scenes: Sequence[Scene]) -> list[str]:
    """What to say of given poses that something of a population drives or walks through."""
    traffic = [Movers(scene) for scene in scenes]
    given = [(traffic[deal.scene_of(n)], pose) for n, pose in enumerate(deal.poses)]
    near = sum(movers.populated_s is not None and not movers.clear_of([pose]) for movers, pose in given)
    return [f"{near} of {len(given)} poses are within {CLEAR_M:g} m of what drives or walks by"] if near else []


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
        **({} if scene.population is None else {"population": scene.population.to_json()}),
    }
