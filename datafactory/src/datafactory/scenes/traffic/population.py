"""A scene with traffic and street furniture: a function of scene, seed and time."""

from __future__ import annotations

from dataclasses import replace
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.chain import Chain
from datafactory.scenes.ground import Ground, free_ground
from datafactory.scenes.labels import Label
from datafactory.scenes.motion import Track, Vector
from datafactory.scenes.scene import PointTarget, Scene, SceneObject
from datafactory.scenes.targets.models import RcsModel
from datafactory.scenes.targets.road_users import Cyclist, Pedestrian
from datafactory.scenes.things import Population, Strip, Thing
from datafactory.scenes.traffic.arrange import Arranged, arrange, asset
from datafactory.scenes.traffic.asked import Asked
from datafactory.scenes.traffic.layout import HORIZON_S
from datafactory.scenes.traffic.stretches import find_stretches

Mask = NDArray[np.bool_]

FOLDER = "populate"
LANE_M = 3.6
"""Half of the two lanes' width: sensors that are drawn on roads stand here."""
METRES_OF_ROAD = {
    "cars": 20.0, "trucks": 20.0, "buses": 20.0, "cyclists": 20.0,
    "pedestrians": 12.5, "poles": 12.5, "signs": 20.0, "bins": 20.0, "benches": 20.0,
}  # fmt: skip
"""Of road that one of a kind calls for: a vehicle every 40 m in either lane, a pole every 25 m on either side."""
LEAST_ROAD_M = 240.0
PASSING_S = (60.0, 0.25)
"""How long the scene's own traffic is followed, and in which steps."""


def populated(scene: Scene, asked: Asked, seed: int) -> Scene:
    """The scene with what was asked for, as much of it as there is room for.

    :param seed: of the dataset; the arrangement follows from it and from the scene's content
    :return: with ``population``; what did not fit is among its warnings
    :raises InputError: the scene has no free ground
    """
    ground = free_ground(scene)
    content = int.from_bytes(sha256(scene.content_hash().encode()).digest()[:8], "big")
    rng = np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(content,)))
    wanted_m = max([LEAST_ROAD_M, *(METRES_OF_ROAD[kind] * count for kind, count in asked.counts.items())])
    stretches = find_stretches(ground, passed_by(scene, ground), wanted_m, rng)
    numbers = asked.along(sum(stretch.strip.length_m for stretch in stretches))
    placements = arrange(stretches, ground, numbers, rng)
    objects, targets, things = list[SceneObject](), list[PointTarget](), list[Thing]()
    for number, placement in enumerate(placements):
        name = f"{FOLDER}/{placement.what}_{number:03d}"
        if placement.kind in ("pedestrians", "cyclists"):
            target, thing = _road_user(name, placement)
            targets.append(target)
        else:
            parts, thing = _meshes(name, placement)
            objects += parts
        things.append(thing)
    counted = {kind: sum(item.kind == kind for item in placements) for kind in (*numbers.counts, "parked")}
    population = Population(
        text=asked.text,
        seed=seed,
        asked=asked.counts,
        placed={kind: count for kind, count in counted.items() if kind in numbers.counts or asked.parked},
        things=tuple(things),
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


def _meshes(name: str, placement: Arranged) -> tuple[list[SceneObject], Thing]:
    """The meshes of an asset in their place."""
    what, motion = asset(placement.what), _motion(placement)
    axes, origin = placement.axes, np.array(placement.position)
    label = _label(name, placement, what.label)
    parts = [
        SceneObject.of(f"{name}/{part}", vertices @ axes + origin, triangles, material, motion=motion, label=label)
        for part, vertices, triangles, material in what.parts
    ]
    low, high = np.array(what.lower), np.array(what.upper)
    foot = np.array([*0.5 * (low + high)[:2], low[2]]) @ axes + origin
    return parts, Thing(name, what.label, _vector(high - low), _vector(foot), _rows(axes), motion)


def _road_user(name: str, placement: Arranged) -> tuple[PointTarget, Thing]:
    """A pedestrian or a cyclist as a target of known cross section."""
    motion, axes = _motion(placement), _rows(placement.axes)
    assert motion is not None
    if placement.kind == "cyclists":
        model: RcsModel = Cyclist()
        kind = "bicycle"
    else:
        model, kind = Pedestrian(placement.stature_m), "pedestrian"
    low, high = np.array(model.extent_m)
    velocity = motion.velocities[0]
    target = PointTarget(
        name,
        placement.position,
        model.nominal_rcs_dbsm,
        velocity,
        model,
        axes,
        motion,
        label=_label(name, placement, kind),
    )
    return target, Thing(name, kind, _vector(high - low), placement.position, axes, motion)


def _label(name: str, placement: Arranged, class_name: str) -> Label:
    """What the boxes of a thing are called, and along which axes they lie."""
    home = np.eye(4)
    home[:3, :3], home[:3, 3] = placement.axes.T, placement.position
    return Label(name, Chain((home,)), class_name)


def _motion(placement: Arranged) -> Track | None:
    if placement.course is None:
        return None
    course, at_m = placement.course
    return course.track(at_m)


def passed_by(scene: Scene, ground: Ground) -> Mask:
    """[nx, ny] cells that the scene's own traffic comes near to."""
    marked = np.zeros_like(ground.free)
    ends, step = PASSING_S
    items: tuple[SceneObject | PointTarget, ...] = (*scene.objects, *scene.targets)
    for item in items:
        if not _moves(item):
            continue
        for time_s in np.arange(0.0, ends, step):
            if isinstance(item, SceneObject):
                vertices = item.at(float(time_s)).vertices[:, :2]
                low, high = vertices.min(axis=0), vertices.max(axis=0)
            else:
                low = high = np.array(item.at(float(time_s)).position[:2])
            (i, k), (j, m) = ground.cell_of(*np.stack([low - 1.5, high + 1.5], axis=1))
            if k < 0 or m < 0 or i >= marked.shape[0] or j >= marked.shape[1]:
                continue
            marked[max(i, 0) : k + 1, max(j, 0) : m + 1] = True
    return marked


def _moves(item: SceneObject | PointTarget) -> bool:
    return item.motion is not None or any(item.velocity)


def sensor_ground(scene: Scene) -> Ground:
    """Where a sensor may be drawn: free of all that stands, and on the roads with traffic first of all.

    What a population moves is left out here: a frame's time is drawn so that it is away.

    :raises InputError: the scene has no free ground
    """
    population = scene.population
    if population is None:
        return free_ground(scene)
    moving = {thing.name for thing in population.movers}
    objects = tuple(item for item in scene.objects if item.name.rpartition("/")[0] not in moving)
    targets = tuple(target for target in scene.targets if target.name not in moving)
    ground = free_ground(replace(scene, objects=objects, targets=targets))
    road = ground.road.copy()
    x, y = np.array(ground.origin)[:, None, None] + (np.indices(road.shape) + 0.5) * ground.cell_m
    for strip in population.roads:
        lanes = Strip(strip.middle, strip.heading_rad, strip.length_m, min(LANE_M, strip.half_width_m))
        road |= ground.free & lanes.holds(x, y)
    return replace(ground, road=road)


def _vector(values: NDArray[np.float64]) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _rows(axes: NDArray[np.float64]) -> tuple[Vector, Vector, Vector]:
    ahead, left, up = (_vector(row) for row in axes)
    return ahead, left, up
