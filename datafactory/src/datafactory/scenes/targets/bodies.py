"""What every model of a target offers, and simple bodies of metal, by the formulas of :mod:`shared.physics.rcs`.

The centre of a body (a trihedral's apex) is the origin of its frame. A frame's paths have constant velocities
(:mod:`datafactory.paths.table`). Those of parts that move against the body are theirs at the frame's start.
Acceleration a then makes an error of a T^2 / 2 in place and a T in velocity by the end of a frame of T seconds."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from shared.physics import rcs
from shared.physics.units import SPEED_OF_LIGHT, power_to_db
from shared.physics.vectors import unit

Real = NDArray[np.float64]
Extent = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Lower and upper corner of a box in the target's frame [m]."""
NOMINAL_WAVELENGTH_M = SPEED_OF_LIGHT / 77e9


@dataclass(frozen=True)
class Motion:
    """How a target moves, for models whose parts move too.

    :param forward_mps: speed along the model's x [m/s]; negative where it goes backwards
    :param time_s: since the scene's time 0 [s]
    :param seed: of what is random in a target: where in its cycle it is at time 0
    """

    forward_mps: float = 0.0
    time_s: float = 0.0
    seed: int = 0


@dataclass(frozen=True)
class MovingParts:
    """N echo points in the target's frame.

    :param position: [N, 3] [m]
    :param velocity: [N, 3] relative to the target's origin [m/s]
    :param rcs_m2: [N] cross sections towards the radar [m^2]
    """

    position: Real
    velocity: Real
    rcs_m2: Real

    @staticmethod
    def none() -> MovingParts:
        return MovingParts(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))


class RcsModel(ABC):
    """A target's model. Its parts are fixed to it, unless it says otherwise."""

    cross_polar_ratio_db: ClassVar[float] = np.inf
    """Co-polarised over cross-polarised echo [dB]; infinite where there is no depolarisation."""

    @property
    def nominal_rcs_dbsm(self) -> float:
        """One number for lists [dBsm]: the mean of a road user; of a body its best aspect at 77 GHz, straight ahead."""
        _, level_m2 = self.echoes(np.array([1e3, 0.0, 0.0]), NOMINAL_WAVELENGTH_M)
        return float(power_to_db(level_m2[0]))

    @property
    @abstractmethod
    def footprint_m(self) -> float:
        """Radius [m] of the circle on the ground, around the target's origin, that holds it."""

    @property
    @abstractmethod
    def extent_m(self) -> Extent:
        """The box that the target fills."""

    def far_field_m(self, wavelength_m: float) -> float:
        """Distance [m] from which on the model holds."""
        return 0.0

    @abstractmethod
    def echoes(self, radar: Real, wavelength_m: float) -> tuple[Real, Real]:
        """Echo points [N, 3] [m] in the target's frame and their cross sections [N] [m^2]: those fixed to the body.

        :param radar: [3] where the radar stands in the target's frame [m], not at an echo point
        """

    def parts(self, radar: Real, motion: Motion) -> MovingParts:
        """Echo points that move against the body; as many from everywhere, at any time.

        :param radar: as in ``echoes``
        """
        return MovingParts.none()

    def unfit(self, forward_mps: float) -> str:
        """Why the model cannot move at this speed, in words; "" where it can."""
        return ""

    def __repr__(self) -> str:
        """``Car(wheel_radius_m=0.3)``: without the fields that have their defaults.

        Scenes are hashed by the texts of their targets: an option that a model gains later changes no hash.
        """
        assert is_dataclass(self)
        stated = [
            f"{item.name}={getattr(self, item.name)!r}"
            for item in fields(self)
            if item.default is MISSING or getattr(self, item.name) != item.default
        ]
        return f"{type(self).__name__}({', '.join(stated)})"


@dataclass(frozen=True, repr=False)
class Sphere(RcsModel):
    """A sphere about the origin; it echoes from its nearest point, up to 20 log10(1 + r / d) weaker at d from there."""

    radius_m: float

    @property
    def footprint_m(self) -> float:
        return self.radius_m

    @property
    def extent_m(self) -> Extent:
        r = self.radius_m
        return (-r, -r, -r), (r, r, r)

    def far_field_m(self, wavelength_m: float) -> float:
        return 20.0 * self.radius_m  # 0.4 dB

    def echoes(self, radar: Real, wavelength_m: float) -> tuple[Real, Real]:
        return self.radius_m * unit(radar[None, :]), np.array([rcs.sphere_rcs_m2(self.radius_m)])


@dataclass(frozen=True, repr=False)
class Cylinder(RcsModel):
    """The curved side of a cylinder about z, its middle at the origin."""

    radius_m: float
    length_m: float

    @property
    def footprint_m(self) -> float:
        return float(np.hypot(self.radius_m, 0.5 * self.length_m))

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


@dataclass(frozen=True, repr=False)
class Plate(RcsModel):
    """A flat plate across x, its width along y and its height along z; both sides echo."""

    width_m: float
    height_m: float

    @property
    def footprint_m(self) -> float:
        return 0.5 * self.width_m

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


@dataclass(frozen=True, repr=False)
class Dihedral(RcsModel):
    """A right angle between two faces, open towards +x, its edge along z with its middle at the origin."""

    face_m: float
    length_m: float

    @property
    def footprint_m(self) -> float:
        return self.face_m

    @property
    def nominal_rcs_dbsm(self) -> float:
        # Not by ``echoes``: in rare cases the last bit would differ, and with it the hash of the scene.
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


@dataclass(frozen=True, repr=False)
class Trihedral(RcsModel):
    """Three right-angled triangles with their apex at the origin, open towards +x; one inner edge leans up."""

    edge_m: float
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
        # Not by ``echoes``, as of the dihedral.
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
