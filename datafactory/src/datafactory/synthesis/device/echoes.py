"""Paths on the device and the lengths of their legs, float64: what eq. (2) needs of them at any time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64
from torch import Tensor

from datafactory.paths.table import ScatteredPaths
from datafactory.synthesis.device.arrays import moved


@dataclass(frozen=True)
class Instant:
    """Paths at some times.

    :param tx_point, rx_point: as the TX and the RX see them [m]
    :param between: length between [m]
    """

    tx_point: Float64[Tensor, "paths times 3"]
    rx_point: Float64[Tensor, "paths times 3"]
    between: Float64[Tensor, "paths times"]


@dataclass(frozen=True)
class Echoes:
    """Scattered paths on the device; fields as those of :class:`datafactory.paths.table.ScatteredPaths`."""

    tx_point: Float64[Tensor, "paths 3"]
    rx_point: Float64[Tensor, "paths 3"]
    tx_velocity: Float64[Tensor, "paths 3"]
    rx_velocity: Float64[Tensor, "paths 3"]
    between_m: Float64[Tensor, " paths"]
    between_rate_mps: Float64[Tensor, " paths"]
    amplitude: Complex128[Tensor, " paths"]

    @staticmethod
    def of(paths: ScatteredPaths, device: str) -> Echoes:
        """The paths of a table on the device."""
        return Echoes(**{name: moved(getattr(paths, name), device) for name in Echoes.__dataclass_fields__})

    def __len__(self) -> int:
        return len(self.amplitude)

    def take(self, some: slice) -> Echoes:
        """Some of the paths."""
        return Echoes(**{name: getattr(self, name)[some] for name in self.__dataclass_fields__})

    def at(self, times: Float64[Tensor, " times"]) -> Instant:
        """The paths at these times [s]."""
        apart = times[:, None]
        return Instant(
            self.tx_point[:, None] + self.tx_velocity[:, None] * apart,
            self.rx_point[:, None] + self.rx_velocity[:, None] * apart,
            self.between_m[:, None] + self.between_rate_mps[:, None] * times,
        )


def distances(
    points: Float64[Tensor, "paths times 3"], elements: Float64[np.ndarray, "elements 3"]
) -> Float64[Tensor, "paths times elements"]:
    """Lengths of the legs between points and elements [m]."""
    place = moved(elements, str(points.device))
    squares = (points[..., 0, None] - place[:, 0]) ** 2
    for axis in (1, 2):
        squares += (points[..., axis, None] - place[:, axis]) ** 2
    return squares.sqrt_()
