"""A scene with traffic and street furniture: a function of scene, seed and time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from hashlib import sha256
from typing import Any

import numpy as np
from scipy import ndimage

from datafactory.scenes.boxes import Movers
from datafactory.scenes.chain import Chain
from datafactory.scenes.ground import Ground, free_ground
from datafactory.scenes.motion import triple
from datafactory.scenes.readers.common import Reading
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import PointTarget, Scene, SceneObject
from datafactory.scenes.streets import Mask
from datafactory.scenes.targets.models import Cyclist, Pedestrian, RcsModel
from datafactory.scenes.things import FOLDER, Label, Population
from datafactory.scenes.traffic.arrange import Arranged, Asked, arrange, asset, parse_populate
from datafactory.scenes.traffic.stretches import HORIZON_S, NARROW, find_stretches
from shared.physics.errors import InputError

METRES_OF_ROAD = {
    "cars": 20.0, "trucks": 20.0, "buses": 20.0, "cyclists": 20.0,
    "pedestrians": 12.5, "poles": 12.5, "signs": 20.0, "bins": 20.0, "benches": 20.0,
}  # fmt: skip
"""Of road that one of a kind calls for: a vehicle every 40 m in either lane, a pole every 25 m on either side."""
LEAST_ROAD_M = 240.0
"""Of road that is populated where there is so much: two stretches of full length. Densities call for no more."""
HEADROOM_M = 3.9
"""Of a lorry, and 0.4 m."""
LITTLE_ROAD_M = LEAST_ROAD_M / 3.0
"""With less of it, lanes without anything beside them are looked for on roads that are named."""
PASSING_S = (60.0, 0.25)
"""How long the scene's own traffic is followed, and in which steps."""


def populated(scene: Scene, asked: Asked, seed: int) -> Scene:
    """The scene with what was asked for, as much of it as there is room for.

    :param seed: of the dataset; the arrangement follows from it and from the scene's content
    :return: with ``population``; what did not fit is among its warnings
    :raises InputError: the scene has no free ground, or is populated: its things would have the names of the new ones
    """
    if scene.population is not None:
        raise InputError("--populate", f"{scene.name} is populated, with {scene.population.text}", "all of it at once")
    ground = free_ground(scene)
    content = int.from_bytes(sha256(scene.content_hash().encode()).digest()[:8], "big")
    rng = np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(content,)))
    wanted_m = max([LEAST_ROAD_M, *(METRES_OF_ROAD[kind] * count for kind, count in asked.counts.items())])
    stretches = find_stretches(ground, passed_by(scene, ground), wanted_m, rng)
    if ground.road.any() and sum(stretch.strip.length_m for stretch in stretches) < LITTLE_ROAD_M:
        ground = free_ground(without_what_hangs(scene, ground))
        stretches = find_stretches(ground, passed_by(scene, ground), wanted_m, rng, NARROW, stretches)
    numbers = asked.along(sum(stretch.strip.length_m for stretch in stretches))
    placements = arrange(stretches, ground, numbers, rng)
    objects, targets = list[SceneObject](), list[PointTarget]()
    for number, placement in enumerate(placements):
        name = f"{FOLDER}/{placement.what}_{number:03d}"
        if placement.kind in ("pedestrians", "cyclists"):
            targets.append(_road_user(name, placement))
        else:
            objects += _meshes(name, placement)
    counted = {kind: sum(item.kind == kind for item in placements) for kind in (*numbers.counts, "parked")}
    population = Population(
        text=asked.text,
        seed=seed,
        asked=asked.counts,
        placed={kind: count for kind, count in counted.items() if kind in numbers.counts or asked.parked},
        roads=tuple(stretch.strip for stretch in stretches),
        horizon_s=HORIZON_S,
    )
    return replace(
        scene,
        objects=(*scene.objects, *objects),
        targets=(*scene.targets, *targets),
        warnings=(*scene.warnings, *population.left_out()),
        population=population,
    )


def without_what_hangs(scene: Scene, ground: Ground) -> Scene:
    """The scene without the triangles that are higher above the nearest free ground than any vehicle."""
    i, j = ndimage.distance_transform_edt(~ground.free, return_distances=False, return_indices=True)
    level, objects = ground.height_m[i, j], []
    for item in scene.objects:
        corners = item.vertices[item.triangles]
        low = corners[..., 2].min(axis=1) - ground.values_at(level, *corners[..., :2].mean(axis=1).T)
        objects.append(replace(item, triangles=item.triangles[low < HEADROOM_M]))
    return replace(scene, objects=tuple(objects))


def recorded(entry: Mapping[str, Any], source: str) -> Scene:
    """The scene of a manifest's entry, read and populated as it was.

    :param source: where it is now
    """
    reading = Reading(tuple(entry.get("variants", {}).items()), entry.get("allow_missing", False))
    scene, put_in = open_scene(source, reading), entry.get("population")
    return scene if put_in is None else populated(scene, parse_populate(put_in["populate"]), put_in["seed"])


def _meshes(name: str, placement: Arranged) -> list[SceneObject]:
    """The meshes of an asset in their place."""
    what, origin, motion = asset(placement.what), np.array(placement.position), placement.motion()
    label, found = _label(name, placement, what.label), []
    for part in what.parts:
        vertices = part.vertices @ placement.axes + origin
        moved = replace(part, name=f"{name}/{part.name}", vertices=vertices, motion=motion, label=label)
        found.append(moved.as_it_moves())
    return found


def _road_user(name: str, placement: Arranged) -> PointTarget:
    """A pedestrian or a cyclist as a target of known cross section."""
    motion = placement.motion()
    assert motion is not None
    cyclist = placement.kind == "cyclists"
    model: RcsModel = Cyclist() if cyclist else Pedestrian(placement.stature_m)
    ahead, left, up = map(triple, placement.axes)
    return PointTarget(
        name, placement.position, model.nominal_rcs_dbsm, motion.velocities[0], model, (ahead, left, up), motion,
        label=_label(name, placement, "bicycle" if cyclist else "pedestrian"),
    )  # fmt: skip


def _label(name: str, placement: Arranged, class_name: str) -> Label:
    """What the boxes of a thing are called, and along which axes they lie."""
    home = np.eye(4)
    home[:3, :3], home[:3, 3] = placement.axes.T, placement.position
    return Label(name, Chain((home,)), class_name)


def passed_by(scene: Scene, ground: Ground) -> Mask:
    """[nx, ny] cells that the scene's own traffic comes near to."""
    movers, marked = Movers(scene), np.zeros_like(ground.free)
    for time_s in np.arange(0.0, *PASSING_S) if movers else ():
        for low, high in movers.boxes(float(time_s)):
            (i, k), (j, m) = ground.cell_of(*np.stack([low[:2] - 1.5, high[:2] + 1.5], axis=1))
            if k >= 0 and m >= 0:
                marked[max(i, 0) : k + 1, max(j, 0) : m + 1] = True
    return marked
