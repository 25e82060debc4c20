"""Drives: tracks drawn along the lanes of a scene, with stops, and with brakes and bends that a car could take.

A drive keeps to a lane (:mod:`datafactory.scenes.lanes`) of one split's region. Its speed is the largest that keeps

- the drawn cruising speed, or that at which a shorter lane lasts as long as the drive, and a way to stop in,
- a lateral acceleration v^2 |curvature| of at most 3 m/s^2,
- an acceleration along the lane of at most 3 m/s^2, by one pass forwards and one backwards over v^2 = v0^2 + 2 a s,
- and comes to rest at a drawn stop, and at the lane's end, behind the last pose.

The acceleration is constant between two points of the lane, so way and speed at any time follow in closed form. The
sensor looks along the lane; its velocity is the derivative of its place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from datafactory.scenes.boxes import Movers
from datafactory.scenes.ground import CLEARANCE_M, Ground
from datafactory.scenes.lanes import STEP_M, Lane, draw_lane, smoothed
from datafactory.scenes.motion import Real
from datafactory.scenes.poses import LARGEST_SPEED_MPS, ROAD_PREFERENCE, SENSOR_HEIGHT_M, Pose, Speeds, view_from
from datafactory.scenes.tracks import MOST_FRAMES, pose_of, require_rate
from shared.dataset.folder import SPLITS, Split
from shared.physics.errors import InputError

WORD = "drive"
ACCELERATION_MPS2 = 3.0
LATERAL_MPS2 = 3.0
CRUISING_SPEEDS: Speeds = (3.0, 15.0)
"""Of a drawn cruising speed."""
STOP_SHARE = 0.3
"""Of the drives that stop on their way."""
STANDING_S = (0.5, 1.5)
DEFAULT_SECONDS = 2.0
DEFAULT_RATE_HZ = 10.0
SPARE_M = 3.0
"""Of a lane beyond the way that cruising and stopping take: one to stand on, where the speed is 0."""
ROUGH_M = 2.0
"""Standard deviation of the mean that smooths the ground's height along the lane: kerbs are driven over, not jumped."""
LATEST_START_S = 10.0
DRAWN = 12
"""Drives drawn before the best of them is taken."""
ON_ROADS = 6
"""Of them, the first, for which roads are preferred: a road that traffic fills leaves the others."""
MOST_DRAWN = 60
"""As long as none keeps clear of the traffic: of 12 none did in a canyon with as many cars as it holds."""
LOOKS = 4
"""Poses of a drive whose views are weighed."""


@dataclass(frozen=True)
class Drives:
    """What is asked of drawn drives.

    :param speed_mps: cruising speed [m/s]; None draws one for each drive, 3 to 15
    :param seconds: how long each lasts [s]
    :param rate_hz: frames a second [Hz]
    """

    speed_mps: float | None = None
    seconds: float = DEFAULT_SECONDS
    rate_hz: float = DEFAULT_RATE_HZ

    def __post_init__(self) -> None:
        require_rate(self.rate_hz)
        if self.speed_mps is not None and not 0.0 <= self.speed_mps <= LARGEST_SPEED_MPS:
            raise InputError("--trajectory", f"speed = {self.speed_mps!r}", f"0 to {LARGEST_SPEED_MPS:g} m/s")
        if not 0.0 < self.seconds <= 3600.0:
            raise InputError("--trajectory", f"seconds = {self.seconds!r}", "more than 0, at most 3600")
        if not 1 <= self.frames <= MOST_FRAMES:
            raise InputError(
                "--trajectory", f"{self.seconds:g} s at {self.rate_hz:g} Hz are {self.frames} frames", "1 to 1000000"
            )

    @property
    def frames(self) -> int:
        """Of one drive."""
        return math.floor(self.seconds * self.rate_hz + 1e-6)


def parse_drives(text: str, rate_hz: float | None) -> Drives:
    """``drive`` or ``drive:speed=10,seconds=4``.

    :raises InputError: another word or key, a value that is no number or out of bounds
    """
    word, _, rest = text.partition(":")
    form = f"a file, or {WORD}[:speed=M/S][,seconds=S]"
    if word != WORD:
        raise InputError("--trajectory", repr(text), form)
    values: dict[str, float] = {}
    for part in filter(None, rest.split(",")):
        key, _, value = part.partition("=")
        if key not in ("speed", "seconds") or key in values:
            raise InputError("--trajectory", f"{part!r} in {text!r}", form)
        try:
            values[key] = float(value)
        except ValueError:
            raise InputError("--trajectory", f"{key} = {value!r}", "a number") from None
    return Drives(
        values.get("speed"), values.get("seconds", DEFAULT_SECONDS), DEFAULT_RATE_HZ if rate_hz is None else rate_hz
    )


@dataclass(frozen=True, eq=False)
class Ride:
    """A lane with the time at which each of its points is passed.

    :param lane: where
    :param speed_mps: [n] at the lane's points [m/s]
    :param time_s: [n] when each is passed [s]; at a stop when it is reached
    :param standing_s: [n] how long it stands there [s]
    """

    lane: Lane
    speed_mps: Real
    time_s: Real
    standing_s: Real

    def at(self, time_s: Real) -> tuple[Real, Real]:
        """Way driven [m] and speed [m/s] at times [k] from 0 on; at rest beyond the end."""
        leaving = self.time_s + self.standing_s
        n = np.clip(np.searchsorted(self.time_s, time_s, side="right") - 1, 0, len(self.time_s) - 1)
        after = np.maximum(time_s - leaving[n], 0.0)
        following = np.minimum(n + 1, len(self.time_s) - 1)
        takes = np.where(following > n, self.time_s[following] - leaving[n], 1.0)
        rate = np.where(following > n, (self.speed_mps[following] - self.speed_mps[n]) / takes, 0.0)
        far = self.lane.distance_m
        way = np.minimum(far[n] + self.speed_mps[n] * after + 0.5 * rate * after**2, far[following])
        return way, np.where(time_s < leaving[n], 0.0, self.speed_mps[n] + rate * after)


def ride(lane: Lane, cruise_mps: float, stop: int | None = None, standing_s: float = 0.0) -> Ride:
    """Drive along a lane as fast as the limits allow.

    :param cruise_mps: [m/s], more than 0
    :param stop: index of the lane's point to stop at; None for none but the end
    :param standing_s: how long [s]
    """
    far = lane.distance_m
    allowed = np.minimum(cruise_mps, np.sqrt(LATERAL_MPS2 / np.maximum(np.abs(lane.curvature), 1e-9)))
    allowed[-1] = 0.0
    pauses = np.zeros(len(far))
    if stop is not None:
        allowed[stop], pauses[stop] = 0.0, standing_s
    square = allowed**2
    gain = 2.0 * ACCELERATION_MPS2 * np.diff(far)
    for n in range(1, len(far)):
        square[n] = min(square[n], square[n - 1] + gain[n - 1])
    for n in range(len(far) - 2, -1, -1):
        square[n] = min(square[n], square[n + 1] + gain[n])
    speed = np.sqrt(square)
    takes = 2.0 * np.diff(far) / (speed[1:] + speed[:-1])
    passed = np.concatenate([[0.0], np.cumsum(takes + pauses[:-1])])
    return Ride(lane, speed, passed, pauses)


def lasting_mps(length_m: float, seconds: float) -> float:
    """Speed v [m/s] of a drive that cruises for so long and stops at its lane's end: v T + v^2 / (2 a) = length."""
    return ACCELERATION_MPS2 * (math.sqrt(seconds**2 + 2.0 * length_m / ACCELERATION_MPS2) - seconds)


def poses_along(lane: Lane, ground: Ground, time_s: Real, way_m: Real, speed_mps: Real) -> tuple[Pose, ...]:
    """The sensor's poses at times [k], way [k] down a lane: 0.5 m above the ground and looking along it."""
    height = ground.heights_at(*lane.points.T) + SENSOR_HEIGHT_M
    course = lane.course(smoothed(height[:, None], ROUGH_M))
    along = course(way_m, 1)
    yaw = np.degrees(np.arctan2(along[:, 1], along[:, 0]))
    pitch = -np.degrees(np.arctan2(along[:, 2], np.hypot(along[:, 0], along[:, 1])))
    angles = np.column_stack([yaw, pitch, np.zeros(len(yaw))])
    return tuple(map(pose_of, time_s, course(way_m), angles, along * speed_mps[:, None]))


def draw_drive(
    ground: Ground,
    movers: Movers,
    split: Split,
    asked: Drives,
    rng: np.random.Generator,
    speeds: Speeds = CRUISING_SPEEDS,
) -> tuple[Pose, ...]:
    """Draw one drive in a split's region.

    What all keep to: docs/trajectories.md#drawn-drives. They begin at drawn times, so that the same street is met with
    other traffic. Of ``DRAWN`` the first is taken that has room to go as far as it would, looks along its street at
    something, and at nothing on another split's side; else the best, in this order.

    :param movers: of the ground's scene
    :param speeds: ends of the cruising speed, where ``asked`` states none
    :raises InputError: no lane in the region, or none that keeps clear of what moves
    """
    region = ground.region == SPLITS.index(split)
    after_s = np.arange(asked.frames) / asked.rate_hz
    latest_s = min(LATEST_START_S, max(0.0, movers.rests_from_s - asked.seconds)) if movers else 0.0
    best: tuple[tuple[float, ...], tuple[Pose, ...]] | None = None
    lanes, roads = 0, region & ground.road
    for drawn in range(MOST_DRAWN):
        if drawn >= DRAWN and best is not None:
            break
        cruise = float(rng.uniform(*speeds)) if asked.speed_mps is None else asked.speed_mps
        lane, far = None, cruise * asked.seconds + cruise**2 / (2.0 * ACCELERATION_MPS2) + SPARE_M
        if drawn < ON_ROADS and roads.any() and rng.random() < ROAD_PREFERENCE:
            lane = draw_lane(ground, far, rng, roads)
        if lane is None or lane.length_m < far:
            lane = draw_lane(ground, far, rng, region)
        stops, place, stands = rng.random() < STOP_SHARE, rng.uniform(0.2, 0.8), rng.uniform(*STANDING_S)
        begins_s = round(rng.uniform(0.0, latest_s), 3)
        if lane is None:
            continue
        lanes += 1
        way, speed = np.zeros_like(after_s), np.zeros_like(after_s)
        if cruise > 0.0:
            lasting = min(cruise, lasting_mps(lane.length_m, asked.seconds))
            stop = min(max(2, int(place * lasting * asked.seconds / STEP_M)), len(lane.points) - 3) if stops else None
            way, speed = ride(lane, lasting, stop, stands).at(after_s)
        poses = poses_along(lane, ground, begins_s + after_s, way, speed)
        if not movers.clear_of(poses, CLEARANCE_M):
            continue
        along, own = _worth(poses, ground, split)
        # Half of the way that cruising would take is far enough: bends and stops cost as much.
        room = min(1.0, 2.0 * lane.length_m / max(cruise * asked.seconds, 1e-9))
        worth = (along * room, own)
        if best is None or worth > best[0]:
            best = (worth, poses)
        if worth == (1.0, 0.0):
            break
    if best is None:
        problem = f"no drive in the region of {split}: " + (
            f"none of {lanes} keeps {CLEARANCE_M} m from what moves" if lanes else "no street is long enough"
        )
        raise InputError(ground.scene, problem, "a larger scene, another --split, or --trajectory FILE")
    return best[1]


def _worth(poses: tuple[Pose, ...], ground: Ground, split: Split) -> tuple[float, float]:
    """Of poses spread over a drive: the share that looks along a street, and less the share of what is foreign."""
    chosen = poses[:: max(1, len(poses) // LOOKS)]
    views = [view_from(ground, *pose.position[:2], math.radians(pose.yaw_deg), split) for pose in chosen]
    along, own, _ = np.mean(views, axis=0).tolist()
    return along, own
