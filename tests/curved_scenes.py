"""Round bodies as meshes with vertices on the true surface, what a trace finds of them, and closed forms."""

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import fresnel
from sionna_scenes import FREQUENCY_HZ, WAVELENGTH_M, mesh, scene_of, slab_reflection
from sionna_scenes import traced as trace_of

from datafactory.paths.table import PathTable
from datafactory.scenes.scene import SceneObject

Real = NDArray[np.float64]
Mesh = tuple[Real, NDArray[np.int32]]


def grid(points: Real, around: bool = False) -> Mesh:
    """Quads between the rows [n, m, 3] of a grid, each as two triangles; ``around`` joins the last column to the first.

    Triangles of no area, as at a pole, are left out.
    """
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    if around:
        index = np.concatenate([index, index[:, :1]], axis=1)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    triangles = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    vertices = points.reshape(-1, 3)
    corner = vertices[triangles]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    return vertices, triangles[area > 1e-12 * np.ptp(vertices) ** 2].astype(np.int32)


def joined(*parts: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    triangles = np.concatenate([t + s for (_, t), s in zip(parts, starts, strict=False)])
    return np.concatenate([vertices for vertices, _ in parts]), triangles.astype(np.int32)


def sphere(radius: float, segments: int) -> Mesh:
    """``segments`` meridians and half as many rings."""
    return ellipsoid((radius, radius, radius), segments)


def ellipsoid(radii: tuple[float, float, float], segments: int) -> Mesh:
    """A stretched sphere of ``segments`` meridians and half as many rings."""
    longitude = 2.0 * np.pi * np.arange(segments) / segments
    latitude = np.linspace(-0.5 * np.pi, 0.5 * np.pi, max(segments // 2, 3) + 1)
    level, turn = np.meshgrid(latitude, longitude, indexing="ij")
    unit = np.stack([np.cos(level) * np.cos(turn), np.cos(level) * np.sin(turn), np.sin(level)], axis=-1)
    unit[0, :, :2] = unit[-1, :, :2] = 0.0
    return grid(unit * np.array(radii), around=True)


def icosphere(radius: float, subdivisions: int) -> Mesh:
    solid = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return np.asarray(solid.vertices, dtype=float), np.asarray(solid.faces, dtype=np.int32)


def tube(
    radius: float, length: float, segments: int, rings: int = 1, start: float = 0.0, turn: float = 2.0 * np.pi
) -> Mesh:
    """A piece of an open cylinder about z, centred, from the angle ``start`` over ``turn`` [rad] in ``segments``."""
    whole = np.isclose(turn, 2.0 * np.pi)
    angle = start + turn * np.arange(segments if whole else segments + 1) / segments
    height = length * (np.arange(rings + 1) / rings - 0.5)
    z, phi = np.meshgrid(height, angle, indexing="ij")
    return grid(np.stack([radius * np.cos(phi), radius * np.sin(phi), z], axis=-1), around=bool(whole))


def cylinder(radius: float, length: float, segments: int, rings: int = 1) -> Mesh:
    """A closed cylinder about z with flat ends, whose rims are sharp."""
    lids = []
    for side in (-1.0, 1.0):
        angle = side * 2.0 * np.pi * np.arange(segments) / segments
        ring = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(segments, side * 0.5 * length)], -1)
        i = np.arange(segments)
        fan = np.stack([np.full(segments, segments), i, (i + 1) % segments], axis=1)
        lids.append((np.concatenate([ring, [[0.0, 0.0, side * 0.5 * length]]]), fan.astype(np.int32)))
    return joined(tube(radius, length, segments, rings), *lids)


def capsule(radius: float, length: float, segments: int) -> Mesh:
    """A tube of ``length`` with half a sphere on each end."""
    arc = np.linspace(0.0, 0.5 * np.pi, max(segments // 4, 2) + 1)
    latitude = np.concatenate([-arc[::-1], arc])
    middle = np.concatenate([np.full(len(arc), -0.5 * length), np.full(len(arc), 0.5 * length)])
    turn = 2.0 * np.pi * np.arange(segments) / segments
    level, phi = np.meshgrid(latitude, turn, indexing="ij")
    points = np.stack([np.cos(level) * np.cos(phi), np.cos(level) * np.sin(phi), np.sin(level)], axis=-1) * radius
    points[0, :, :2] = points[-1, :, :2] = 0.0
    points[..., 2] += middle[:, None]
    return grid(points, around=True)


def rounded_box(half: tuple[float, float, float], radius: float, steps: int) -> Mesh:
    """A box of half sides ``half`` whose faces are joined by quarter cylinders and eighths of spheres of ``radius``.

    :param steps: facets of a quarter circle
    """
    arc = 0.5 * np.pi * np.arange(steps + 1) / steps
    turn = np.concatenate([arc + 0.5 * np.pi * quarter for quarter in range(4)])
    side = np.repeat(np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]), steps + 1, axis=0)
    level, up = np.concatenate([-arc[::-1], arc]), np.repeat([-1.0, 1.0], steps + 1)
    straight = np.array(half) - radius
    unit = np.stack(
        [np.outer(np.cos(level), np.cos(turn)), np.outer(np.cos(level), np.sin(turn)),
         np.repeat(np.sin(level)[:, None], len(turn), axis=1)], axis=-1,
    )  # fmt: skip
    unit[0, :, :2] = unit[-1, :, :2] = 0.0
    points = radius * unit
    points[..., :2] += side * straight[:2]
    points[..., 2] += (up * straight[2])[:, None]
    lids = []
    for row, order in ((0, (3, 2, 1, 0)), (-1, (0, 1, 2, 3))):
        corners = points[row, [steps // 2 + (steps + 1) * quarter for quarter in order]]
        lids.append((corners, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)))
    return joined(grid(points, around=True), *lids)


def torus(radius: float, tube_radius: float, segments: int, rings: int) -> Mesh:
    """About z; its inner side is a saddle."""
    around, across = np.meshgrid(
        2.0 * np.pi * np.arange(segments + 1) / segments, 2.0 * np.pi * np.arange(rings + 1) / rings, indexing="ij"
    )
    out = radius + tube_radius * np.cos(across)
    return grid(np.stack([out * np.cos(around), out * np.sin(around), tube_radius * np.sin(across)], axis=-1))


WAVENUMBER = 2.0 * np.pi / WAVELENGTH_M
METAL, GLASS = (
    slab_reflection(*slab, FREQUENCY_HZ, np.ones(1))[0][0] for slab in ((1.0, 1e7, 0.1), (6.31, 1.211, 0.006))
)
"""Reflection coefficients at normal incidence."""


def turned(seed: int) -> Rotation:
    return Rotation.random(random_state=np.random.default_rng(seed))


def body(
    of: Mesh, centre, turn: Rotation | None = None, material: str = "metal", velocity=(0.0, 0.0, 0.0)
) -> SceneObject:
    vertices = of[0] if turn is None else turn.apply(of[0])
    return mesh("body", vertices + np.asarray(centre, dtype=float), of[1], material, velocity)


def traced(*objects: SceneObject, **settings) -> PathTable:
    return trace_of(scene_of(*objects), **{"rays": 2000, "depth": 1, "diffuse": False, **settings})


def amplitudes(table: PathTable) -> NDArray[np.complex128]:
    return table.every("amplitude")


def level_db(table: PathTable, expected: float) -> float:
    """The only echo's amplitude over the expected one [dB]."""
    (amplitude,) = amplitudes(table)
    return float(20.0 * np.log10(abs(amplitude / METAL) / expected))


def sphere_amplitude(radius: float, distance: float) -> float:
    """Of a metal sphere with its centre at this distance, in the near field too."""
    return WAVELENGTH_M / (8.0 * np.pi * (distance - radius)) * radius / distance


def cylinder_amplitude(radius: float, length: float, distance: float) -> float:
    """Of a metal cylinder seen broadside at its middle, with its axis at this distance, in the near field too."""
    range_m = distance - radius
    sine, cosine = fresnel(np.sqrt(2.0) * 0.5 * length * np.sqrt(2.0 / (range_m * WAVELENGTH_M)))
    share = np.sqrt(2.0) * abs(cosine + 1j * sine)
    return WAVELENGTH_M / (8.0 * np.pi * range_m) * share / np.sqrt(1.0 + range_m / radius)
