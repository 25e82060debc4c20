"""Write the test range and the tiny scene into this script's folder: ``.venv/bin/python scenes/make_scenes.py``.

Everything follows from the fixed seeds and the positions below: the same versions write the same bytes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from datafactory.scenes.city.shapes import Surface, box, cylinder
from datafactory.scenes.city.site import Placement
from datafactory.scenes.city.usd import write_usd
from shared.physics.units import power_to_db
from shared.radar.waveform import Waveform

RADAR_POSITION = (0.0, 0.0, 0.6)
"""Where the radar is meant to stand on the test range [m], looking along +x."""

RAYLEIGH_LENGTH_U = 0.0406
"""lambda / (span + spacing) of the full 48-element array, in u = sin(azimuth)."""


@dataclass(frozen=True)
class Reflector:
    """A trihedral corner reflector of the test range.

    :param name: prim name
    :param range_m: slant range from RADAR_POSITION [m]
    :param u: sin(azimuth), positive to the left
    :param edge_m: length of the three inner edges [m]
    :param velocity: world velocity [m/s]
    """

    name: str
    range_m: float
    u: float
    edge_m: float
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def position(self) -> tuple[float, float, float]:
        """World position [m]: at the radar's height, so that y = r u and x = r sqrt(1 - u^2)."""
        return self.range_m * math.sqrt(1.0 - self.u**2), self.range_m * self.u, RADAR_POSITION[2]

    @property
    def rcs_dbsm(self) -> float:
        """Peak RCS 4 pi a^4 / (3 lambda^2) at mid-sweep [dBsm]; holds for ranges beyond 2 a^2 / lambda."""
        return float(power_to_db(4.0 * math.pi * self.edge_m**4 / (3.0 * Waveform().wavelength_m ** 2)))


REFLECTORS = (
    Reflector("Pair_left", 5.7, RAYLEIGH_LENGTH_U, 0.1),
    Reflector("Pair_right", 5.7, -RAYLEIGH_LENGTH_U, 0.1),
    Reflector("Single_10m", 10.0, 0.0, 0.1),
    Reflector("Single_20m", 20.0, 0.5, 0.1),
    Reflector("Single_40m", 40.0, -0.5, 0.2),
    Reflector("Single_60m", 60.0, 0.2, 0.2),
    Reflector("Single_80m", 80.0, 0.0, 0.2),
    Reflector("Moving_30m", 30.0, -0.2, 0.2, (-5.0, 0.0, 0.0)),
)

CYLINDER_RANGE_M, CYLINDER_U = 5.7, -0.4
"""Horizontal range [m] and u of the metal cylinder's axis."""


def slab(lower: tuple[float, float], upper: tuple[float, float], material: str) -> Surface:
    """Ground between two corners (x, y) [m], 0.2 m thick, its top at z = 0."""
    return box((*lower, -0.2), (*upper, 0.0), material)


def reflector_range() -> list[Placement]:
    """120 x 60 m of asphalt, a concrete wall, trihedrals as point targets and a metal cylinder."""
    x = CYLINDER_RANGE_M * math.sqrt(1.0 - CYLINDER_U**2)
    post = (round(x, 4), round(CYLINDER_RANGE_M * CYLINDER_U, 4), 0.0)
    return [
        Placement("Ground/Asphalt", slab((-20.0, -30.0), (100.0, 30.0), "asphalt")),
        Placement("Wall", box((40.0, 12.0, 0.0), (40.3, 24.0, 4.0), "concrete")),
        Placement("Cylinder", cylinder(0.05, 0.0, 1.2, 32, "metal"), post),
        *(
            Placement(f"Reflectors/{item.name}", None, item.position, velocity=item.velocity, rcs_dbsm=item.rcs_dbsm)
            for item in REFLECTORS
        ),
    ]


def tiny() -> list[Placement]:
    """The least that has everything: ground, two walls, a parked and a moving car, a pole and a point target."""
    car = box((-2.2, -0.9, 0.25), (2.2, 0.9, 1.45), "metal")
    return [
        Placement("Ground/Road_0", slab((-20.0, -20.0), (60.0, 20.0), "asphalt")),
        Placement("Walls/Wall_0", box((-15.0, 8.0, 0.0), (50.0, 8.3, 6.0), "concrete")),
        Placement("Walls/Wall_1", box((-15.0, -9.3, 0.0), (50.0, -9.0, 5.0), "brick")),
        Placement("Cars/Car_0", car, (12.0, -4.4, 0.0)),
        Placement("Cars/Car_1", car, (25.0, 1.8, 0.0), velocity=(-8.0, 0.0, 0.0)),
        Placement("Poles/Pole_0", cylinder(0.08, 0.0, 5.0, 12, "metal"), (9.0, 5.5, 0.0)),
        Placement("People/Pedestrian_0", None, (18.0, -6.5, 1.1), velocity=(1.3, 0.0, 0.0), rcs_dbsm=-1.4),
    ]


def write_scenes(folder: Path) -> None:
    """Write both into an existing folder."""
    write_usd(
        folder / "test_range.usda", reflector_range(), "Test range; the radar stands at (0, 0, 0.6), looking along x."
    )
    write_usd(folder / "tiny.usda", tiny(), "A tiny scene for smoke tests.")


if __name__ == "__main__":
    write_scenes(Path(__file__).resolve().parent)
