"""Directions of the rays: over the radar's field of view, as dense as its resolution cells.

The lattice covers the front half space. Four fifths of its rays are uniform in u = sin(azimuth), as the image's cells
are. The rest are uniform in azimuth, which bounds the solid angle that one ray represents. The sine of elevation z has
the density of a Cauchy distribution cut at the poles, about as wide as a car radar's beam:

    p(azimuth) = 0.8 cos(azimuth) / 2 + 0.2 / pi,        p(z) = z_0 / (2 atan(1 / z_0) (z_0^2 + z^2)),   -1 <= z <= 1.

A scene may ask for more rays at some elevations and fewer at others (:mod:`datafactory.paths.aim`): p(z) is then times
a factor for each of B strips of z that hold the same share of the beam, of mean 1.

Each direction represents a solid angle of 1 / (N p(azimuth) p(z)). Diffuse amplitudes are scaled by the square root of
its ratio to the full sphere's 4 pi / N, so that their expected power is that of a lattice over the sphere.

The points come from the Kronecker sequence of the golden ratio, of which the Fibonacci lattice is made. A random offset
per frame rotates them (Cranley-Patterson), so that neighbouring frames have different artefacts.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from shared.physics.compiled import compiled, inlined
from shared.physics.cycles import phasor
from shared.physics.vectors import Real, lengths

BEAM = 0.07
"""z_0. Among 0.0125 to 0.2, 0.05 reaches the most ground cells within 30 m with five rays (docs/notes/speckle.md). It
errs by 0.13 dB on a plane right below an isotropic antenna with 20 000 rays; this one by 0.09 dB, and by 0.003 dB with
the rays of the default. What there is too much near the sensor costs no path (:mod:`datafactory.paths.cells`).
"""
UNIFORM_IN_U = 0.8
GOLDEN_RATIO = (1.0 + np.sqrt(5.0)) / 2.0


@dataclass(frozen=True)
class RayFan:
    """Directions of the first segment, in the radar frame.

    :param count: number of rays
    :param offset: [2] shift of the lattice in its unit square, per frame
    :param beam: z_0 of the density
    :param strips: factors on p(z) of B strips, from straight down to straight up, of mean 1; none: 1 everywhere
    """

    aimable: ClassVar[bool] = True
    """Whether the rays may be sent where the scene calls for them. Lattices that are held against this one may not."""

    count: int
    offset: tuple[float, float] = (0.0, 0.0)
    beam: float = BEAM
    strips: tuple[float, ...] = ()

    def unit_square(self) -> Real:
        """[count, 2] the points that Mitsuba's ``square_to_uniform_sphere`` turns into these directions.

        That map takes (a, b) to azimuth 2 pi a and z = 1 - 2 b.
        """
        index = np.arange(self.count)
        across = _fraction(index / GOLDEN_RATIO + self.offset[0])
        up = _fraction((index + 0.5) / self.count + self.offset[1])
        azimuth = _azimuth_at(across)
        if self.strips:
            reached = np.concatenate([[0.0], np.cumsum(self.strips)])
            up = np.interp(up, reached / reached[-1], np.arange(len(reached)) / len(self.strips))
        z = self.beam * np.tan((2.0 * up - 1.0) * np.arctan(1.0 / self.beam))
        return np.stack([_fraction(azimuth / (2.0 * np.pi)), np.clip(0.5 * (1.0 - z), 0.0, 1.0)], axis=1)

    def directions(self) -> Real:
        """[count, 3] unit directions, in the lattice's order."""
        across, up = self.unit_square().T
        azimuth, z, level = 2.0 * np.pi * across, 1.0 - 2.0 * up, 2.0 * np.sqrt(up * (1.0 - up))
        return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), z], axis=1)

    def solid_angle_ratio(self, directions: Real) -> Real:
        """[K] solid angle that a ray in these directions [K, 3] represents, over the full lattice's 4 pi / count."""
        z = directions[:, 2] / lengths(directions)
        cosine = np.maximum(directions[:, 0], 0.0) / np.maximum(np.hypot(directions[:, 0], directions[:, 1]), 1e-30)
        return 1.0 / (4.0 * np.pi * _azimuth_density(cosine) * self.elevation_density(z))

    def elevation_density(self, z: Real) -> Real:
        """[K] p(z) at sines of elevation [K]."""
        half_angle = np.arctan(1.0 / self.beam)
        density = self.beam / (2.0 * half_angle * (self.beam**2 + z**2))
        if self.strips:
            share = 0.5 + np.arctan(z / self.beam) / (2.0 * half_angle)
            strip = np.clip((share * len(self.strips)).astype(np.int64), 0, len(self.strips) - 1)
            density *= np.asarray(self.strips)[strip]
        return density


def _fraction(value: Real) -> Real:
    """[N] what is left of the next lower whole number: ``value % 1.0`` at a thirtieth of its time."""
    return value - np.floor(value)


def _azimuth_density(cosine: Real) -> Real:
    return UNIFORM_IN_U * 0.5 * cosine + (1.0 - UNIFORM_IN_U) / np.pi


def _azimuth_at(share: Real) -> Real:
    """[N] azimuth below which ``share`` [N] of the rays lie, by Newton's method: the law rises everywhere.

    From a table's straight lines, 1.2e-5 rad off at most, two steps end at rounding.
    """
    return _azimuths(share, _azimuth_table())


@compiled(error_model="numpy")
def _azimuths(share, table):
    azimuth = np.empty(len(share))
    steps = len(table) - 1
    for k in range(len(share)):
        place = share[k] * steps
        left = min(int(place), steps - 1)
        azimuth[k] = table[left] + (place - left) * (table[left + 1] - table[left])
    for k in range(len(share)):  # a loop of its own, which is vectorised
        azimuth[k] = _newtons(_newtons(azimuth[k], share[k]), share[k])
    return azimuth


@inlined(error_model="numpy")
def _newtons(azimuth, share):
    """An azimuth after one of Newton's steps."""
    cosine, sine = phasor(azimuth / (2.0 * np.pi))
    below = UNIFORM_IN_U * 0.5 * (sine + 1.0) + (1.0 - UNIFORM_IN_U) * (azimuth / np.pi + 0.5)
    moved = azimuth - (below - share) / (UNIFORM_IN_U * 0.5 * cosine + (1.0 - UNIFORM_IN_U) / np.pi)
    return min(max(moved, -0.5 * np.pi), 0.5 * np.pi)


def _share_below(azimuth: Real) -> Real:
    return UNIFORM_IN_U * 0.5 * (np.sin(azimuth) + 1.0) + (1.0 - UNIFORM_IN_U) * (azimuth / np.pi + 0.5)


@lru_cache(maxsize=1)
def _azimuth_table() -> Real:
    """Azimuths at evenly spaced shares, 0 and 1 among them."""
    azimuth = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 2**15)
    return np.interp(np.linspace(0.0, 1.0, 2**12 + 1), _share_below(azimuth), azimuth)
