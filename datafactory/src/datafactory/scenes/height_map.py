"""A scene seen from above: height maps on a regular grid, rasterised triangle by triangle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.scene import Scene
from shared.physics.compiled import compiled

MAXIMUM_CELLS = 1_000_000
"""A larger grid is made coarser. With this many cells the largest built-in city takes less than a second."""


@dataclass(frozen=True)
class HeightMap:
    """Heights over each cell of a horizontal grid at time 0.

    Cell [i, j] covers x from origin[0] + i * cell_m to origin[0] + (i + 1) * cell_m, and y likewise.

    :param origin: (x, y) of the corner of cell [0, 0] [m]
    :param cell_m: side of a cell [m]
    :param surface: [nx, ny] height of the topmost surface over the cell's centre [m]; NaN where there is none
    :param highest: [nx, ny] height of the highest point over any part of the cell [m]; -inf where there is none.
        It contains walls and poles thinner than a cell, which ``surface`` does not.
    :param owner: [nx, ny] index of the object that ``surface`` belongs to, int32; -1 where there is none
    """

    origin: tuple[float, float]
    cell_m: float
    surface: NDArray[np.float64]
    highest: NDArray[np.float64]
    owner: NDArray[np.int32]


def height_map(scene: Scene, cell_m: float) -> HeightMap:
    """Rasterise every object, moving ones where they are at time 0, onto cells of ``cell_m`` or coarser.

    :param scene: a scene with at least one object
    :param cell_m: wanted side of a cell [m]; larger where the grid would exceed ``MAXIMUM_CELLS``
    """
    lower, upper = scene.bounds()
    extent = upper[:2] - lower[:2]
    cell = max(cell_m, float(np.sqrt(extent[0] * extent[1] / MAXIMUM_CELLS)))
    count = np.maximum(np.ceil(extent / cell).astype(int), 1)
    surface = np.full(count, -np.inf)
    highest = np.full(count, -np.inf)
    owner = np.full(count, -1, dtype=np.int32)
    for index, item in enumerate(scene.objects):
        # In units of cells, relative to the grid's corner: float64 before anything is subtracted.
        corners = item.vertices[item.triangles]
        corners[..., :2] = (corners[..., :2] - lower[:2]) / cell
        _rasterise(corners, index, surface, highest, owner)
    surface[owner < 0] = np.nan
    return HeightMap((float(lower[0]), float(lower[1])), cell, surface, highest, owner)


@compiled()
def _rasterise(corners, index, surface, highest, owner):
    """Draw triangles [T, 3, 3] (x and y in cells, z in metres) into the maps.

    A cell is touched where its square and the triangle overlap, decided by separating axes: the grid's own two (the
    bounding box) and the normals of the triangle's three sides. Over a touched cell the triangle is nowhere higher
    than its own highest corner, nor than its plane at the cell's highest corner.
    """
    columns, rows = surface.shape
    for t in range(corners.shape[0]):
        ax, ay, az = corners[t, 0]
        bx, by, bz = corners[t, 1]
        cx, cy, cz = corners[t, 2]
        top = max(az, bz, cz)
        # Plane z = az + gx (x - ax) + gy (y - ay); none for an upright triangle, whose area seen from above is zero.
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        upright = abs(area) < 1e-9
        gx = 0.0
        gy = 0.0
        if not upright:
            gx = ((bz - az) * (cy - ay) - (cz - az) * (by - ay)) / area
            gy = ((cz - az) * (bx - ax) - (bz - az) * (cx - ax)) / area
        first_i = max(int(np.floor(min(ax, bx, cx))), 0)
        last_i = min(int(np.floor(max(ax, bx, cx))), columns - 1)
        first_j = max(int(np.floor(min(ay, by, cy))), 0)
        last_j = min(int(np.floor(max(ay, by, cy))), rows - 1)
        for i in range(first_i, last_i + 1):
            for j in range(first_j, last_j + 1):
                x = i + 0.5
                y = j + 0.5
                # Signed distances (times side length) of the centre from the sides, and the square's reach along each.
                ab = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
                bc = (cx - bx) * (y - by) - (cy - by) * (x - bx)
                ca = (ax - cx) * (y - cy) - (ay - cy) * (x - cx)
                if area < 0.0:
                    ab, bc, ca = -ab, -bc, -ca
                reach_ab = 0.5 * (abs(bx - ax) + abs(by - ay))
                reach_bc = 0.5 * (abs(cx - bx) + abs(cy - by))
                reach_ca = 0.5 * (abs(ax - cx) + abs(ay - cy))
                if upright:
                    outside = abs(ab) > reach_ab or abs(bc) > reach_bc or abs(ca) > reach_ca
                else:
                    outside = ab < -reach_ab or bc < -reach_bc or ca < -reach_ca
                if outside:
                    continue
                centre = az + gx * (x - ax) + gy * (y - ay)
                reached = top if upright else min(top, centre + 0.5 * (abs(gx) + abs(gy)))
                highest[i, j] = max(highest[i, j], reached)
                inside = not upright and ab >= 0.0 and bc >= 0.0 and ca >= 0.0
                if inside and centre > surface[i, j]:
                    surface[i, j] = centre
                    owner[i, j] = index
