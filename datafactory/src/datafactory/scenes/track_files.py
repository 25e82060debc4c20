"""Tracks from files: a table (CSV) with a line for each pose, or the JSON list that ``--poses`` reads, with times."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, TypeAdapter, ValidationError

from datafactory.scenes.poses import Coordinate, PoseEntry, Speed, Time, Velocity, read_entries
from datafactory.scenes.tracks import Curve
from shared.physics.errors import InputError
from shared.physics.units import FASTEST_MPS

COLUMNS = ("time", "x", "y", "z", "yaw_deg")
ANGLES = ("pitch_deg", "roll_deg")
VELOCITY = ("vx", "vy", "vz")
FORM = "time,x,y,z,yaw_deg[,pitch_deg][,roll_deg][,vx,vy,vz], in s, m, degrees and m/s"
JSON_FORM = '[{"time": s, "position": [x, y, z], "yaw_deg": 0, ..., "velocity": [x, y, z]}, ...]'

_Given = Annotated[FiniteFloat, Field(ge=-1e9, le=1e9)]


class _Line(BaseModel):
    """One line of a table; numbers are parsed from text."""

    model_config = ConfigDict(extra="forbid")

    time: Time
    x: Coordinate
    y: Coordinate
    z: Coordinate
    yaw_deg: _Given
    pitch_deg: _Given = 0.0
    roll_deg: _Given = 0.0
    vx: Speed | None = None
    vy: Speed | None = None
    vz: Speed | None = None


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
    entries = read_entries(path, _ENTRIES, JSON_FORM)
    rows = [
        (
            [entry.time, *entry.position, entry.yaw_deg, entry.pitch_deg, entry.roll_deg],
            None if entry.velocity is None else list(entry.velocity),
        )
        for entry in entries
    ]
    return _curve(path, rows, [f"entry {number}" for number in range(len(rows))])


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
    names = [cell.strip() for cell in lines[0][1]]
    known = (*COLUMNS, *ANGLES, *VELOCITY)
    for name in names:
        if name not in known:
            raise InputError(path, f"line {lines[0][0]}: unknown column {name!r}", f"some of {', '.join(known)}")
        if names.count(name) > 1:
            raise InputError(path, f"line {lines[0][0]}: the column {name!r} is there twice", "each column once")
    needed = (*COLUMNS, *(VELOCITY if set(names) & set(VELOCITY) else ()))
    for name in needed:
        if name not in names:
            raise InputError(path, f"line {lines[0][0]}: no column {name!r}", FORM)
    rows = []
    for number, cells in lines[1:]:
        if len(cells) != len(names):
            raise InputError(path, f"line {number} has {len(cells)} values", f"{len(names)}: {','.join(names)}")
        try:
            line = _Line.model_validate(dict(zip(names, (cell.strip() for cell in cells), strict=True)))
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = f"line {number}, {'.'.join(map(str, first['loc']))} = {first['input']!r}"
            raise InputError(path, where, first["msg"][0].lower() + first["msg"][1:]) from None
        velocity: list[Any] = [line.vx, line.vy, line.vz]
        rows.append(
            (
                [line.time, line.x, line.y, line.z, line.yaw_deg, line.pitch_deg, line.roll_deg],
                velocity if "vx" in names else None,
            )
        )
    return _curve(path, rows, [f"line {number}" for number, _ in lines[1:]])


def _curve(path: Path, rows: list[tuple[list[float], list[float] | None]], places: list[str]) -> Curve:
    """The rows as a curve.

    :param rows: (time, x, y, z, yaw, pitch, roll) and velocity of each
    :param places: where in the file each stands
    """
    if len(rows) < 2:
        raise InputError(path, f"{len(rows)} pose{'' if len(rows) == 1 else 's'}", "at least two: a track has a length")
    values = np.array([row for row, _ in rows], dtype=np.float64)
    time_s, position = values[:, 0], values[:, 1:4]
    steps_s = np.diff(time_s)
    if (steps_s <= 0.0).any():
        row = int(np.argmax(steps_s <= 0.0)) + 1
        raise InputError(path, f"{places[row]}, time = {time_s[row]:g} after {time_s[row - 1]:g}", "times that rise")
    given = [velocity is not None for _, velocity in rows]
    if any(given) and not all(given):
        raise InputError(path, f"{places[given.index(False)]} has no velocity, others have", "one in each, or in none")
    speed = np.linalg.norm(np.diff(position, axis=0), axis=1) / steps_s
    if (speed > FASTEST_MPS).any():
        row = int(np.argmax(speed > FASTEST_MPS)) + 1
        problem = f"{places[row]} is reached at {speed[row - 1]:.3g} m/s from the pose before"
        raise InputError(path, problem, f"at most {FASTEST_MPS:g} m/s")
    velocity = np.array([row for _, row in rows], dtype=np.float64) if all(given) else None
    return Curve(time_s, position, values[:, 4:], velocity)
