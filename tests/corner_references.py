"""Corners by physical optics on a fine grid: the slow reference for :mod:`datafactory.paths.corner_echoes`.

The first face reflects as an endless plane does where a ray meets it: the TX is replaced by its mirror image, and a
point of the second face is lit where the straight line from the image passes through the first face. The lit part of
the second face sends the field on to the RX by Kirchhoff's integral,

    U = j / lambda int exp(-j k (r1 + r2)) / (r1 r2) (cos1 + cos2) / 2 dA,

which an endless plane turns into exp(-j k L) / L. Both orders are added. No expansion, no closed form, metal faces.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]

ROWS = 256
"""Of the grid that are held in memory at a time."""


@dataclass(frozen=True)
class Rectangle:
    """A face: ``corner`` + s ``along`` + t ``into``, s and t from 0 to 1, [3] each [m]."""

    corner: Real
    along: Real
    into: Real

    @property
    def normal(self) -> Real:
        normal = np.cross(self.along, self.into)
        return normal / np.linalg.norm(normal)

    def holds(self, point: Real) -> NDArray[np.bool_]:
        """[...] whether points of its plane lie in it."""
        s = (point - self.corner) @ self.along / (self.along @ self.along)
        t = (point - self.corner) @ self.into / (self.into @ self.into)
        return (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)

    def grid(self, spacing_m: float) -> Iterable[tuple[Real, float]]:
        """Middles of its cells [n, 3] and their area [m^2], some rows at a time."""
        rows, columns = (int(np.ceil(np.linalg.norm(side) / spacing_m)) for side in (self.along, self.into))
        area = float(np.linalg.norm(np.cross(self.along, self.into))) / (rows * columns)
        t = (np.arange(columns) + 0.5) / columns
        for first in range(0, rows, ROWS):
            s = (np.arange(first, min(first + ROWS, rows)) + 0.5) / rows
            points = self.corner + s[:, None, None] * self.along + t[None, :, None] * self.into
            yield points.reshape(-1, 3), area


def field_over_two_faces(
    faces: Sequence[Rectangle], wavelength_m: float, tx: Real, rx: Real, spacing_m: float
) -> complex:
    """U of both orders, exp(+j omega t), for a source of 1 at 1 m; every face reflects with 1.

    The faces are perpendicular, or nearly so.
    """
    return sum(_one_order(first, second, wavelength_m, tx, rx, spacing_m) for first, second in (faces, faces[::-1]))


def _one_order(
    first: Rectangle, second: Rectangle, wavelength_m: float, tx: Real, rx: Real, spacing_m: float
) -> complex:
    height = float((tx - first.corner) @ first.normal)
    image = tx - 2.0 * height * first.normal
    wavenumber, total = 2.0 * np.pi / wavelength_m, 0.0j
    for points, area in second.grid(spacing_m):
        before, after = points - image, points - rx
        r1, r2 = np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = -height * np.sign(height) / (np.sign(height) * (before @ first.normal))
            met = image - share[:, None] * before
            lit = first.holds(met) & (np.abs(share) <= 1.0)
        cosine = 0.5 * (np.abs(before @ second.normal) / r1 + np.abs(after @ second.normal) / r2)
        wave = np.exp(-1j * wavenumber * (r1 + r2)) / (r1 * r2) * cosine
        total += complex(wave[lit].sum()) * area
    return 1j * total / wavelength_m
