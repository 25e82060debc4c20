"""What "error" means in every table here: amplitude ratios, and their levels in dB, finite, with a floor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from shared.physics.units import amplitude_to_db

FLOOR_DB = -200.0
WORDS = {"cube_db": "cube", "image_db": "image", "power_db": "power in a cell"}


def level_db(ratio: float) -> float:
    """An amplitude ratio in dB, not below FLOOR_DB."""
    return float(amplitude_to_db(ratio, FLOOR_DB))


def worst_db(ratios: Sequence[float]) -> float | None:
    """The largest of amplitude ratios in dB; None where nothing was measured."""
    return level_db(max(ratios)) if ratios else None


def relative_l2(value: NDArray, reference: NDArray) -> float:
    """|value - reference| / |reference| over all elements; 0 where both are empty of signal, 1 where only one is."""
    scale = float(np.linalg.norm(reference))
    difference = float(np.linalg.norm(value - reference))
    return difference / scale if scale > 0.0 else float(difference > 0.0)


def peak_error(value: NDArray, reference: NDArray) -> float:
    """Largest difference over the reference's peak magnitude."""
    peak = float(np.abs(reference).max(initial=0.0))
    difference = float(np.abs(value - reference).max(initial=0.0))
    return difference / peak if peak > 0.0 else float(difference > 0.0)


class Errors(BaseModel):
    """The three errors [dB], the largest over the frames, to 0.1 dB so that the last bits of a sum do not decide.

    None of cube and image where only paths are made.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    cube_db: float | None
    image_db: float | None
    power_db: float

    @staticmethod
    def of(cube: Sequence[float], image: Sequence[float], power: Sequence[float]) -> Errors:
        """The largest of amplitude ratios; none of a cube or image that is not made."""
        levels = [None if level is None else round(level, 1) for level in map(worst_db, (cube, image, power))]
        return Errors.model_validate(dict(zip(WORDS, levels, strict=True)))

    def measured(self) -> dict[str, float]:
        """Name and level of those that there are."""
        return {name: value for name, value in self.model_dump().items() if value is not None}

    def excess_db(self, budget_db: float) -> tuple[float, ...]:
        """By how much each exceeds a budget, 0 where it does not, the largest first."""
        return tuple(sorted((max(value - budget_db, 0.0) for value in self.measured().values()), reverse=True))

    @property
    def worst_db(self) -> float:
        return max(self.measured().values())

    def __str__(self) -> str:
        return ", ".join(f"{WORDS[name]} {value:.1f}" for name, value in self.measured().items()) + " dB"


def worst_of(frames: Sequence[Errors]) -> Errors:
    """The largest of each error; all have the same ones."""
    every = [errors.measured() for errors in frames]
    largest = {name: max(errors[name] for errors in every) for name in every[0]}
    return Errors.model_validate(dict.fromkeys(WORDS) | largest)
