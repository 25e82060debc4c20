"""What every model of a target offers, and the part of it that rigid ones have in common.

A frame's paths have constant velocities (:mod:`datafactory.paths.table`). Those of parts that move against the body
are theirs at the frame's start. Acceleration a then makes an error of a T^2 / 2 in place and a T in velocity by the end
of a frame of T seconds.
"""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Extent = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Lower and upper corner of a box in the target's frame [m]."""


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

    @property
    def extent_m(self) -> Extent:
        """The box that the target fills."""

    def far_field_m(self, wavelength_m: float) -> float:
        """Distance [m] from which on the model holds."""

    def echoes(self, radar: Real, wavelength_m: float) -> tuple[Real, Real]:
        """Echo points [N, 3] [m] in the target's frame and their cross sections [N] [m^2]: those fixed to the body.

        :param radar: [3] where the radar stands in the target's frame [m], not at an echo point
        """

    def parts(self, radar: Real, motion: Motion) -> MovingParts:
        """Echo points that move against the body; as many from everywhere, at any time.

        :param radar: as in ``echoes``
        """

    def unfit(self, forward_mps: float) -> str:
        """Why the model cannot move at this speed, in words; "" where it can."""


class Rigid:
    """A model without moving parts."""

    def parts(self, radar: Real, motion: Motion) -> MovingParts:
        """None."""
        return MovingParts.none()

    def unfit(self, forward_mps: float) -> str:
        """Fit for every speed."""
        return ""


def text_without_defaults(model: object) -> str:
    """``Car(wheel_radius_m=0.3)``: a dataclass's text, without the fields that have their defaults.

    Scenes are hashed by the texts of their targets: an option that a model gains later changes no hash.
    """
    assert is_dataclass(model)
    stated = [
        f"{item.name}={getattr(model, item.name)!r}"
        for item in fields(model)
        if item.default is MISSING or getattr(model, item.name) != item.default
    ]
    return f"{type(model).__name__}({', '.join(stated)})"


def unit(vectors: Real) -> Real:
    """[N, 3] unit vectors; a zero vector stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0.0, length, 1.0)
