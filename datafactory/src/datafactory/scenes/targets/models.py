"""Models of targets by their radar cross section: echo points and their strengths, seen from one position.

A model has its own frame, x forward, y left, z up, metres. It takes the radar's position in that frame and returns echo
points. Their phases follow from their positions. Nothing in them is random but where in its cycle a moving part is.
Road users, cars, pedestrians and cyclists, stand on the ground at the origin of their frame; beside them there are the
bodies of :mod:`datafactory.scenes.targets.bodies`.

Levels are those of 3GPP TR 38.901 (Release 19), clause 7.9.2, with its random component at its linear mean of 1; the
cyclist is Belgiovane and Chen (2016). Both were found by measurement, without regard to distance.

Options, off unless a scene states them, add parts that move against the body: wheels of a car or a bicycle, and the
limbs of a pedestrian (:mod:`datafactory.scenes.targets.walking`).

A rolling wheel is echo points on its rim, from rest at the ground to twice the vehicle's speed at the top. A wheel of
radius r that rolls without slip turns by v / r [rad/s]. A point on it at the angle alpha from the top, forward, is at

    x = r sin(alpha),  z = r cos(alpha),   alpha = alpha_0 + v t / r,

about the hub. It moves along x at v (1 + cos(alpha)) over the ground: 0 where it touches the ground, 2 v at the top.
The mean is v (Chen, The Micro-Doppler Effect in Radar, 2nd ed., 2019, chapter 3, on rigid bodies that turn).

The points' angles are drawn once, from the target's seed, and stay: at any time it is the same wheel. The level is one
number for a wheel, an assumption: -10 dBsm for a car's (21 dB below a car's mean), a quarter of a cyclist's total for a
bicycle's.

Limits. A point's velocity is constant within a frame (:mod:`datafactory.scenes.targets.bodies`), though it turns
by 26 deg in 10.3 ms at 14 m/s: docs/notes/targets.md says what that leaves out. The ``POINTS`` of a wheel stand 15
deg apart on average: the spectrum of all is filled as it should be, from 0 to 2 v, and its fine structure is not
right. Spokes and discs are left out, which fill the spectrum's middle. Of a car's wheels those on the side that the
radar sees echo; of a car seen from ahead or behind those of the nearer axle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from typing import ClassVar

import numpy as np

from datafactory.scenes.targets import bodies
from datafactory.scenes.targets.bodies import Extent, Motion, MovingParts, RcsModel, Real
from datafactory.scenes.targets.walking import FASTEST_RV, leg_m, parts_of_walker
from shared.physics.units import db_to_power
from shared.physics.vectors import unit

WHEEL_RADII_M = (0.1, 1.0)
STATURES_M = (0.5, 2.5)
"""Bounds of the options [m]."""
POINTS = 24
"""Echo points of a wheel."""


def option(low: float, high: float) -> float | None:
    """A field that may be left out, which turns the option off; else within these bounds, both included."""
    value: float | None = field(default=None, metadata={"bounds": (low, high)})
    return value


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


@dataclass(frozen=True, repr=False)
class Car(RcsModel):
    """A passenger car of 5.0 x 2.0 x 1.6 m (TR 37.885, type 2): five scattering points, one a face.

    At the lobes' centres the points' sum is 15.5 dBsm in front, 20.8 at either side, 14.6 behind, and over the sphere
    without the roof 11.4 (TR 38.901 states a mean of 11.25 dBsm). The front lobe looks up by 18 deg: at the height of a
    bumper the front shows 11.7 dBsm.

    :param wheel_radius_m: its wheels turn, as above
    :param wheel_hidden_below_m: what is lower than this of a wheel is not seen
    """

    wheel_radius_m: float | None = option(*WHEEL_RADII_M)
    wheel_hidden_below_m: float | None = option(0.0, 1.0)

    LOBES: ClassVar[tuple[_Lobe, ...]] = (
        _Lobe((0.0, 1.0, 0.8), 90.0, 26.90, 79.70, 44.42, 20.60, 20.52),
        _Lobe((-2.5, 0.0, 0.8), 180.0, 36.32, 79.65, 36.73, 13.90, 13.82),
        _Lobe((0.0, -1.0, 0.8), 270.0, 26.90, 79.70, 44.42, 20.60, 20.52),
        _Lobe((2.5, 0.0, 0.8), 0.0, 40.54, 71.75, 29.13, 14.99, 14.91),
        _Lobe((0.0, 0.0, 1.6), None, 360.0, 0.0, 18.13, 21.12, 21.05),
    )
    HUBS: ClassVar[tuple[tuple[float, float], ...]] = ((1.45, 0.85), (1.45, -0.85), (-1.45, 0.85), (-1.45, -0.85))
    WHEEL_DBSM: ClassVar[float] = -10.0
    HALF_WIDTH_M: ClassVar[float] = 1.0
    extent_m: ClassVar[Extent] = (-2.5, -1.0, 0.0), (2.5, 1.0, 1.6)
    footprint_m: ClassVar[float] = 2.7
    cross_polar_ratio_db: ClassVar[float] = 21.12
    nominal_rcs_dbsm: ClassVar[float] = 11.25

    def echoes(self, radar: Real, wavelength_m: float) -> tuple[Real, Real]:
        points = np.array([lobe.position for lobe in self.LOBES])
        directions = unit(radar - points)
        levels = [lobe.rcs_dbsm(direction) for lobe, direction in zip(self.LOBES, directions, strict=True)]
        return points, db_to_power(levels)

    def parts(self, radar: Real, motion: Motion) -> MovingParts:
        """The rims of four wheels; those on the far side are silent."""
        if self.wheel_radius_m is None:
            return MovingParts.none()
        hubs = np.array([(x, y, self.wheel_radius_m) for x, y in self.HUBS])
        beside = abs(radar[1]) > self.HALF_WIDTH_M
        facing = hubs[:, 1] * radar[1] > 0.0 if beside else hubs[:, 0] * radar[0] > 0.0
        level = np.where(facing, float(db_to_power(self.WHEEL_DBSM)), 0.0)
        return rolling_wheels(hubs, self.wheel_radius_m, level, motion, self.wheel_hidden_below_m or 0.0)


@dataclass(frozen=True, repr=False)
class Pedestrian(RcsModel):
    """A human (TR 38.901, Table 7.9.2.1-1): one point at half of 1.75 m, the same -1.37 dBsm from everywhere.

    :param stature_m: the human walks with limbs that move, see :mod:`datafactory.scenes.targets.walking`: 16 points
        that have the same level together
    :param gait_phase: in the cycle of two steps at time 0, the right heel striking at 0; drawn from the seed where
        it is not stated
    """

    stature_m: float | None = option(*STATURES_M)
    gait_phase: float | None = option(0.0, 1.0)

    footprint_m: ClassVar[float] = 0.4
    cross_polar_ratio_db: ClassVar[float] = 19.81
    nominal_rcs_dbsm: ClassVar[float] = -1.37
    STATURE_M: ClassVar[float] = 1.75

    @property
    def extent_m(self) -> Extent:
        """0.5 m along and across, as TR 38.901 (Release 19) has an adult, and its stature."""
        return (-0.25, -0.25, 0.0), (0.25, 0.25, self.stature_m or self.STATURE_M)

    def echoes(self, radar: Real, wavelength_m: float) -> tuple[Real, Real]:
        if self.stature_m is not None:
            return np.zeros((0, 3)), np.zeros(0)
        return np.array([[0.0, 0.0, 0.875]]), db_to_power([self.nominal_rcs_dbsm])

    def parts(self, radar: Real, motion: Motion) -> MovingParts:
        """Head, torso and limbs."""
        if self.stature_m is None:
            return MovingParts.none()
        start = self.gait_phase
        if start is None:
            start = float(np.random.default_rng(motion.seed).random())
        return parts_of_walker(radar, motion, self.stature_m, float(db_to_power(self.nominal_rcs_dbsm)), start)

    def unfit(self, forward_mps: float) -> str:
        """A walker has a largest speed."""
        if self.stature_m is None or abs(forward_mps) <= FASTEST_RV * leg_m(self.stature_m):
            return ""
        most = FASTEST_RV * leg_m(self.stature_m)
        return f"a walker of {self.stature_m:g} m at {forward_mps:g} m/s; expected at most {most:.3g} m/s"


@dataclass(frozen=True, repr=False)
class Cyclist(RcsModel):
    """A cyclist: rider and two wheels, -8 dBsm together from the side, -13 dBsm from ahead and behind.

    The two levels are the ends of the span that Belgiovane and Chen ("Bicycles and human riders backscattering at 77
    GHz for automotive radar", EuCAP 2016) measured. Which aspect has which, sigma = -8 dBsm sin^2 + -13 dBsm cos^2 of
    the azimuth between them, half of it from the rider and a quarter from either wheel, and the human's
    depolarisation are assumptions.

    :param wheel_radius_m: the wheels turn, as above
    """

    wheel_radius_m: float | None = option(*WHEEL_RADII_M)

    SIDE_DBSM: ClassVar[float] = -8.0
    END_DBSM: ClassVar[float] = -13.0
    POINTS: ClassVar[tuple[tuple[float, float, float], ...]] = ((0.0, 0.0, 1.1), (0.55, 0.0, 0.35), (-0.55, 0.0, 0.35))
    footprint_m: ClassVar[float] = 0.9
    extent_m: ClassVar[Extent] = (-0.9, -0.3, 0.0), (0.9, 0.3, 1.75)  # an assumption: the wheels' rims, a handlebar
    cross_polar_ratio_db: ClassVar[float] = 19.81
    nominal_rcs_dbsm: ClassVar[float] = -9.8  # the mean over azimuth

    def echoes(self, radar: Real, wavelength_m: float) -> tuple[Real, Real]:
        fixed = slice(None) if self.wheel_radius_m is None else slice(1)
        return np.array(self.POINTS)[fixed], self._levels(radar)[fixed]

    def parts(self, radar: Real, motion: Motion) -> MovingParts:
        """The rims of both wheels, with the levels of the points that they replace."""
        if self.wheel_radius_m is None:
            return MovingParts.none()
        hubs = np.array([(x, y, self.wheel_radius_m) for x, y, _ in self.POINTS[1:]])
        return rolling_wheels(hubs, self.wheel_radius_m, self._levels(radar)[1:], motion)

    def _levels(self, radar: Real) -> Real:
        """[3] cross sections of rider and wheels [m^2]."""
        x, y, _ = unit(radar - np.array(self.POINTS)).T
        across = np.hypot(x, y)
        sine_squared = np.where(across > 0.0, y**2 / np.where(across > 0.0, across, 1.0) ** 2, 0.5)
        whole = db_to_power(self.SIDE_DBSM) * sine_squared + db_to_power(self.END_DBSM) * (1.0 - sine_squared)
        return whole * np.array([0.5, 0.25, 0.25])


def rolling_wheels(
    hubs: Real, radius_m: float, rcs_m2: Real, motion: Motion, hidden_below_m: float = 0.0
) -> MovingParts:
    """The rims of wheels whose axles lie along y.

    :param hubs: [H, 3] places of the hubs in the vehicle's frame [m]
    :param rcs_m2: [H] cross section of each wheel, all of its points together [m^2]
    :param hidden_below_m: points lower than this over the foot of the wheel are silent, as behind a kerb [m]
    """
    start = np.random.default_rng(motion.seed).uniform(0.0, 2.0 * np.pi, (len(hubs), POINTS))
    angle = start + motion.forward_mps * motion.time_s / radius_m
    sine, cosine = np.sin(angle), np.cos(angle)
    zero = np.zeros_like(angle)
    offset = radius_m * np.stack([sine, zero, cosine], axis=2)
    velocity = motion.forward_mps * np.stack([cosine, zero, -sine], axis=2)
    level = np.where(radius_m * (1.0 + cosine) < hidden_below_m, 0.0, np.asarray(rcs_m2)[:, None] / POINTS)
    return MovingParts((hubs[:, None] + offset).reshape(-1, 3), velocity.reshape(-1, 3), level.reshape(-1))


MODELS: dict[str, type] = {
    "car": Car, "pedestrian": Pedestrian, "cyclist": Cyclist,
    "sphere": bodies.Sphere, "cylinder": bodies.Cylinder, "plate": bodies.Plate, "dihedral": bodies.Dihedral,
    "trihedral": bodies.Trihedral,
}  # fmt: skip
"""Every model by its name in a scene."""

ROAD_USERS = ("car", "pedestrian", "cyclist")
"""Models without sizes: a prim's name alone selects them."""


def sizes_of(kind: str) -> tuple[str, ...]:
    """Names of the sizes [m] that a model needs, e.g. ``("radius_m", "length_m")``."""
    return tuple(item.name for item in fields(MODELS[kind]) if item.default is MISSING)


def options_of(kind: str) -> dict[str, Field]:
    """The fields that a model can do without, by name, e.g. ``wheel_radius_m``."""
    return {item.name: item for item in fields(MODELS[kind]) if item.default is not MISSING}


SIZES = tuple(sorted({name for kind in MODELS for name in sizes_of(kind)}))
OPTIONS = tuple(sorted({name for kind in MODELS for name in options_of(kind)}))


def target_model(kind: str, sizes: Mapping[str, float]) -> RcsModel:
    """The model of this name with these sizes [m] and options.

    :raises ValueError: an unknown name, a size too many or too few, a size that is not above 0 and at most 1000 m, or
        an option outside its bounds
    """
    if kind not in MODELS:
        raise ValueError(f"{kind!r}; expected one of {', '.join(MODELS)}")
    wanted, options = sizes_of(kind), options_of(kind)
    if set(sizes) - options.keys() != set(wanted):
        expected = ", ".join(wanted) or "no sizes"
        more = f", or options {', '.join(options)}" if options else ""
        raise ValueError(f"{kind!r} with {', '.join(sizes) or 'no sizes'}; expected {expected}{more}")
    for name, value in sizes.items():
        if name in options:
            low, high = options[name].metadata["bounds"]
            if not low <= value <= high:
                raise ValueError(f"{kind!r} with {name} = {value!r}; expected {low:g} to {high:g}")
        elif not 0.0 < value <= 1000.0:
            raise ValueError(f"{kind!r} with {name} = {value!r}; expected more than 0 and at most 1000 m")
    model: RcsModel = MODELS[kind](**sizes)
    return model
