"""Simple bodies of metal as targets, by the formulas of :mod:`shared.physics.rcs`.

Their centre (a trihedral's apex) is the origin of their frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.targets.interface import Extent, Rigid, unit
from shared.physics import rcs
from shared.physics.units import SPEED_OF_LIGHT, power_to_db

Real = NDArray[np.float64]
NOMINAL_WAVELENGTH_M = SPEED_OF_LIGHT / 77e9


@dataclass(frozen=True)
class Sphere(Rigid):
    """A sphere about the origin; it echoes from its nearest point, up to 20 log10(1 + r / d) weaker at d from there."""

    radius_m: float
    cross_polar_ratio_db: ClassVar[float] = np.inf

    @property
    def footprint_m(self) -> float:
        return self.radius_m

    @property
    def nominal_rcs_dbsm(self) -> float:
        return float(power_to_db(rcs.sphere_rcs_m2(self.radius_m)))

    @property
    def extent_m(self) -> Extent:
        r = self.radius_m
        return (-r, -r, -r), (r, r, r)

    def far_field_m(self, wavelength_m: float) -> float:
        return 20.0 * self.radius_m  # 0.4 dB

    def echoes(self, radar: Real, wavelength_m: float) -> tuple[Real, Real]:
        return self.radius_m * unit(radar[None, :]), np.array([rcs.sphere_rcs_m2(self.radius_m)])


@dataclass(frozen=True)
class Cylinder(Rigid):
    """The curved side of a cylinder about z, its middle at the origin."""

    radius_m: float
    length_m: float
    cross_polar_ratio_db: ClassVar[float] = np.inf

    @property
    def footprint_m(self) -> float:
        return float(np.hypot(self.radius_m, 0.5 * self.length_m))

    @property
    def nominal_rcs_dbsm(self) -> float:
        return float(power_to_db(rcs.cylinder_rcs_m2(self.radius_m, self.length_m, NOMINAL_WAVELENGTH_M)))

    @property
    def extent_m(self) -> Extent:
        r, half = self.radius_m, 0.5 * self.length_m
        return (-r, -r, -half), (r, r, half)

    def far_field_m(self, wavelength_m: float) -> float:
        return max(20.0 * self.radius_m, rcs.far_field_m(self.length_m, wavelength_m))

    def echoes(self, radar: Real, wavelength_m: float) -> tuple[Real, Real]:
        point = self.radius_m * unit(np.array([[radar[0], radar[1], 0.0]]))
        u_axis = unit((radar - point[0])[None, :])[:, 2]
        return point, rcs.cylinder_rcs_m2(self.radius_m, self.length_m, wavelength_m, u_axis)


@dataclass(frozen=True)
class Plate(Rigid):
    """A flat plate across x, its width along y and its height along z; both sides echo."""

    width_m: float
    height_m: float
    cross_polar_ratio_db: ClassVar[float] = np.inf

    @property
    def footprint_m(self) -> float:
        return 0.5 * self.width_m

    @property
    def nominal_rcs_dbsm(self) -> float:
        return float(power_to_db(rcs.plate_rcs_m2(self.width_m, self.height_m, NOMINAL_WAVELENGTH_M)))

    @property
    def extent_m(self) -> Extent:
        y, z = 0.5 * self.width_m, 0.5 * self.height_m
        return (0.0, -y, -z), (0.0, y, z)

    def far_field_m(self, wavelength_m: float) -> float:
        return rcs.far_field_m(float(np.hypot(self.width_m, self.height_m)), wavelength_m)

    def echoes(self, radar: Real, wavelength_m: float) -> tuple[Real, Real]:
        direction = unit(radar[None, :])
        return np.zeros((1, 3)), rcs.plate_rcs_m2(
            self.width_m, self.height_m, wavelength_m, direction[:, 1], direction[:, 2]
        )


@dataclass(frozen=True)
class Dihedral(Rigid):
    """A right angle between two faces, open towards +x, its edge along z with its middle at the origin."""

    face_m: float
    length_m: float
    cross_polar_ratio_db: ClassVar[float] = np.inf  # edge along or across the polarisation

    @property
    def footprint_m(self) -> float:
        return self.face_m

    @property
    def nominal_rcs_dbsm(self) -> float:
        return float(power_to_db(rcs.dihedral_rcs_m2(self.face_m, self.length_m, NOMINAL_WAVELENGTH_M)))

    @property
    def extent_m(self) -> Extent:
        across, half = float(self.face_m * np.sqrt(0.5)), 0.5 * self.length_m
        return (0.0, -across, -half), (across, across, half)

    def far_field_m(self, wavelength_m: float) -> float:
        return rcs.far_field_m(float(np.hypot(np.sqrt(2.0) * self.face_m, self.length_m)), wavelength_m)

    def echoes(self, radar: Real, wavelength_m: float) -> tuple[Real, Real]:
        direction = unit(radar[None, :])
        azimuth = np.arctan2(direction[:, 1], direction[:, 0])
        value = rcs.dihedral_rcs_m2(self.face_m, self.length_m, wavelength_m, azimuth, direction[:, 2])
        return np.zeros((1, 3)), value


@dataclass(frozen=True)
class Trihedral(Rigid):
    """Three right-angled triangles with their apex at the origin, open towards +x; one inner edge leans up."""

    edge_m: float
    cross_polar_ratio_db: ClassVar[float] = np.inf
    EDGES: ClassVar[tuple[tuple[float, float, float], ...]] = (
        (float(np.sqrt(1 / 3)), 0.0, float(np.sqrt(2 / 3))),
        (float(np.sqrt(1 / 3)), float(np.sqrt(1 / 2)), -float(np.sqrt(1 / 6))),
        (float(np.sqrt(1 / 3)), -float(np.sqrt(1 / 2)), -float(np.sqrt(1 / 6))),
    )

    @property
    def footprint_m(self) -> float:
        return self.edge_m

    @property
    def nominal_rcs_dbsm(self) -> float:
        return float(power_to_db(rcs.trihedral_rcs_m2(self.edge_m, NOMINAL_WAVELENGTH_M)))

    @property
    def extent_m(self) -> Extent:
        x, y, z = (self.edge_m * values for values in np.array(self.EDGES).T)
        return (0.0, float(y.min()), float(z.min())), (float(x.max()), float(y.max()), float(z.max()))

    def far_field_m(self, wavelength_m: float) -> float:
        return rcs.far_field_m(float(np.sqrt(2.0)) * self.edge_m, wavelength_m)

    def echoes(self, radar: Real, wavelength_m: float) -> tuple[Real, Real]:
        cosines = unit(radar[None, :]) @ np.array(self.EDGES).T
        return np.zeros((1, 3)), rcs.trihedral_rcs_m2(self.edge_m, wavelength_m, cosines)
