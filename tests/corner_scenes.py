"""Corners of metal faces as meshes and as rectangles of the slow reference, and the sum of their echoes."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from oracles import scattered_delays, specular_delays
from sionna_scenes import FREQUENCY_HZ, WAVELENGTH_M, every_one, everything, mesh, scene_of, slabs, view_with

from datafactory.paths.corner_echoes import CornerEchoes
from datafactory.paths.corners import CornerEdges, corners_of
from datafactory.paths.merged_scene import MergedScene
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import ScatteredPaths, SpecularPaths
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import SceneObject
from shared.radar.front_end import Polarization

Real = NDArray[np.float64]
Sight = Callable[[Real, Real], NDArray[np.bool_]]
LIGHT_MPS = 299_792_458.0
HERE = Pose((0.0, 0.0, 0.0))
NOWHERE = np.zeros(3)


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
    """Physical optics on a fine grid, the slow reference: U of both orders, exp(+j omega t), for a source of 1 at 1 m.

    The first face reflects as an endless plane does where a ray meets it: the TX is replaced by its mirror image, and a
    point of the second face is lit where the straight line from the image passes through the first face. The lit part
    of the second face sends the field on to the RX by Kirchhoff's integral,

        U = j / lambda int exp(-j k (r1 + r2)) / (r1 r2) (cos1 + cos2) / 2 dA,

    which an endless plane turns into exp(-j k L) / L. No expansion, no closed form; every face reflects with 1. The
    faces are perpendicular, or nearly so.
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


def dihedral(
    distance_m: float,
    across: float | tuple[float, float],
    along_m: float,
    turned_deg: float = 0.0,
    opening_deg: float = 90.0,
    middle_m: float = 0.0,
    tilt_deg: float = 0.0,
) -> list[Rectangle]:
    """Two faces that meet in an upright edge on the x axis and open towards the origin.

    :param across: reach of the faces from the edge [m]; :param along_m: length of the edge
    :param turned_deg: about the edge, away from symmetry to the x axis
    :param middle_m: height of the edge's middle over the origin
    :param tilt_deg: about the edge's middle, in the plane of edge and x axis
    """  # fmt: skip
    tilt = np.radians(tilt_deg)
    up, out = np.array([np.sin(tilt), 0.0, np.cos(tilt)]), np.array([-np.cos(tilt), 0.0, np.sin(tilt)])
    aside = np.array([0.0, 1.0, 0.0])
    foot = np.array([distance_m, 0.0, middle_m]) - 0.5 * along_m * up
    reach = (across, across) if isinstance(across, float) else across
    faces = []
    for side, length in zip((1.0, -1.0), reach, strict=True):
        angle = np.radians(side * 0.5 * opening_deg + turned_deg)
        faces.append(Rectangle(foot, along_m * up, length * (np.cos(angle) * out + np.sin(angle) * aside)))
    return faces


def meshes_of(faces: Sequence[Rectangle], cuts: int = 1, of: str = "metal", seed: int = 0) -> list[SceneObject]:
    """Each face as a mesh of 2 ``cuts``^2 triangles with joints at uneven places."""
    generator = np.random.default_rng(seed)
    objects = []
    for number, face in enumerate(faces):
        s, t = (np.sort(np.concatenate([[0.0, 1.0], generator.uniform(0.05, 0.95, cuts - 1)])) for _ in range(2))
        points = face.corner + s[:, None, None] * face.along + t[None, :, None] * face.into
        index = np.arange((cuts + 1) ** 2).reshape(cuts + 1, cuts + 1)
        a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
        triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
        objects.append(mesh(f"face-{number}", points.reshape(-1, 3), triangles, of))
    return objects


def corners_seen(of: MergedScene, pose: Pose = HERE) -> CornerEdges:
    return corners_of(of).seen_from(pose)


def echoes(
    of: MergedScene,
    pose: Pose = HERE,
    sight: Sight = everything,
    polarization: tuple[Polarization, Polarization] = ("V", "V"),
) -> tuple[ScatteredPaths, SpecularPaths, dict[str, int]]:
    """What the corners of a scene send back."""
    settings = TraceSettings(polarization=polarization)
    return every_one(CornerEchoes(view_with(slabs(of), sight, settings, corner_edges=corners_seen(of, pose))))


def received(paths: tuple[ScatteredPaths, SpecularPaths], tx: Real = NOWHERE, rx: Real = NOWHERE, time_s: float = 0.0):
    """The sum of the echoes at mid-sweep, exp(+j 2 pi f tau) as the IF signal has it."""
    scattered, specular = paths
    cycles = [FREQUENCY_HZ * scattered_delays(scattered, tx, rx, time_s)]
    if len(specular):
        cycles.append(FREQUENCY_HZ * specular_delays(specular, tx, rx, time_s))
    amplitude = np.concatenate([scattered.amplitude, specular.amplitude])
    return complex(amplitude @ np.exp(2j * np.pi * np.concatenate([*cycles, np.zeros(0)])[: len(amplitude)]))


def corner_echo(faces: Sequence[Rectangle], tx: Real = NOWHERE, rx: Real = NOWHERE) -> complex:
    """What the effect makes of these faces."""
    scattered, specular, _ = echoes(scene_of(*meshes_of(faces)))
    return received((scattered, specular), tx, rx)


def reference_echo(
    faces: Sequence[Rectangle], tx: Real = NOWHERE, rx: Real = NOWHERE, spacing_m: float = WAVELENGTH_M / 8.0
) -> complex:
    """What the slow reference makes of them, vertical polarisation on an upright metal edge: (-1)^2."""
    field = field_over_two_faces(faces, WAVELENGTH_M, tx, rx, spacing_m)
    return complex(np.conj(field)) * WAVELENGTH_M / (4.0 * np.pi)


def cross_section_dbsm(amplitude: complex, range_m: float) -> float:
    """What the radar equation says of an echo [dBsm], isotropic antennas and 1 W."""
    return float(10.0 * np.log10((4.0 * np.pi) ** 3 * range_m**4 * abs(amplitude) ** 2 / WAVELENGTH_M**2))


def level_db(one: complex, other: complex) -> float:
    return float(20.0 * np.log10(abs(one) / abs(other)))
