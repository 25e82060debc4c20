"""A measured pattern: gain on a grid of azimuth and elevation, read from a CSV file."""

from __future__ import annotations

import csv
from collections.abc import Callable
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, model_validator

from shared.physics.errors import InputError
from shared.physics.units import db_to_power
from shared.radar.antenna.elements import Directions, Real, angles_deg

Axis = Annotated[tuple[FiniteFloat, ...], Field(min_length=2)]
Level = Annotated[FiniteFloat, Field(ge=-200, le=60)]

COLUMNS = ("azimuth_deg", "elevation_deg", "gain_dbi")
WHOLE_SPHERE = {"azimuth_deg": (-180.0, 180.0), "elevation_deg": (-90.0, 90.0)}


class TablePattern(BaseModel):
    """Gain on a full rectangular grid, bilinear in dB between its points.

    In a radar's TOML file ``{ kind = "table", file = "pattern.csv" }`` stands for the values: the file is read when the
    radar is (:func:`read_table`), so that the radar's metadata hold the pattern itself and not the name of a file.

    :param azimuth_deg: [A] rising, from -180 to 180, positive left [deg]
    :param elevation_deg: [E] rising, from -90 to 90, positive up [deg]
    :param gain_dbi: [A][E] gain [dBi]
    :param outside_gain_dbi: gain wherever the grid does not reach [dBi]; without it the grid covers the whole sphere,
        because echoes may arrive from anywhere
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["table"] = "table"
    azimuth_deg: Axis
    elevation_deg: Axis
    gain_dbi: tuple[tuple[Level, ...], ...]
    outside_gain_dbi: Level | None = None

    @model_validator(mode="after")
    def _full_grid(self) -> TablePattern:
        for name, (lowest, highest) in WHOLE_SPHERE.items():
            axis = getattr(self, name)
            if any(right <= left for left, right in pairwise(axis)):
                raise ValueError(f"{name} does not rise throughout; expected each value once, in rising order")
            if axis[0] < lowest or axis[-1] > highest:
                raise ValueError(f"{name} = {min(axis[0], -axis[-1]):g}; expected {lowest:g} to {highest:g}")
            if self.outside_gain_dbi is None and (axis[0] > lowest or axis[-1] < highest):
                raise ValueError(
                    f"{name} runs from {axis[0]:g} to {axis[-1]:g}; expected {lowest:g} to {highest:g}, or "
                    "outside_gain_dbi for the rest of the sphere"
                )
        shape = {len(row) for row in self.gain_dbi}
        if len(self.gain_dbi) != len(self.azimuth_deg) or shape != {len(self.elevation_deg)}:
            raise ValueError(f"gain_dbi is not {len(self.azimuth_deg)} rows (azimuth) of {len(self.elevation_deg)}")
        return self

    @cached_property
    def _level_db(self) -> Callable[[Real], Real]:
        """[n, 2] azimuth and elevation [deg] to [n] gain [dBi]."""
        from scipy.interpolate import RegularGridInterpolator  # where needed: few radars have a measured pattern

        return RegularGridInterpolator(
            (np.array(self.azimuth_deg), np.array(self.elevation_deg)),
            np.array(self.gain_dbi),
            method="linear",
            bounds_error=False,
            fill_value=self.outside_gain_dbi,  # None where the grid covers the sphere: nothing is outside
        )

    def power_gain(self, directions: Directions) -> Real:
        """[...] linear power gain towards ``directions`` [..., 3] (any length; a zero vector counts as boresight)."""
        angles = np.stack(angles_deg(directions), axis=-1)
        return db_to_power(self._level_db(angles).reshape(angles.shape[:-1]))  # SciPy makes [1] of a single one


def read_table(path: Path, outside_gain_dbi: float | None = None) -> TablePattern:
    """A pattern from a CSV file with the columns azimuth_deg, elevation_deg, gain_dbi, in any order of its rows.

    No error quotes text of the file: a radar's file may name any file of the machine.

    :param outside_gain_dbi: see :class:`TablePattern`
    :raises InputError: not readable, another header, a value that is no finite number or beyond its bounds, a direction
        twice or missing, a grid that leaves directions open; with the line, and with the value where it is a number
    """
    expected = f"a CSV file with the header {','.join(COLUMNS)}"
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            rows = [(reader.line_num, row) for row in reader]
    except OSError as error:
        raise InputError(path, f"not readable: {error.strerror}", expected) from error
    except UnicodeDecodeError:
        raise InputError(path, "not readable: no UTF-8 text", expected) from None
    except csv.Error as error:
        raise InputError(path, f"line {reader.line_num}: not readable as CSV", expected) from error
    header = [name.strip() for name in rows[0][1]] if rows else []
    if sorted(header) != sorted(COLUMNS):
        raise InputError(path, "line 1: not the header of a pattern", expected)
    order = [header.index(name) for name in COLUMNS]
    levels: dict[tuple[float, float], float] = {}
    first_row: dict[tuple[float, float], int] = {}
    for number, row in rows[1:]:
        if not row:
            continue
        if len(row) != len(COLUMNS):
            raise InputError(path, f"line {number}: {len(row)} values", f"{len(COLUMNS)}: {','.join(header)}")
        azimuth, elevation, gain = (_number(path, number, COLUMNS[i], row[order[i]]) for i in range(3))
        place = (azimuth, elevation)
        if place in levels:
            fault = f"line {number}: azimuth_deg = {azimuth:g}, elevation_deg = {elevation:g} stands in line"
            raise InputError(path, f"{fault} {first_row[place]} too", "every direction once")
        levels[place], first_row[place] = gain, number
    azimuths, elevations = (sorted({place[axis] for place in levels}) for axis in (0, 1))
    for azimuth in azimuths:
        for elevation in elevations:
            if (azimuth, elevation) not in levels:
                known = min(row for place, row in first_row.items() if place[0] == azimuth)
                fault = (
                    f"no line with azimuth_deg = {azimuth:g}, elevation_deg = {elevation:g} (azimuth of line {known})"
                )
                raise InputError(path, fault, f"all {len(azimuths)} x {len(elevations)} directions of the grid")
    try:
        return TablePattern(
            azimuth_deg=tuple(azimuths),
            elevation_deg=tuple(elevations),
            gain_dbi=tuple(tuple(levels[azimuth, elevation] for elevation in elevations) for azimuth in azimuths),
            outside_gain_dbi=outside_gain_dbi,
        )
    except ValidationError as error:
        first = error.errors()[0]
        reason = first["ctx"]["error"] if first["type"] == "value_error" else f"{first['loc'][0]}: {first['msg']}"
        raise InputError(path, str(reason)) from error


def _number(path: Path, line: int, column: str, text: str) -> float:
    lowest, highest = WHOLE_SPHERE.get(column, (-200.0, 60.0))
    expected = f"a number from {lowest:g} to {highest:g}"
    try:
        value = float(text)
    except ValueError:
        raise InputError(path, f"line {line}: {column} is no number", expected) from None
    if not lowest <= value <= highest:  # false for NaN too
        raise InputError(path, f"line {line}: {column} = {value:g}", expected)
    return value + 0.0  # -0 is 0
