"""Radiation patterns of single elements, as power gain over direction in the radar frame.

Every pattern has ``power_gain(directions [..., 3]) -> [...]``; its ``kind`` names it in a radar's TOML file:

- ``isotropic``: the same gain everywhere;
- ``parabolic``: a main lobe parabolic in dB, the car radar's (:func:`car_radar_pattern`);
- ``patch``: a rectangular microstrip patch;
- ``tr38901``: the base-station element of 3GPP TR 38.901;
- ``table``: measured, from a CSV file.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from functools import cached_property, lru_cache
from itertools import pairwise, product
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float, Float64
from pydantic import Field, FiniteFloat, model_validator

from shared.physics.errors import InputError
from shared.physics.units import ArrayOrScalar, db_to_power, power_to_db
from shared.radar.validation import Described, validated

Directions = Float[np.ndarray, "*shape 3"]
Real = Float64[ArrayOrScalar, "*shape"]
"""One number for each direction."""


def angles_deg(directions: Directions) -> tuple[Real, Real]:
    """Azimuth (positive left) and elevation (positive up) [deg], each [...], of ``directions`` [..., 3] of any length.

    A zero vector counts as boresight.
    """
    x, y, z = np.moveaxis(np.asarray(directions, dtype=np.float64), -1, 0)
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.sqrt(x * x + y * y)))


class IsotropicPattern(Described):
    """The same gain in every direction.

    :param gain_dbi: gain [dBi]
    """

    kind: Literal["isotropic"] = "isotropic"
    gain_dbi: Annotated[FiniteFloat, Field(ge=-200, le=200)] = 0.0

    def power_gain(self, directions: Directions) -> Real:
        """[...] linear power gain towards ``directions`` [..., 3] (any length)."""
        return np.full(directions.shape[:-1], float(db_to_power(self.gain_dbi)))


class ParabolicPattern(Described):
    """Main lobe parabolic in dB over azimuth and elevation, above a constant side and back lobe level.

    A(az, el) = -min(12 (az / az_3dB)^2 + 12 (el / el_3dB)^2, floor), the form of 3GPP TR 38.901, Table 7.3-1. It fits a
    patch column near its main lobe; the shape of its sidelobes is not modelled, only their level.

    :param gain_dbi: gain at boresight [dBi]
    :param azimuth_beamwidth_deg: one-way 3 dB width in azimuth [deg]
    :param elevation_beamwidth_deg: one-way 3 dB width in elevation [deg]
    :param floor_db: level of side and back lobes below the main lobe [dB]
    """

    kind: Literal["parabolic"] = "parabolic"
    gain_dbi: Annotated[FiniteFloat, Field(ge=-200, le=200)]
    azimuth_beamwidth_deg: Annotated[FiniteFloat, Field(gt=0, le=720)]
    elevation_beamwidth_deg: Annotated[FiniteFloat, Field(gt=0, le=720)]
    floor_db: Annotated[FiniteFloat, Field(ge=0, le=400)] = 30.0

    def power_gain(self, directions: Directions) -> Real:
        """[...] linear power gain towards ``directions`` [..., 3] (any length; a zero vector counts as boresight)."""
        azimuth, elevation = angles_deg(directions)
        loss = (
            12.0 * (azimuth / self.azimuth_beamwidth_deg) ** 2 + 12.0 * (elevation / self.elevation_beamwidth_deg) ** 2
        )
        return db_to_power(self.gain_dbi - np.minimum(loss, self.floor_db))


class Tr38901Pattern(Described):
    """The base-station element of 3GPP TR 38.901, Table 7.3-1, which leaves nothing to choose.

    A = -min(A_V + A_H, 30), A_V = min(12 (el / 65 deg)^2, 30), A_H = min(12 (az / 65 deg)^2, 30), gain 8 dBi. The gain
    is 1.8 dB below the directivity of this shape, i.e. the element has losses
    (``tests/shared/radar/test_antenna.py`` integrates it).
    """

    kind: Literal["tr38901"] = "tr38901"

    def power_gain(self, directions: Directions) -> Real:
        """[...] linear power gain towards ``directions`` [..., 3] (any length; a zero vector counts as boresight)."""
        azimuth, elevation = angles_deg(directions)
        vertical = np.minimum(12.0 * (elevation / 65.0) ** 2, 30.0)
        horizontal = np.minimum(12.0 * (azimuth / 65.0) ** 2, 30.0)
        return db_to_power(8.0 - np.minimum(vertical + horizontal, 30.0))


def car_radar_pattern() -> ParabolicPattern:
    """A car radar's element: two-way 3 dB widths of 110 deg in azimuth and 13 deg in elevation.

    In dB the two-way pattern is twice the one-way parabola, so the one-way widths are sqrt(2) larger. The gain is the
    directivity of this shape, i.e. a lossless element (``tests/shared/radar/test_antenna.py`` integrates it).
    """
    return ParabolicPattern(
        gain_dbi=11.1,
        azimuth_beamwidth_deg=110.0 * np.sqrt(2.0),
        elevation_beamwidth_deg=13.0 * np.sqrt(2.0),
        floor_db=30.0,
    )


QUADRATURE_POINTS = 200
"""Of each of the two angles over the half space; patterns of patches up to two wavelengths are integrated to 1e-9."""


class PatchPattern(Described):
    """A rectangular patch in its TM010 mode: two slots of equal phase, one effective length apart.

    With w the radiated direction's cosine to the patch's width, l that to its resonant length, n that to its normal,
    k = 2 pi / lambda and sinc(x) = sin(x) / x (Balanis, Antenna Theory, 4th ed., eq. 14-40 to 14-44):

        |E|^2 = (1 - w^2) sinc^2(k W w / 2) sinc^2(k h n / 2) cos^2(k L_e l / 2)

    One slot is the magnetic current along the width, hence 1 - w^2; the cosine is the array factor of both. The gain is
    the directivity of this shape, integrated, times the efficiency. Limits: the ground plane is infinite, so that
    nothing diffracts round its edge and the field along it does not vanish in the E plane; no surface waves, no
    coupling to neighbours. Behind it stands a constant level.

    :param width_wavelengths: width W across the resonant length, in free-space wavelengths
    :param length_wavelengths: effective length L_e between the slots (the patch and its fringes), likewise
    :param height_wavelengths: height h of the substrate, likewise
    :param resonant_along: the axis of the length, which is the axis of polarisation: "z" vertical, "y" horizontal
    :param efficiency_db: power radiated of the power accepted [dB]
    :param back_db: level behind the ground plane below the gain at boresight [dB]
    """

    kind: Literal["patch"] = "patch"
    width_wavelengths: Annotated[FiniteFloat, Field(gt=0, le=2)] = 0.4
    length_wavelengths: Annotated[FiniteFloat, Field(gt=0, le=2)] = 0.3
    height_wavelengths: Annotated[FiniteFloat, Field(ge=0, le=0.5)] = 0.03
    resonant_along: Literal["z", "y"] = "z"
    efficiency_db: Annotated[FiniteFloat, Field(le=0)] = 0.0
    back_db: Annotated[FiniteFloat, Field(ge=0)] = 30.0

    @property
    def boresight_gain_dbi(self) -> float:
        """Gain along the normal [dBi]: directivity times efficiency."""
        return float(power_to_db(_directivity(self))) + self.efficiency_db

    def power_gain(self, directions: Directions) -> Real:
        """[...] linear power gain towards ``directions`` [..., 3] (any length; a zero vector counts as boresight)."""
        directions = np.asarray(directions, dtype=np.float64)
        length = np.linalg.norm(directions, axis=-1, keepdims=True)
        cosines = np.where(length > 0.0, directions / np.where(length > 0.0, length, 1.0), [1.0, 0.0, 0.0])
        shape = np.where(cosines[..., 0] > 0.0, self._shape(cosines), float(db_to_power(-self.back_db)))
        return shape * float(db_to_power(self.boresight_gain_dbi))

    def _shape(self, cosines: Directions) -> Real:
        """[...] |E|^2 relative to boresight, of unit vectors [..., 3]."""
        normal, y, z = np.moveaxis(cosines, -1, 0)
        along, across = (z, y) if self.resonant_along == "z" else (y, z)
        # NumPy's sinc(x) is sin(pi x) / (pi x): k W w / 2 = pi (W / lambda) w. Relative to boresight, where n = 1.
        slot = np.sinc(self.width_wavelengths * across) * np.sinc(self.height_wavelengths * normal)
        slot /= np.sinc(self.height_wavelengths)
        return (1.0 - across**2) * (slot * np.cos(np.pi * self.length_wavelengths * along)) ** 2


@lru_cache(maxsize=16)
def _directivity(pattern: PatchPattern) -> float:
    """4 pi over the integral of the shape over the sphere, so that the mean gain of a lossless patch is 1."""
    node, weight = np.polynomial.legendre.leggauss(QUADRATURE_POINTS)
    theta, theta_weight = 0.25 * np.pi * (node + 1.0), 0.25 * np.pi * weight  # from the normal, 0 to pi / 2
    phi = 2.0 * np.pi * np.arange(QUADRATURE_POINTS) / QUADRATURE_POINTS
    sine, cosine = np.sin(theta)[:, None], np.repeat(np.cos(theta)[:, None], QUADRATURE_POINTS, axis=1)
    front = pattern._shape(np.stack([cosine, sine * np.cos(phi), sine * np.sin(phi)], axis=-1)).mean(axis=1)
    power = 2.0 * np.pi * float(theta_weight @ (front * np.sin(theta)))
    power += 2.0 * np.pi * float(db_to_power(-pattern.back_db))
    return 4.0 * np.pi / power


Axis = Annotated[tuple[FiniteFloat, ...], Field(min_length=2)]
Level = Annotated[FiniteFloat, Field(ge=-200, le=60)]

COLUMNS = ("azimuth_deg", "elevation_deg", "gain_dbi")
WHOLE_SPHERE = {"azimuth_deg": (-180.0, 180.0), "elevation_deg": (-90.0, 90.0)}


class TablePattern(Described):
    """Gain on a full rectangular grid, bilinear in dB between its points.

    In a radar's TOML file ``{ kind = "table", file = "pattern.csv" }`` stands for the values: the file is read when the
    radar is (:func:`read_table`), so that the radar's metadata hold the pattern itself and not the name of a file.

    :param azimuth_deg: [A] rising, from -180 to 180, positive left [deg]
    :param elevation_deg: [E] rising, from -90 to 90, positive up [deg]
    :param gain_dbi: [A][E] gain [dBi]
    :param outside_gain_dbi: gain wherever the grid does not reach [dBi]; without it the grid covers the whole sphere,
        because echoes may arrive from anywhere
    """

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
                outside = axis[0] if axis[0] < lowest else axis[-1]
                raise ValueError(f"{name} = {outside:g}; expected {lowest:g} to {highest:g}")
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
        twice or missing, a grid that leaves directions open
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
    for number, row in rows[1:]:
        if not row:
            continue
        if len(row) != len(COLUMNS):
            raise InputError(path, f"line {number}: {len(row)} values", f"{len(COLUMNS)}: {','.join(header)}")
        azimuth, elevation, gain = (_number(path, number, COLUMNS[i], row[order[i]]) for i in range(3))
        if (azimuth, elevation) in levels:
            fault = f"line {number}: azimuth_deg = {azimuth:g}, elevation_deg = {elevation:g} a second time"
            raise InputError(path, fault, "every direction once")
        levels[azimuth, elevation] = gain
    azimuths, elevations = (sorted({place[axis] for place in levels}) for axis in (0, 1))
    for azimuth, elevation in product(azimuths, elevations):
        if (azimuth, elevation) not in levels:
            fault = f"no line with azimuth_deg = {azimuth:g}, elevation_deg = {elevation:g}"
            raise InputError(path, fault, f"all {len(azimuths)} x {len(elevations)} directions of the grid")
    for name, angles in zip(COLUMNS, (azimuths, elevations), strict=False):
        if len(angles) < 2:
            expected = "at least 2 azimuths and 2 elevations, with a line for each pair"
            raise InputError(path, f"{name}: {len(angles)} in the file", expected)
    gain_dbi = [[levels[azimuth, elevation] for elevation in elevations] for azimuth in azimuths]
    table = {"azimuth_deg": azimuths, "elevation_deg": elevations, "gain_dbi": gain_dbi}
    return validated(TablePattern, table | {"outside_gain_dbi": outside_gain_dbi}, path)


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


Pattern = Annotated[
    IsotropicPattern | ParabolicPattern | PatchPattern | Tr38901Pattern | TablePattern, Field(discriminator="kind")
]
