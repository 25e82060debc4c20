"""Models of targets by their radar cross section: echo points and their strengths, seen from one position.

A model has its own frame, x forward, y left, z up, metres. Road users stand on the ground at the frame's origin; bodies
of metal have their centre (a trihedral its apex) there. A model takes the radar's position in that frame and returns
echo points. Their phases follow from their positions. Nothing here is random.

Road users are 3GPP TR 38.901 (Release 19), clause 7.9.2, with its random component at its linear mean of 1; the cyclist
is Belgiovane and Chen (2016). Both are levels found by measurement, without regard to distance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from shared.physics import rcs
from shared.physics.units import SPEED_OF_LIGHT, db_to_power, power_to_db

Real = NDArray[np.float64]
NOMINAL_WAVELENGTH_M = SPEED_OF_LIGHT / 77e9


class RcsModel(Protocol):
    """The interface of a target's model."""

    @property
    def cross_polar_ratio_db(self) -> float:
        """Co-polarised over cross-polarised echo [dB]; infinite where there is no depolarisation."""

    @property
    def nominal_rcs_dbsm(self) -> float:
        """One number for lists [dBsm]: the mean of a road user, the best aspect of a body at 77 GHz."""

    @property
    def footprint_m(self) -> float:
        """Radius [m] of the circle on the ground, around the target's origin, that holds it."""

    def far_field_m(self, wavelength_m: float) -> float:
        """Distance [m] from which on the model holds."""

    def echoes(self, radar: Real, wavelength_m: float) -> tuple[Real, Real]:
        """Echo points [N, 3] [m] in the target's frame and their cross sections [N] [m^2].

        :param radar: [3] where the radar stands in the target's frame [m], not at an echo point
        """


@dataclass(frozen=True)
class _Lobe:
    """One scattering point of a vehicle: a row of TR 38.901, Table 7.9.2.1-5, angles in degrees, levels in dB."""

    position: tuple[float, float, float]
    azimuth: float | None
    azimuth_width: float
    zenith: float
    zenith_width: float
    largest_dbsm: float
    span_db: float

    def rcs_dbsm(self, direction: Real) -> float:
        """Eq. (7.9.2-3) for monostatic sensing, towards a unit vector [3]."""
        zenith = np.degrees(np.arccos(np.clip(direction[2], -1.0, 1.0)))
        loss = min(12.0 * ((zenith - self.zenith) / self.zenith_width) ** 2, self.span_db)
        if self.azimuth is not None:
            turn = (np.degrees(np.arctan2(direction[1], direction[0])) - self.azimuth + 180.0) % 360.0 - 180.0
            loss += min(12.0 * (turn / self.azimuth_width) ** 2, self.span_db)
        return self.largest_dbsm - min(loss, self.span_db)


@dataclass(frozen=True)
class Car:
    """A passenger car of 5.0 x 2.0 x 1.6 m (TR 37.885, type 2): five scattering points, one a face.

    At the lobes' centres the points' sum is 15.5 dBsm in front, 20.8 at either side, 14.6 behind, and over the sphere
    without the roof 11.4 (TR 38.901 states a mean of 11.25 dBsm). The front lobe looks up by 18 deg: at the height of a
    bumper the front shows 11.7 dBsm.
    """

    LOBES: ClassVar[tuple[_Lobe, ...]] = (
        _Lobe((0.0, 1.0, 0.8), 90.0, 26.90, 79.70, 44.42, 20.60, 20.52),
        _Lobe((-2.5, 0.0, 0.8), 180.0, 36.32, 79.65, 36.73, 13.90, 13.82),
        _Lobe((0.0, -1.0, 0.8), 270.0, 26.90, 79.70, 44.42, 20.60, 20.52),
        _Lobe((2.5, 0.0, 0.8), 0.0, 40.54, 71.75, 29.13, 14.99, 14.91),
        _Lobe((0.0, 0.0, 1.6), None, 360.0, 0.0, 18.13, 21.12, 21.05),
    )
    footprint_m: ClassVar[float] = 2.7
    cross_polar_ratio_db: ClassVar[float] = 21.12
    nominal_rcs_dbsm: ClassVar[float] = 11.25

    def far_field_m(self, wavelength_m: float) -> float:
        return 0.0

    def echoes(self, radar: Real, wavelength_m: float) -> tuple[Real, Real]:
        points = np.array([lobe.position for lobe in self.LOBES])
        directions = _unit(radar - points)
        levels = [lobe.rcs_dbsm(direction) for lobe, direction in zip(self.LOBES, directions, strict=True)]
        return points, db_to_power(levels)


@dataclass(frozen=True)
class Pedestrian:
    """A human (TR 38.901, Table 7.9.2.1-1): one point at half of 1.75 m, the same -1.37 dBsm from everywhere."""

    footprint_m: ClassVar[float] = 0.4
    cross_polar_ratio_db: ClassVar[float] = 19.81
    nominal_rcs_dbsm: ClassVar[float] = -1.37

    def far_field_m(self, wavelength_m: float) -> float:
        return 0.0

    def echoes(self, radar: Real, wavelength_m: float) -> tuple[Real, Real]:
        return np.array([[0.0, 0.0, 0.875]]), db_to_power([self.nominal_rcs_dbsm])


@dataclass(frozen=True)
class Cyclist:
    """A cyclist: rider and two wheels, -8 dBsm together from the side, -13 dBsm from ahead and behind.

    The two levels are the ends of the span that Belgiovane and Chen ("Bicycles and human riders backscattering at 77
    GHz for automotive radar", EuCAP 2016) measured. Which aspect has which, sigma = -8 dBsm sin^2 + -13 dBsm cos^2 of
    the azimuth between them, half of it from the rider and a quarter from either wheel, and the human's
    depolarisation are assumptions.
    """

    SIDE_DBSM: ClassVar[float] = -8.0
    END_DBSM: ClassVar[float] = -13.0
    footprint_m: ClassVar[float] = 0.9
    cross_polar_ratio_db: ClassVar[float] = 19.81
    nominal_rcs_dbsm: ClassVar[float] = -9.8  # the mean over azimuth

    def far_field_m(self, wavelength_m: float) -> float:
        return 0.0

    def echoes(self, radar: Real, wavelength_m: float) -> tuple[Real, Real]:
        points = np.array([[0.0, 0.0, 1.1], [0.55, 0.0, 0.35], [-0.55, 0.0, 0.35]])
        x, y, _ = _unit(radar - points).T
        across = np.hypot(x, y)
        sine_squared = np.where(across > 0.0, y**2 / np.where(across > 0.0, across, 1.0) ** 2, 0.5)
        whole = db_to_power(self.SIDE_DBSM) * sine_squared + db_to_power(self.END_DBSM) * (1.0 - sine_squared)
        return points, whole * np.array([0.5, 0.25, 0.25])


@dataclass(frozen=True)
class Sphere:
    """A sphere about the origin; it echoes from its nearest point, up to 20 log10(1 + r / d) weaker at d from there."""

    radius_m: float
    cross_polar_ratio_db: ClassVar[float] = np.inf

    @property
    def footprint_m(self) -> float:
        return self.radius_m

    @property
    def nominal_rcs_dbsm(self) -> float:
        return float(power_to_db(rcs.sphere_rcs_m2(self.radius_m)))

    def far_field_m(self, wavelength_m: float) -> float:
        return 20.0 * self.radius_m  # 0.4 dB

    def echoes(self, radar: Real, wavelength_m: float) -> tuple[Real, Real]:
        return self.radius_m * _unit(radar[None, :]), np.array([rcs.sphere_rcs_m2(self.radius_m)])


@dataclass(frozen=True)
class Cylinder:
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

    def far_field_m(self, wavelength_m: float) -> float:
        return max(20.0 * self.radius_m, rcs.far_field_m(self.length_m, wavelength_m))

    def echoes(self, radar: Real, wavelength_m: float) -> tuple[Real, Real]:
        point = self.radius_m * _unit(np.array([[radar[0], radar[1], 0.0]]))
        u_axis = _unit((radar - point[0])[None, :])[:, 2]
        return point, rcs.cylinder_rcs_m2(self.radius_m, self.length_m, wavelength_m, u_axis)


@dataclass(frozen=True)
class Plate:
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

    def far_field_m(self, wavelength_m: float) -> float:
        return rcs.far_field_m(float(np.hypot(self.width_m, self.height_m)), wavelength_m)

    def echoes(self, radar: Real, wavelength_m: float) -> tuple[Real, Real]:
        direction = _unit(radar[None, :])
        return np.zeros((1, 3)), rcs.plate_rcs_m2(
            self.width_m, self.height_m, wavelength_m, direction[:, 1], direction[:, 2]
        )


@dataclass(frozen=True)
class Dihedral:
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

    def far_field_m(self, wavelength_m: float) -> float:
        return rcs.far_field_m(float(np.hypot(np.sqrt(2.0) * self.face_m, self.length_m)), wavelength_m)

    def echoes(self, radar: Real, wavelength_m: float) -> tuple[Real, Real]:
        direction = _unit(radar[None, :])
        azimuth = np.arctan2(direction[:, 1], direction[:, 0])
        value = rcs.dihedral_rcs_m2(self.face_m, self.length_m, wavelength_m, azimuth, direction[:, 2])
        return np.zeros((1, 3)), value


@dataclass(frozen=True)
class Trihedral:
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

    def far_field_m(self, wavelength_m: float) -> float:
        return rcs.far_field_m(float(np.sqrt(2.0)) * self.edge_m, wavelength_m)

    def echoes(self, radar: Real, wavelength_m: float) -> tuple[Real, Real]:
        cosines = _unit(radar[None, :]) @ np.array(self.EDGES).T
        return np.zeros((1, 3)), rcs.trihedral_rcs_m2(self.edge_m, wavelength_m, cosines)


MODELS: dict[str, type] = {
    "car": Car,
    "pedestrian": Pedestrian,
    "cyclist": Cyclist,
    "sphere": Sphere,
    "cylinder": Cylinder,
    "plate": Plate,
    "dihedral": Dihedral,
    "trihedral": Trihedral,
}
"""Every model by its name in a scene."""

ROAD_USERS = ("car", "pedestrian", "cyclist")
"""Models without sizes: a prim's name alone selects them."""


def sizes_of(kind: str) -> tuple[str, ...]:
    """Names of the sizes [m] that a model needs, e.g. ``("radius_m", "length_m")``."""
    return tuple(item.name for item in fields(MODELS[kind]))


SIZES = tuple(sorted({name for kind in MODELS for name in sizes_of(kind)}))


def target_model(kind: str, sizes: Mapping[str, float]) -> RcsModel:
    """The model of this name with these sizes [m].

    :raises ValueError: an unknown name, a size too many or too few, or one that is not above 0 and at most 1000 m
    """
    if kind not in MODELS:
        raise ValueError(f"{kind!r}; expected one of {', '.join(MODELS)}")
    wanted = sizes_of(kind)
    if set(sizes) != set(wanted):
        raise ValueError(f"{kind!r} with {', '.join(sizes) or 'no sizes'}; expected {', '.join(wanted) or 'no sizes'}")
    for name, value in sizes.items():
        if not 0.0 < value <= 1000.0:
            raise ValueError(f"{kind!r} with {name} = {value!r}; expected more than 0 and at most 1000 m")
    model: RcsModel = MODELS[kind](**sizes)
    return model


def _unit(vectors: Real) -> Real:
    """[N, 3] unit vectors; a zero vector stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0.0, length, 1.0)
