"""Where a scene's things are at a time: oriented boxes around them, their velocities, and who keeps clear of them.

A box stands in its thing's own axes, as the source has them. Up is the one of the thing's axes that points closest to
the world's up at time 0, forward its x (its y where x is the one that points up). The axes turn with the thing; the box
is the smallest in these axes that holds all vertices at the time. A thing whose axes are unknown has the world's.

The velocity of a box's centre is that of the thing's own frame there, M'(t) M(t)^-1 c, and the mean over the vertices
of what they move against that frame: 0 for a rigid body, 0 in the sum for wheels that turn, the body's way for what
walks by its skeleton alone.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from datafactory.scenes.chain import Chain
from datafactory.scenes.motion import Moving, Real, Vector, drift, triple, upright_axes
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import WORLD_AXES, PointTarget, Scene, SceneObject
from datafactory.scenes.targets.models import MODELS
from datafactory.scenes.things import FOLDER, OF_MODELS, OTHER

Axes = tuple[Vector, Vector, Vector]
Box = tuple[Real, Real]
CLEAR_M = 3.0
"""A drawn sensor is so far from everything that drives or walks by: nothing passes through it."""
TRIES = 64
"""Times that are drawn for a frame until its sensor stands clear."""


@dataclass(frozen=True, eq=False)
class WorldBox:
    """A box in the world.

    :param center: [3] [m]
    :param size: [3] length along forward, width along left, height along up [m]
    :param axes: [3, 3] rows forward, left and up, unit vectors
    :param velocity: [3] of the centre [m/s]
    """

    center: Real
    size: Real
    axes: Real
    velocity: Real


@dataclass(frozen=True, eq=False)
class BoxedThing:
    """Something that moves or has a class, with its box at any time.

    :param class_name: "other" where the source states none
    :param frame: see :class:`Label`; None where none is known
    :param items: the meshes and point targets that it is made of
    :param indices: their places among the scene's objects, the point targets after them
    """

    name: str
    class_name: str
    frame: Chain | None
    items: tuple[SceneObject | PointTarget, ...]
    indices: tuple[int, ...]

    @cached_property
    def start(self) -> WorldBox:
        """At time 0."""
        return _box_of(self, 0.0)

    @cached_property
    def turns(self) -> bool:
        """Whether it does more than to be shifted as a whole."""
        motions = {(item.velocity, item.motion) for item in self.items}
        return len(motions) > 1 or isinstance(self.items[0].motion, Moving)

    def at(self, time_s: float) -> WorldBox:
        """The box at a time [s]; its velocity is that of the interval that begins there."""
        if self.turns:
            return _box_of(self, time_s)
        motion = self.items[0].motion
        assert not isinstance(motion, Moving)
        shift, velocity = drift(triple(self.start.velocity), motion, time_s)
        return replace(self.start, center=self.start.center + shift, velocity=velocity)


def boxed_things(scene: Scene) -> tuple[BoxedThing, ...]:
    """The things of a scene that move or have a class, in the order of their first parts.

    What moves without a label is a thing by itself.
    """
    items: tuple[SceneObject | PointTarget, ...] = (*scene.objects, *scene.targets)
    members: dict[Hashable, list[int]] = {}
    for index, item in enumerate(items):
        members.setdefault(index if item.label is None else item.label.thing, []).append(index)
    found = []
    for indices in members.values():
        own = tuple(items[index] for index in indices)
        class_name = next((name for name in map(_class_of, own) if name), "")
        if class_name or any(item.moves for item in own):
            label = own[0].label
            name, frame = (own[0].name, None) if label is None else (label.thing, label.frame)
            found.append(BoxedThing(name, class_name or OTHER, frame, own, tuple(indices)))
    return tuple(found)


@dataclass(frozen=True)
class SeenThing:
    """A thing of a scene in the radar frame at the start of a frame, for any radar.

    :param name: of the thing; :param class_name: never ""
    :param center: [m]; :param velocity: of it, relative to the radar [m/s]
    :param size: length, width, height [m]
    :param forward, left, up: unit vectors of its axes
    :param indices: its parts' places among the paths' ``objects``
    """

    name: str
    class_name: str
    center: Vector
    size: Vector
    forward: Vector
    left: Vector
    up: Vector
    velocity: Vector
    indices: tuple[int, ...]


def seen_things(things: Sequence[BoxedThing], pose: Pose) -> tuple[SeenThing, ...]:
    """The things at a pose's time, in its frame."""
    rotation, found = pose.rotation(), []
    for thing in things:
        box = thing.at(pose.time_s)
        center, velocity = triple(pose.seen(box.center)), triple(pose.seen_velocity(box.velocity))
        forward, left, up = map(triple, box.axes @ rotation)
        where = center, triple(box.size), forward, left, up, velocity
        found.append(SeenThing(thing.name, thing.class_name, *where, thing.indices))
    return tuple(found)


def _class_of(item: SceneObject | PointTarget) -> str:
    """The class that a part states, or that its model implies; "" without either."""
    if item.label is not None and item.label.class_name:
        return item.label.class_name
    model = getattr(item, "model", None)
    return next((name for kind, name in OF_MODELS.items() if isinstance(model, MODELS[kind])), "")


def _box_of(parts: BoxedThing, time_s: float) -> WorldBox:
    """The box around all parts at a time, with the velocity of its middle: of the points at its six sides, beyond that
    of the frame that carries them."""
    instants = [item.at(time_s) for item in parts.items]
    corners = [_corners(now) if isinstance(now, PointTarget) else (now.vertices, now.velocities) for now in instants]
    points, velocities = (np.concatenate(values) for values in zip(*corners, strict=True))
    axes = np.array(_axes_of(parts, time_s))
    along = points @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    center = 0.5 * (low + high) @ axes
    field = np.zeros_like(points)
    carried = np.zeros(3)
    if parts.frame is not None:
        rate = _rate_field(parts.frame, time_s)
        field, carried = points @ rate[:3, :3].T + rate[:3, 3], rate[:3, :3] @ center + rate[:3, 3]
    rates, axis = (velocities - field) @ axes.T, np.arange(3)
    sides = 0.5 * (rates[along.argmin(axis=0), axis] + rates[along.argmax(axis=0), axis])
    return WorldBox(center, high - low, axes, carried + sides @ axes)


def _rate_field(frame: Chain, time_s: float) -> Real:
    """[4, 4] that gives the velocity of a place which the frame carries, M'(t) M(t)^-1; 0 where the frame is flat."""
    matrix, rate = frame.at(time_s)
    try:
        found: Real = rate @ np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        return np.zeros((4, 4))
    return found if np.isfinite(found).all() else np.zeros((4, 4))


def _axes_of(parts: BoxedThing, time_s: float) -> Axes:
    """Forward, left and up of a thing at a time."""
    if parts.frame is None:
        item = parts.items[0].at(time_s)
        return item.axes if isinstance(item, PointTarget) else WORLD_AXES
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        home = parts.frame.at(0.0)[0][:3, :3]
        upward = np.nan_to_num(home[2] / np.linalg.norm(home, axis=0))
    up = int(np.argmax(np.abs(upward)))
    now = parts.frame.at(time_s)[0][:3, :3]
    sign = 1.0 if upward[up] >= 0.0 else -1.0
    return upright_axes(now[:, 1 if up == 0 else 0], sign * now[:, up]) or WORLD_AXES


def _corners(target: PointTarget) -> tuple[Real, Real]:
    """[8, 3] corners of the box that a point target fills, and their velocities; its place where no size is known."""
    low, high = target.extent
    offsets = np.array(list(product(*zip(low, high, strict=True)))) @ np.array(target.axes)
    return np.array(target.position) + offsets, np.array(target.velocity) + np.cross(np.array(target.spin), offsets)


def _leave_s(scene: Scene, straight_on: Sequence[SceneObject | PointTarget]) -> list[float]:
    """When each of what goes straight on for ever leaves the rectangle of what rests [s]; none where nothing rests."""
    corners = [
        end(item.vertices[:, :2], axis=0) for item in scene.objects if not item.moves for end in (np.min, np.max)
    ]
    if not corners:
        return []
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    found = []
    for item in straight_on:
        place = item.vertices.mean(axis=0) if isinstance(item, SceneObject) else np.array(item.position)
        speed = np.array(item.velocity[:2])
        with np.errstate(divide="ignore", invalid="ignore"):
            reaches_s = (np.where(speed > 0.0, high, low) - place[:2]) / speed
        found.append(max(0.0, float(np.where(speed == 0.0, np.inf, reaches_s).min())))
    return found


class Movers:
    """The boxes around everything that moves in a scene, upright and along the world's axes, at any time."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene.name
        self._objects = [item for item in scene.objects if item.moves]
        self._targets = [item for item in scene.targets if item.moves]
        horizon_s = scene.population.horizon_s if self and scene.population is not None else None
        movers: list[SceneObject | PointTarget] = [*self._objects, *self._targets]
        every = [item.motion for item in movers if not item.name.startswith(f"{FOLDER}/")]
        own = [motion.times for motion in every if motion is not None]
        self.moves_from_s = min((float(times[0]) for times in own), default=-np.inf)
        """Before, what of the scene's own has samples rests [s]; -inf where nothing has."""
        self.rests_from_s = max((float(times[-1]) for times in own), default=horizon_s or np.inf)
        """From when on what of the scene's own has samples rests [s]; where nothing has, a population; else inf."""
        self.populated_s = horizon_s
        if horizon_s:
            moving_s = self.rests_from_s if self.rests_from_s > 0.0 else np.inf
            leave_s = _leave_s(scene, [item for item in movers if item.motion is None])
            self.populated_s = min(horizon_s, moving_s, float(np.median(leave_s)) if leave_s else np.inf)
        """A drawn frame's time is from 0 to here [s]; None without a population, or where nothing moves."""

    def __bool__(self) -> bool:
        return bool(self._objects or self._targets)

    def boxes(self, time_s: float) -> list[Box]:
        """Lower and upper corner [3] [m] of each at a time [s]."""
        found: list[Box] = []
        for item in self._objects:
            vertices = item.at(time_s).vertices
            found.append((vertices.min(axis=0), vertices.max(axis=0)))
        for target in self._targets:
            middle = np.asarray(target.at(time_s).position)
            reach = target.model.footprint_m if target.model is not None else 0.0
            found.append((middle - reach, middle + reach))
        return found

    def clear_of(self, poses: Sequence[Pose], least_m: float = CLEAR_M) -> bool:
        """Whether poses, each at its time, keep at least this from every box [m]."""
        for pose in poses if self else ():
            corners = np.array(self.boxes(pose.time_s))
            here = np.asarray(pose.position)
            outside = np.maximum(np.maximum(corners[:, 0] - here, here - corners[:, 1]), 0.0)
            if np.linalg.norm(outside, axis=1).min() < least_m:
                return False
        return True

    def at_a_clear_time(self, pose: Pose, rng: np.random.Generator) -> Pose:
        """The pose at a time of the traffic at which nothing is near; at the last of 64 where something always is."""
        assert self.populated_s is not None
        for time_s in rng.uniform(0.0, self.populated_s, TRIES).tolist():
            pose = replace(pose, time_s=time_s)
            if self.clear_of([pose]):
                break
        return pose
