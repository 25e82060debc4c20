"""Tracks: poses with times, one after the other, from files, and as curves through them.

Between two rows a track is a cubic in each coordinate (Hermite form), and its velocity is that cubic's derivative.
Where no velocities are given, that at a row is of the parabola through it and its neighbours, which errs by h^2 / 6
times the third derivative for rows h apart. At an end it is zero where it would point away from the neighbour, as C.
Moler has it ("Numerical Computing with MATLAB", section 3.6): the sensor sets out from rest. Nowhere is it more than
three times the mean velocity to either neighbour, the bound up to which a cubic keeps to one direction (C. de Boor and
B. Swartz, "Piecewise monotone interpolation", J. Approximation Theory 21, 1977): beside an equal place it is zero, the
sensor stands. So a constant acceleration is exact, unless it turns the sensor back between two rows. The attitude turns
at a constant rate from row to row, the shorter way (K. Shoemake, "Animating rotation with quaternion curves", SIGGRAPH
1985).

A file is a table (CSV) with a line for each pose, or the JSON list that ``--poses`` reads, with times.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import BaseModel, Field, FiniteFloat, TypeAdapter
from scipy.spatial.transform import Rotation, Slerp

from datafactory.scenes.motion import Real, triple
from datafactory.scenes.poses import Coordinate, Pose, PoseEntry, Speed, Time, Velocity, read_entries
from shared.physics.errors import InputError
from shared.physics.units import FASTEST_MPS
from shared.radar import validated

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

LEAST_RATE_HZ, MOST_RATE_HZ = 1e-3, 1e5
MOST_FRAMES = 1_000_000
"""Of one track: more than a month at 0.3 Hz is a mistyped rate."""

COLUMNS = ("time", "x", "y", "z", "yaw_deg")
VELOCITY = ("vx", "vy", "vz")
FORM = "time,x,y,z,yaw_deg[,pitch_deg][,roll_deg][,vx,vy,vz], in s, m, degrees and m/s"
JSON_FORM = '[{"time": s, "position": [x, y, z], "yaw_deg": 0, ..., "velocity": [x, y, z]}, ...]'
_Given = Annotated[FiniteFloat, Field(ge=-1e9, le=1e9)]


@dataclass(frozen=True, eq=False)
class Curve:
    """Where a sensor is at any time, by its rows.

    :param time_s: [n] rising, n at least 2
    :param position: [n, 3] world [m]
    :param angles_deg: [n, 3] yaw, pitch, roll, see :class:`datafactory.scenes.poses.Pose`
    :param velocity: [n, 3] world [m/s]; None where it follows from the positions
    """

    time_s: Real
    position: Real
    angles_deg: Real
    velocity: Real | None = None

    def _places(self) -> CubicHermiteSpline:
        from scipy.interpolate import CubicHermiteSpline

        slopes = self._slopes() if self.velocity is None else self.velocity
        return CubicHermiteSpline(self.time_s, self.position, slopes)

    def _slopes(self) -> Real:
        """[n, 3] velocities at the rows, by their places."""
        slopes = np.gradient(self.position, self.time_s, axis=0, edge_order=2 if len(self.time_s) > 2 else 1)
        means = np.diff(self.position, axis=0) / np.diff(self.time_s)[:, None]
        for end in (0, -1):
            if slopes[end] @ means[end] < 0.0:
                slopes[end] = 0.0
        mps = np.linalg.norm(means, axis=1)
        most = 3.0 * np.minimum(np.append(mps, np.inf), np.append(np.inf, mps))
        fast = np.linalg.norm(slopes, axis=1) > most
        slopes[fast] *= (most[fast] / np.linalg.norm(slopes[fast], axis=1))[:, None]
        return np.asarray(slopes)

    def rows(self) -> tuple[Pose, ...]:
        """One pose a row, as it was given."""
        velocity = self._places()(self.time_s, 1)
        return tuple(map(pose_of, self.time_s, self.position, self.angles_deg, velocity))

    def at(self, time_s: Real) -> tuple[Pose, ...]:
        """One pose for each time [s] between the first and the last row."""
        places = self._places()
        turns = Slerp(self.time_s, Rotation.from_euler("ZYX", self.angles_deg, degrees=True))
        angles = turns(time_s).as_euler("ZYX", degrees=True, suppress_warnings=True)
        return tuple(map(pose_of, time_s, places(time_s), angles, places(time_s, 1)))

    def resampled(self, rate_hz: float) -> tuple[Pose, ...]:
        """One pose each 1 / rate from the first row on, as far as the last.

        :raises InputError: a rate out of bounds, or one that gives more than a million poses
        """
        require_rate(rate_hz)
        lasts_s = float(self.time_s[-1] - self.time_s[0])
        # The last row is met in spite of the rounding of a sum of decimals.
        count = math.floor(lasts_s * rate_hz + 1e-6) + 1
        if count > MOST_FRAMES:
            raise InputError("--frame-rate", f"{rate_hz:g} Hz over {lasts_s:g} s is {count} frames", f"{MOST_FRAMES}")
        return self.at(np.minimum(self.time_s[0] + np.arange(count) / rate_hz, self.time_s[-1]))


def require_rate(rate_hz: float) -> None:
    """:raises InputError: no rate of frames"""
    if not LEAST_RATE_HZ <= rate_hz <= MOST_RATE_HZ:
        raise InputError("--frame-rate", f"{rate_hz!r}", f"{LEAST_RATE_HZ:g} to {MOST_RATE_HZ:g} Hz")


def pose_of(time_s: float, position: Real, angles_deg: Real, velocity: Real) -> Pose:
    """A pose of plain numbers."""
    return Pose(triple(position), *triple(angles_deg), triple(velocity), float(time_s))


class _Line(BaseModel, extra="forbid"):
    """One line of a table; numbers are parsed from text."""

    time: Time
    x: Coordinate
    y: Coordinate
    z: Coordinate
    yaw_deg: _Given
    pitch_deg: _Given = 0.0
    roll_deg: _Given = 0.0
    vx: Speed = 0.0
    vy: Speed = 0.0
    vz: Speed = 0.0

    def pose(self) -> Pose:
        position, velocity = (self.x, self.y, self.z), (self.vx, self.vy, self.vz)
        return Pose(position, self.yaw_deg, self.pitch_deg, self.roll_deg, velocity, self.time)


class _Entry(PoseEntry):
    """One entry of a JSON list: a pose with a time, the velocity where it is known."""

    time: Time = Field()
    velocity: Velocity | None = None  # type: ignore[assignment]


_ENTRIES = TypeAdapter(list[_Entry])


def read_track(path: Path) -> Curve:
    """Read a ``--trajectory`` file: JSON if its name ends in ``.json``, else a table with a line of names.

    :raises InputError: a file that cannot be read, an unknown, doubled or missing column, a value that is no number or
        out of bounds, fewer than two poses, times that do not rise, velocities for some poses alone, or a way between
        two poses that nothing drives; the message names the line or the entry, the field and the value
    """
    return _from_json(path) if path.suffix.lower() == ".json" else _from_table(path)


def _from_json(path: Path) -> Curve:
    entries = read_entries(path, _ENTRIES, JSON_FORM, _Entry.model_fields)
    places, stated = [f"entry {number}" for number in range(len(entries))], [bool(entry.velocity) for entry in entries]
    return _curve(path, [entry.pose() for entry in entries], places, stated)


def _from_table(path: Path) -> Curve:
    try:
        with path.open(newline="", encoding="utf-8-sig") as handle:
            reader = csv.reader(handle, strict=True)
            lines = [(reader.line_num, line) for line in reader if any(cell.strip() for cell in line)]
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror}", f"a table with the columns {FORM}") from None
    except (ValueError, csv.Error) as error:  # no UTF-8, an open quote, a field that never ends
        raise InputError(path, f"is no table: {error}", f"text with the columns {FORM}") from None
    if not lines:
        raise InputError(path, "is empty", f"a line of names, {FORM}")
    head, names = lines[0][0], [cell.strip() for cell in lines[0][1]]
    for name in names:
        if name not in _Line.model_fields or names.count(name) > 1:
            why = "twice" if names.count(name) > 1 else "unknown"
            raise InputError(path, f"line {head}: column {name!r} {why}", f"some of {', '.join(_Line.model_fields)}")
    for name in (*COLUMNS, *(VELOCITY if set(names) & set(VELOCITY) else ())):
        if name not in names:
            raise InputError(path, f"line {head}: no column {name!r}", FORM)
    poses = []
    for number, cells in lines[1:]:
        if len(cells) != len(names):
            raise InputError(path, f"line {number} has {len(cells)} values", f"{len(names)}: {','.join(names)}")
        values = dict(zip(names, (cell.strip() for cell in cells), strict=True))
        poses.append(validated(_Line, values, path, place=f"line {number}, ").pose())
    return _curve(path, poses, [f"line {number}" for number, _ in lines[1:]], [VELOCITY[0] in names] * len(poses))


def track_of(poses: Sequence[Pose], source: str) -> tuple[Pose, ...]:
    """Poses as a track. Where none of them has a velocity it is that of the places, as in a file without.

    :param source: what they were given as
    :raises InputError: times that do not rise, or a way between two poses that nothing drives
    """
    if len(poses) == 1:
        return tuple(poses)
    stated = any(any(pose.velocity) for pose in poses)
    curve = _curve(source, poses, [f"pose {number}" for number in range(len(poses))], [stated] * len(poses))
    return tuple(poses) if stated else curve.rows()


def _curve(path: Path | str, poses: Sequence[Pose], places: list[str], stated: list[bool]) -> Curve:
    """Poses as a curve.

    :param path: the file, or what they were given as
    :param places: where in the file each stands
    :param stated: whether its velocity does
    """
    if len(poses) < 2:
        count = f"{len(poses)} pose{'' if len(poses) == 1 else 's'}"
        raise InputError(path, count, "at least two: a track has a length")
    time_s = np.array([pose.time_s for pose in poses])
    position = np.array([pose.position for pose in poses])
    angles_deg = np.array([[pose.yaw_deg, pose.pitch_deg, pose.roll_deg] for pose in poses])
    steps_s = np.diff(time_s)
    if (steps_s <= 0.0).any():
        row = int(np.argmax(steps_s <= 0.0)) + 1
        raise InputError(path, f"{places[row]}, time = {time_s[row]:g} after {time_s[row - 1]:g}", "times that rise")
    if any(stated) and not all(stated):
        raise InputError(path, f"{places[stated.index(False)]} has no velocity, others have", "one in each, or in none")
    speed = np.linalg.norm(np.diff(position, axis=0), axis=1) / steps_s
    if (speed > FASTEST_MPS).any():
        row = int(np.argmax(speed > FASTEST_MPS)) + 1
        problem = f"{places[row]} is reached at {speed[row - 1]:.3g} m/s from the pose before"
        raise InputError(path, problem, f"at most {FASTEST_MPS:g} m/s")
    velocity = np.array([pose.velocity for pose in poses]) if all(stated) else None
    if velocity is not None:
        _require_own_velocities(path, velocity, np.diff(position, axis=0) / steps_s[:, None])
    return Curve(time_s, position, angles_deg, velocity)


CONTRADICTS, CONTRADICTS_MPS = 0.5, 1.0
"""Of the larger of two velocities, and beyond that [m/s]: a quarter of a circle between two rows makes 0.2 of it, and
km/h in place of m/s 0.7. It is asked of most rows, as a stop between two may make more."""


def _require_own_velocities(path: Path | str, stated: Real, driven: Real) -> None:
    """Refuse velocities [n, 3] that are none of this track: in km/h, or along the sensor's axes.

    A velocity of 0 is left out: so have poses of Python theirs that state none.

    :param driven: [n - 1, 3] of the places from row to row [m/s]
    :raises InputError: most of them differ by more than what lies between two rows
    """
    told = np.linalg.norm(stated, axis=1) > 0.0
    both = told[1:] & told[:-1]
    between, driven = 0.5 * (stated[1:] + stated[:-1])[both], driven[both]
    size = np.maximum(np.linalg.norm(between, axis=1), np.linalg.norm(driven, axis=1))
    away = np.linalg.norm(between - driven, axis=1) - CONTRADICTS * size
    if len(away) and np.median(away) > CONTRADICTS_MPS:
        row = int(np.argmax(away))
        said, gone = (f"({', '.join(f'{value:.3g}' for value in one[row])})" for one in (between, driven))
        raise InputError(path, f"velocities of {said} m/s where places go at {gone}", "those of the world, in m/s")
