"""Element patterns given by a formula: isotropic, parabolic, 3GPP TR 38.901, and the rectangular microstrip patch."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float, Float64
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from shared.physics.units import ArrayOrScalar, db_to_power, power_to_db

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


QUADRATURE_POINTS = 200
"""Of each of the two angles over the half space; patterns of patches up to two wavelengths are integrated to 1e-9."""


class PatchPattern(BaseModel):
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

    model_config = ConfigDict(frozen=True, extra="forbid")

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
