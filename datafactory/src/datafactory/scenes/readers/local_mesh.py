"""A mesh in its own coordinates, as one prim or file holds it, and the objects that are made of it.

Objects that repeat one mesh share its points and triangles. Their world coordinates are computed when they are asked
for, by the same operations as for an object of its own, so that they have the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.chain import placed
from datafactory.scenes.readers.meshes import FLAT, Dropped, clean_mesh, mirrors, place_mesh, usable, usable_triangles
from datafactory.scenes.readers.scale import number_spacing, placed_spacing_m
from datafactory.scenes.scene import PlacedPoints
from shared.physics.units import FARTHEST_M

Index = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class LocalMesh:
    """Points and triangles of one material.

    :param points: [P, 3] in local coordinates, in the precision of the file
    :param triangles: [T, 3] vertex indices, counter-clockwise seen from outside
    :param shared: whether several objects are made of it
    """

    points: NDArray[np.floating]
    triangles: NDArray[np.int64]
    shared: bool = False

    def placed(
        self, matrix: NDArray[np.float64], keep_points: bool = False
    ) -> tuple[NDArray[np.float64] | PlacedPoints, Index, Dropped]:
        """The mesh in the world without triangles that no ray tracer can use: vertices, triangles, what was dropped.

        :param matrix: [4, 4] to the world, acting on column vectors; a mirror reverses the winding
        :param keep_points: return the points in local coordinates, of what is to be placed elsewhere at another time
        :return: for :meth:`SceneObject.of`
        """
        if self.shared and self._all_in_range and self._all_usable(matrix):
            used, outward, mirrored = self._compact
            triangles = mirrored if mirrors(matrix) else outward
            return PlacedPoints(self.points, used, matrix), triangles, Dropped()
        placing = place_mesh(self.points, self.triangles, matrix)
        if not keep_points:
            return clean_mesh(*placing)
        kept, dropped = usable_triangles(*placing)
        used, compact = np.unique(kept, return_inverse=True)
        return PlacedPoints(self.points, used, matrix), compact.reshape(-1, 3).astype(np.int32), dropped

    def spacing_m(self, matrix: NDArray[np.float64]) -> float:
        """Spacing [m] of the numbers that the farthest vertex is written in, 0 where it does no harm."""
        return placed_spacing_m(self._number_spacing, matrix)

    def _all_usable(self, matrix: NDArray[np.float64]) -> bool:
        """Whether a ray tracer can use all triangles once placed, if possible without placing them.

        A transform with singular values s1 >= s2 >= s3 leaves at least s2 s3 of a triangle's area, and at most s1 of
        its sides: the ratio that :data:`FLAT` bounds keeps s2 s3 / s1^2 of what it was.
        """
        if np.isfinite(matrix).all():
            with np.errstate(over="ignore"):
                largest, middle, least = np.linalg.svd(matrix[:3, :3], compute_uv=False)
                solid = self._flattest * middle * least > 2.0 * FLAT * largest**2
                near = self._reach * largest + np.linalg.norm(matrix[:3, 3]) <= FARTHEST_M
            if solid and near:
                return True
        return bool(usable(placed(self.points, matrix)[self.triangles]).all())

    @cached_property
    def _flattest(self) -> float:
        """Smallest ratio of a triangle's doubled area to its longest side squared; NaN for points that are none."""
        edges = np.diff(self._corners, axis=1, append=self._corners[:, :1])
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            doubled_area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
            return float(np.min(doubled_area / np.square(edges).sum(axis=2).max(axis=1), initial=np.inf))

    @cached_property
    def _reach(self) -> float:
        """Largest distance of a vertex from the origin; NaN for points that are none."""
        with np.errstate(invalid="ignore", over="ignore"):
            return float(np.max(np.linalg.norm(self._corners, axis=2), initial=0.0))

    @property
    def _corners(self) -> NDArray[np.float64]:
        corners: NDArray[np.float64] = self.points[self.triangles].astype(np.float64)
        return corners

    @cached_property
    def _number_spacing(self) -> float:
        return number_spacing(self.points)

    @cached_property
    def _all_in_range(self) -> bool:
        return bool(((self.triangles >= 0) & (self.triangles < len(self.points))).all())

    @cached_property
    def _compact(self) -> tuple[NDArray[np.int64], Index, Index]:
        """The points in use, and the triangles on them as written and reversed."""
        used, compact = np.unique(self.triangles, return_inverse=True)
        outward = compact.reshape(-1, 3).astype(np.int32)
        return used, outward, np.ascontiguousarray(outward[:, ::-1])
