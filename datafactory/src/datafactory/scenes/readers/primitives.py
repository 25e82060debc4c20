"""Solids that scene files give by their parameters, as triangle meshes.

Round solids are solids of revolution with ``SEGMENTS`` chords to the full circle. Their corners lie on the true
surface. The largest gap between chord and arc is r (1 - cos(pi / SEGMENTS)) = 0.0012 r around the axis. A facet of a
sphere is curved in two directions, and its gap is at most twice that (``CHORD_ERROR``). The tracer finds the curved
surface behind such facets again (:mod:`datafactory.paths.curved_surfaces`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SEGMENTS = 64
CHORD_ERROR = 2 * (1 - np.cos(np.pi / SEGMENTS))  # largest distance to the true surface, in radii

Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]


def _revolve(profile: NDArray[np.float64]) -> Mesh:
    """Revolve [n, 2] (radius, height), from bottom to top, about the z axis; normals point outwards."""
    from trimesh import creation  # where needed, as in box: it takes half a second, and few files hold solids

    # trimesh merges vertices on a grid of 1e-8: far from a size of 1, the solid is made smaller or larger first.
    size = float(np.abs(profile).max(initial=0.0))
    scale = 2.0 ** np.ceil(np.log2(size)) if size > 0.0 and not 1e-3 <= size <= 1e6 else 1.0  # exact, a power of two
    solid = creation.revolve(profile / scale, sections=SEGMENTS, process=False)
    solid.merge_vertices()  # the corners on the axis, once for each segment until here
    return np.asarray(solid.vertices, dtype=np.float64) * scale, np.asarray(solid.faces, dtype=np.int64)


def _arc(radius: float, start: float, stop: float, height: float) -> NDArray[np.float64]:
    """(radius, height) along a sphere's meridian between two latitudes [rad], its centre at ``height``."""
    latitude = np.linspace(start, stop, max(2, round(abs(stop - start) / (2 * np.pi) * SEGMENTS) + 1))
    arc = np.column_stack([radius * np.cos(latitude), height + radius * np.sin(latitude)])
    arc[np.isclose(np.abs(latitude), np.pi / 2), 0] = 0.0
    return arc


def sphere(radius: float) -> Mesh:
    """A sphere about the origin."""
    return _revolve(_arc(radius, -np.pi / 2, np.pi / 2, 0.0))


def cylinder(radius_bottom: float, radius_top: float, height: float, closed: bool = True) -> Mesh:
    """A cylinder along z about the origin; with one radius 0 a cone, with ``closed`` False an open tube."""
    tube = np.array([[radius_bottom, -height / 2], [radius_top, height / 2]])
    if closed:
        tube = np.concatenate([[[0.0, -height / 2]], tube, [[0.0, height / 2]]])
    return _revolve(_without_repeats(tube))


def capsule(radius_bottom: float, radius_top: float, height: float) -> Mesh:
    """A tube of this height along z about the origin, with half a sphere on each end."""
    lower = _arc(radius_bottom, -np.pi / 2, 0.0, -height / 2)
    upper = _arc(radius_top, 0.0, np.pi / 2, height / 2)
    return _revolve(_without_repeats(np.concatenate([lower, upper])))


def disk(radius: float) -> Mesh:
    """A flat disk in the plane z = 0, its normal along +z."""
    return _revolve(np.array([[radius, 0.0], [0.0, 0.0]]))


def _without_repeats(profile: NDArray[np.float64]) -> NDArray[np.float64]:
    """The profile without repeated points, which would make triangles of no area."""
    return profile[np.concatenate([[True], (np.diff(profile, axis=0) != 0).any(axis=1)])]


def box(size: float) -> Mesh:
    """A cube of this edge about the origin."""
    from trimesh import creation

    solid = creation.box(extents=[size] * 3)
    return np.asarray(solid.vertices, dtype=np.float64), np.asarray(solid.faces, dtype=np.int64)


def rectangle(width: float, length: float) -> Mesh:
    """``width`` along x, ``length`` along y, in the plane z = 0, its normal along +z."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [width / 2, length / 2, 0.0]
    return corners.astype(np.float64), np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int64)
