"""Element patterns given by a formula in azimuth and elevation: isotropic, parabolic, 3GPP TR 38.901."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float, Float64
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from shared.physics.units import ArrayOrScalar, db_to_power

Directions = Float[np.ndarray, "*shape 3"]
Real = Float64[ArrayOrScalar, "*shape"]
"""One number for each direction."""


def angles_deg(directions: Directions) -> tuple[Real, Real]:
    """Azimuth (positive left) and elevation (positive up) [deg], each [...], of ``directions`` [..., 3] of any length.

    A zero vector counts as boresight.
    """
    x, y, z = np.moveaxis(np.asarray(directions, dtype=np.float64), -1, 0)
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.sqrt(x * x + y * y)))


class IsotropicPattern(BaseModel):
    """The same gain in every direction.

    :param gain_dbi: gain [dBi]
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["isotropic"] = "isotropic"
    gain_dbi: Annotated[FiniteFloat, Field(ge=-200, le=200)] = 0.0

    def power_gain(self, directions: Directions) -> Real:
        """[...] linear power gain towards ``directions`` [..., 3] (any length)."""
        return np.full(directions.shape[:-1], float(db_to_power(self.gain_dbi)))


class ParabolicPattern(BaseModel):
    """Main lobe parabolic in dB over azimuth and elevation, above a constant side and back lobe level.

    A(az, el) = -min(12 (az / az_3dB)^2 + 12 (el / el_3dB)^2, floor), the form of 3GPP TR 38.901, Table 7.3-1. It fits a
    patch column near its main lobe; the shape of its sidelobes is not modelled, only their level.

    :param gain_dbi: gain at boresight [dBi]
    :param azimuth_beamwidth_deg: one-way 3 dB width in azimuth [deg]
    :param elevation_beamwidth_deg: one-way 3 dB width in elevation [deg]
    :param floor_db: level of side and back lobes below the main lobe [dB]
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

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


class Tr38901Pattern(BaseModel):
    """The base-station element of 3GPP TR 38.901, Table 7.3-1, which leaves nothing to choose.

    A = -min(A_V + A_H, 30), A_V = min(12 (el / 65 deg)^2, 30), A_H = min(12 (az / 65 deg)^2, 30), gain 8 dBi. The gain
    is 1.8 dB below the directivity of this shape, i.e. the element has losses
    (``tests/shared/radar/test_antenna.py`` integrates it).
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

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
