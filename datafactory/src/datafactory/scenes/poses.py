"""Where the radar stands and how it moves: poses from a file, or drawn on free ground.

What a sensor would see from a place is found by a fan of rays over the ground's map of obstacles. The map marks every
cell that anything stands in by more than 0.3 m, so that what it calls free is free of the triangles too, and nothing
but ground lies within 1.5 m of free ground.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, FiniteFloat, TypeAdapter, ValidationError
from scipy.spatial.transform import Rotation

from datafactory.scenes.ground import Ground
from datafactory.scenes.motion import Vector
from shared.dataset.folder import SPLITS, Split
from shared.physics.errors import InputError
from shared.physics.units import FARTHEST_M, FASTEST_MPS
from shared.radar import first_validation_error

Entry = TypeVar("Entry")
SENSOR_HEIGHT_M = 0.5
Speeds = tuple[float, float]
"""Least and largest speed [m/s]."""
DRAWN_SPEEDS: Speeds = (0.0, 6.0)
"""Uniform, in a random direction: the paper, section "Training data generation"."""
LARGEST_SPEED_MPS = 100.0
"""Of a sensor whose speed is drawn: no road has a faster one."""

ROAD_PREFERENCE = 0.8
"""Share of the positions drawn on roads, where the split's region has any. The others are drawn on the kerbs."""
POSITION_TRIES = 32
YAW_TRIES = 8

SIGHT_M = 95.0
"""The default radar's 94.4 m."""
SECTOR_DEG = 58.0
"""To each side: the default radar's images end at u = 0.85."""
SECTOR_RAYS = 25
"""One heading every 5 deg across the sector: one of them meets a facade 8 m wide at 90 m."""
SECTOR_RAD = np.radians(np.linspace(-SECTOR_DEG, SECTOR_DEG, SECTOR_RAYS))
FREE_AHEAD_M = 8.0
FAR_M = 15.0


@dataclass(frozen=True)
class Pose:
    """The radar's frame in the world at the start of a frame.

    The radar's x is its boresight, y its left, z up. Right-handed intrinsic rotations, first yaw about z, then pitch
    about the new y, then roll about the new x (ISO 8855): positive yaw turns the boresight to the left, positive
    pitch points it *down*, positive roll lifts the left side.

    :param position: world position [m]
    :param yaw_deg: [deg]
    :param pitch_deg: [deg]
    :param roll_deg: [deg]
    :param velocity: world velocity [m/s]
    :param time_s: time in the scene [s], at which moving objects are placed
    """

    position: Vector
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    velocity: Vector = (0.0, 0.0, 0.0)
    time_s: float = 0.0

    def __post_init__(self) -> None:
        """:raises InputError: what is no finite number, a place or a velocity of other than three"""
        for name in ("position", "velocity"):
            values = _finite(given := getattr(self, name))
            if len(values) != 3:
                raise InputError("Pose", f"{name} = {given!r}", "three finite numbers")
            object.__setattr__(self, name, values)
        for name in ("yaw_deg", "pitch_deg", "roll_deg", "time_s"):
            values = _finite([given := getattr(self, name)])
            if not values:
                raise InputError("Pose", f"{name} = {given!r}", "a finite number")
            object.__setattr__(self, name, values[0])

    def _rotation(self) -> Rotation:
        return Rotation.from_euler("ZYX", [self.yaw_deg, self.pitch_deg, self.roll_deg], degrees=True)

    def rotation(self) -> NDArray[np.float64]:
        """[3, 3] matrix R from radar to world: world = position + R @ radar."""
        return np.asarray(self._rotation().as_matrix(), dtype=np.float64)

    def seen(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """[..., 3] places of the world [m] in the radar frame."""
        return np.asarray((places - np.asarray(self.position)) @ self.rotation())

    def seen_velocity(self, velocity: NDArray[np.float64]) -> NDArray[np.float64]:
        """[..., 3] velocities over ground [m/s] relative to the radar, in its frame."""
        return np.asarray((velocity - np.asarray(self.velocity)) @ self.rotation())

    def quaternion(self) -> tuple[float, float, float, float]:
        """The same rotation as unit quaternion (w, x, y, z), w not negative."""
        w, x, y, z = self._rotation().as_quat(canonical=True, scalar_first=True)
        return float(w), float(x), float(y), float(z)


def _finite(given: Iterable[Any]) -> tuple[float, ...]:
    """Plain numbers; none where any is no finite number."""
    try:
        values = tuple(map(float, given))
    except (TypeError, ValueError, OverflowError):
        return ()
    return values if all(map(math.isfinite, values)) else ()


Coordinate = Annotated[FiniteFloat, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
Speed = Annotated[FiniteFloat, Field(ge=-FASTEST_MPS, le=FASTEST_MPS)]
_Position = Annotated[list[Coordinate], Field(min_length=3, max_length=3)]
Velocity = Annotated[list[Speed], Field(min_length=3, max_length=3)]
Time = Annotated[FiniteFloat, Field(ge=-1e6, le=1e6)]


class PoseEntry(BaseModel, extra="forbid", strict=True):
    """One entry of a poses file."""

    position: _Position
    yaw_deg: FiniteFloat = 0.0
    pitch_deg: FiniteFloat = 0.0
    roll_deg: FiniteFloat = 0.0
    velocity: Velocity = [0.0, 0.0, 0.0]
    time: Time = 0.0

    def pose(self) -> Pose:
        x, y, z = self.position
        vx, vy, vz = self.velocity or (0.0, 0.0, 0.0)  # a row of a track may leave it open
        return Pose((x, y, z), self.yaw_deg, self.pitch_deg, self.roll_deg, (vx, vy, vz), self.time)


_ENTRIES = TypeAdapter(list[PoseEntry])
_FORM = '[{"position": [x, y, z], "yaw_deg": 0, "pitch_deg": 0, "roll_deg": 0, "velocity": [x, y, z], "time": s}, ...]'


def read_poses(path: Path) -> tuple[Pose, ...]:
    """Read a ``--poses`` file: a JSON list of objects, of whose keys only ``position`` is required.

    :raises InputError: if the file cannot be read, is no such list, is empty, or an entry has an unknown, doubled,
        missing or wrong field; the message names the entry (from 0), the field and the value
    """
    return tuple(entry.pose() for entry in read_entries(path, _ENTRIES, _FORM, PoseEntry.model_fields))


def read_entries(path: Path, entries: TypeAdapter[list[Entry]], form: str, keys: Iterable[str] = ()) -> list[Entry]:
    """Read a JSON list.

    :param entries: what each must be
    :param form: the list, as an example
    :param keys: that an entry may have
    :raises InputError: see :func:`read_poses`
    """
    try:
        raw = json.loads(path.read_text(encoding="utf-8"), object_pairs_hook=_without_repeated_keys)
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror}", f"a JSON file, {form}") from None
    except (ValueError, RecursionError) as error:  # malformed JSON, no UTF-8, a doubled key, nested too deeply
        raise InputError(path, f"malformed JSON: {error}", form) from None
    try:
        found = entries.validate_python(raw)
    except ValidationError as error:
        problem, expected = first_validation_error(error, "entry ", keys)
        # The checks of an entry say themselves what they expect.
        fault = (problem, f"{expected}, as in {form}") if expected else (f"{problem}, as in {form}",)
        raise InputError(path, *fault) from None
    if not found:
        raise InputError(path, "the list is empty", form)
    return found


def _without_repeated_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    for n, (key, _) in enumerate(pairs):
        if any(key == other for other, _ in pairs[:n]):
            raise ValueError(f"the key {key!r} is given twice in one object")
    return dict(pairs)


def parse_speeds(given: str | Speeds) -> Speeds:
    """Two speeds [m/s], as numbers or as ``A:B``.

    :raises InputError: what is neither, speeds that do not rise, or out of bounds
    """
    if isinstance(given, str):
        try:
            least, most = map(float, given.split(":"))
        except ValueError:
            raise InputError("--speed", repr(given), "A:B in m/s, e.g. 0:20") from None
    elif isinstance(given, list | tuple) and [isinstance(speed, Real) for speed in given] == [True, True]:
        least, most = given
    else:
        raise InputError("--speed", repr(given), "its two ends, as numbers in m/s")
    if not 0.0 <= least <= most <= LARGEST_SPEED_MPS:
        raise InputError("--speed", f"{least:g}:{most:g}", f"A:B with 0 <= A <= B <= {LARGEST_SPEED_MPS:g} m/s")
    return least, most


def require_ground(ground: Ground, split: Split) -> None:
    """:raises InputError: if the split's region has no free ground"""
    if not len(ground.cells(split)):
        raise InputError(
            ground.scene,
            f"no free ground is left for {split}: it is too small for three regions {ground.gap_m:.1f} m apart",
            "a larger scene, another --split, or --poses FILE.json",
        )


def sample_pose(ground: Ground, split: Split, rng: np.random.Generator, speeds: Speeds = DRAWN_SPEEDS) -> Pose:
    """Draw a pose on the streets of a split's region, 0.5 m above the ground and tilted as it is.

    Position and yaw are drawn uniformly until nothing is wrong with the view from there (:func:`view_from`), or the
    best is taken: docs/trajectories.md#where-drawn-poses-stand. The velocity lies in the ground's plane, its horizontal
    speed and its direction uniform.

    :param ground: from :func:`datafactory.scenes.ground.free_ground`
    :param split: ``"train"``, ``"validation"`` or ``"test"``
    :param rng: the frame's own generator; the same state draws the same pose
    :param speeds: ends of the horizontal speed
    :raises InputError: if the split's region has no free ground
    """
    require_ground(ground, split)
    roads = ground.cells(split, road=True)
    kerbs = ground.cells(split, road=False)
    best: tuple[View, float, float, float] | None = None
    for _ in range(POSITION_TRIES):
        on_road = len(roads) and (not len(kerbs) or rng.random() < ROAD_PREFERENCE)
        pool = roads if on_road else kerbs
        corner = pool[rng.integers(len(pool))] + rng.random(2)
        x, y = (float(ground.origin[axis] + corner[axis] * ground.cell_m) for axis in (0, 1))
        for yaw in rng.uniform(-math.pi, math.pi, YAW_TRIES):
            view = view_from(ground, x, y, float(yaw), split)
            if best is None or view > best[0]:
                best = (view, x, y, float(yaw))
        if best is not None and best[0] == BEST:
            break
    assert best is not None  # at least one yaw was tried
    _, x, y, yaw = best
    speed = rng.uniform(*speeds)
    direction = rng.uniform(-math.pi, math.pi)
    pitch_deg, roll_deg = ground.tilt_deg(x, y, yaw)
    # Positive pitch points down: the ground's rise per metre towards the direction of travel.
    rise, _ = ground.tilt_deg(x, y, direction)
    (height,) = ground.heights_at(np.array([x]), np.array([y])).tolist()
    return Pose(
        position=(x, y, height + SENSOR_HEIGHT_M),
        yaw_deg=math.degrees(yaw),
        pitch_deg=pitch_deg,
        roll_deg=roll_deg,
        velocity=(speed * math.cos(direction), speed * math.sin(direction), -speed * math.tan(math.radians(rise))),
    )


class View(NamedTuple):
    """What a sensor sees from its place; of two views the better is the larger.

    :param along: along a street at something: it stands within ``SIGHT_M``, and some ray is free for ``FAR_M``
    :param own: less the share, of the rays that meet something, that meets it on another split's side
    :param ahead_m: free path along the boresight [m], of which more than ``FREE_AHEAD_M`` does not count
    """

    along: bool
    own: float
    ahead_m: float


BEST = View(True, 0.0, FREE_AHEAD_M)
"""Nothing is wrong with it."""


def view_from(ground: Ground, x: float, y: float, yaw_rad: float, split: Split) -> View:
    """The view of a sensor of a split that stands at (x, y) [m] and looks along a heading."""
    headings = yaw_rad + SECTOR_RAD
    free = ground.free_path(x, y, headings, SIGHT_M)
    met = np.isfinite(free)
    i, j = ground.cell_of(x + np.cos(headings[met]) * free[met], y + np.sin(headings[met]) * free[met])
    side = ground.side[i, j]
    foreign = float(np.mean(side != SPLITS.index(split))) if met.any() else 0.0
    along = bool(met.any() and free.max() >= FAR_M)
    return View(along, -foreign, min(float(free[SECTOR_RAYS // 2]), FREE_AHEAD_M))
