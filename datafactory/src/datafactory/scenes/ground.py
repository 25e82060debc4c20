"""Free ground: where in a scene a car could stand, and its streets, cut into separated regions for the splits.

A cell is free ground where the topmost surface is ground (not a roof, bridge or car), where it slopes gently, where no
step of more than 0.3 m lies within 1.5 m, and from where a way leads to the largest free ground, or to the roads where
any are named. The height map shows the topmost surface alone, rasterised triangle by triangle: ground under a bridge or
a tree is not used.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from datafactory.scenes.materials.table import singular, words
from datafactory.scenes.scene import PointTarget, Scene, SceneObject
from datafactory.scenes.streets import ROUTE_CLEARANCE_M, cut_into_regions, reachable, streets
from datafactory.scenes.things import FOLDER, Strip
from shared.dataset.folder import SPLITS, Split
from shared.physics.compiled import compiled
from shared.physics.errors import InputError

MAXIMUM_CELLS = 1_000_000
"""A larger grid is made coarser. With this many cells the largest built-in city takes less than a second."""
CELL_M = 0.5
MAXIMUM_STEP_M = 0.3
CLEARANCE_M = 1.5
MAXIMUM_SLOPE = 0.2
NEAR_OBSTACLE_M = 30.0
"""Free ground farther than this from every obstacle is left out: else most poses would lie on the plain at a city."""
LEVEL_M = 1.0
"""How far an isolated patch (a courtyard) may lie above or below the nearest main ground."""
LOWER_RIM_SHARE = 0.1
"""A patch with more of its rim than this above lower ground is a roof or a deck."""
HALF_LENGTH_M, HALF_WIDTH_M = 1.4, 0.8
"""Of the rectangle of a car's wheels, by whose heights it pitches and rolls."""
LANE_M = 3.6
"""Half of the two lanes' width: sensors that are drawn on roads with traffic stand here."""
ROAD_WORDS = frozenset({"road", "street", "lane", "asphalt", "tarmac", "highway", "strasse", "fahrbahn"})
Value = TypeVar("Value", bound=np.generic)


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


@dataclass(frozen=True)
class Ground:
    """Free ground on the grid of a height map; every array is [nx, ny].

    :param scene: name of the scene
    :param origin: (x, y) of the corner of cell [0, 0] [m]
    :param cell_m: side of a cell [m]
    :param height_m: height of the topmost surface at the cells' centres [m], NaN where there is none
    :param obstacle: something stands more than 0.3 m above the ground here
    :param free: free ground, the gaps between the regions included
    :param road: free ground that belongs to an object named as a road
    :param street: free ground where a car would drive: roads and kerbs, or what lies between facades, or all
    :param region: index into ``SPLITS`` of the region that a cell of a street belongs to; -1 for all others
    :param side: index into ``SPLITS`` of the split whose side of the gaps' middles a cell lies on
    :param gap_m: width of the strips between the regions [m]
    """

    scene: str
    origin: tuple[float, float]
    cell_m: float
    height_m: NDArray[np.float64]
    obstacle: NDArray[np.bool_]
    free: NDArray[np.bool_]
    road: NDArray[np.bool_]
    street: NDArray[np.bool_]
    region: NDArray[np.int8]
    side: NDArray[np.int8]
    gap_m: float

    def cells(self, split: Split, road: bool | None = None) -> NDArray[np.int64]:
        """[n, 2] cells of a split's region, or of its roads alone, or of the others alone."""
        chosen = self.region == SPLITS.index(split)
        return np.argwhere(chosen if road is None else chosen & (self.road == road))

    def area_m2(self, split: Split) -> float:
        return float(np.count_nonzero(self.region == SPLITS.index(split))) * self.cell_m**2

    def cell_of(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Cells that the points [...] lie in [m]; indices may fall outside the grid."""
        i = np.floor((x - self.origin[0]) / self.cell_m).astype(np.int64)
        return i, np.floor((y - self.origin[1]) / self.cell_m).astype(np.int64)

    def values_at(self, values: NDArray[Value], x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[Value]:
        """Values [nx, ny] of the cells that the points [...] lie in [m]; 0 beyond the grid."""
        i, j = self.cell_of(x, y)
        inside = (i >= 0) & (i < values.shape[0]) & (j >= 0) & (j < values.shape[1])
        return np.where(inside, values[np.where(inside, i, 0), np.where(inside, j, 0)], values.dtype.type(0))

    def heights_at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Heights of the ground [m] at points [n], bilinear between cells' centres; NaN beside where there is none."""
        at = [(x - self.origin[0]) / self.cell_m - 0.5, (y - self.origin[1]) / self.cell_m - 0.5]
        return np.asarray(ndimage.map_coordinates(self.height_m, np.array(at), order=1, mode="nearest"))

    def tilt_deg(self, x: float, y: float, yaw_rad: float) -> tuple[float, float]:
        """Pitch and roll [deg] of a car that stands on free ground and looks along a heading."""
        reach = np.array([HALF_LENGTH_M, HALF_WIDTH_M])
        east, north = reach * [np.cos(yaw_rad), -np.sin(yaw_rad)], reach * [np.sin(yaw_rad), np.cos(yaw_rad)]
        ahead, left = self.heights_at(x + east, y + north) - self.heights_at(x - east, y - north)
        pitch = np.arctan2(-ahead, 2.0 * HALF_LENGTH_M)
        roll = np.arctan2(left * np.cos(pitch), 2.0 * HALF_WIDTH_M)
        return float(np.degrees(pitch)), float(np.degrees(roll))

    def free_path(self, x: float, y: float, headings_rad: NDArray[np.float64], reach_m: float) -> NDArray[np.float64]:
        """[n] distance [m] from a point to the first obstacle along each heading [n]; inf if none within ``reach_m``.

        Searched in steps of half a cell; beyond the edge of the scene there is no obstacle.
        """
        distance = np.arange(0.5 * self.cell_m, reach_m, 0.5 * self.cell_m)
        ahead, aside = np.cos(headings_rad)[:, None] * distance, np.sin(headings_rad)[:, None] * distance
        blocked = self.values_at(self.obstacle, x + ahead, y + aside)
        return np.where(blocked.any(axis=1), distance[blocked.argmax(axis=1)], np.inf)


def _mark_footprint(obstacle: NDArray[np.bool_], target: PointTarget, heights: HeightMap) -> None:
    """Mark the cells that a point target stands on: at least the cell nearest to its position."""
    radius = target.model.footprint_m if target.model is not None else 0.0
    middle = [(target.position[axis] - heights.origin[axis]) / heights.cell_m - 0.5 for axis in (0, 1)]
    reach = radius / heights.cell_m + 0.5
    across, along = np.indices(obstacle.shape)
    distance = np.hypot(across - middle[0], along - middle[1])
    obstacle |= distance <= max(reach, float(distance.min()))


def free_ground(scene: Scene) -> Ground:
    """Find the scene's free ground, and cut its streets into three separated regions.

    :raises InputError: if the scene has no free ground; ``--poses`` does without
    """
    if not scene.objects:
        raise InputError(scene.source or scene.name, "the scene has no objects", "at least one mesh")
    heights = height_map(scene, CELL_M)
    cell = heights.cell_m
    edge, standing = _edges_and_obstacles(heights)
    ground = _without_roofs(
        np.isfinite(heights.surface) & ~edge & ~standing & (_slope(heights) <= MAXIMUM_SLOPE), heights
    )
    obstacle = standing | _raised(ground, heights)
    for target in scene.targets:
        _mark_footprint(obstacle, target, heights)
    # From any point of a cell to any point of an obstacle's cell: two half diagonals less than between centres.
    step_m = _distance_to_marked(edge | obstacle, cell)
    free = ground & (step_m >= CLEARANCE_M + np.sqrt(2.0) * cell)
    named = np.isin(heights.owner, [n for n, item in enumerate(scene.objects) if _is_road(item.name, item.material)])
    free = reachable(free, free | (ground & (step_m >= ROUTE_CLEARANCE_M)), named)
    near = free & (_distance_to_marked(obstacle, cell) <= NEAR_OBSTACLE_M)
    if near.any():
        free = near
    if not free.any():
        raise InputError(
            scene.source or scene.name,
            f"no free ground: nowhere a gentle surface with {CLEARANCE_M} m around it free of steps",
            "a scene with open ground, or --poses FILE.json",
        )
    road = free & named
    street = streets(free, road, obstacle, cell)
    grid = scene.name, heights.origin, cell, heights.surface
    return Ground(*grid, obstacle, free, road, street, *cut_into_regions(street, cell))


def sensor_ground(scene: Scene) -> Ground:
    """Where a sensor may be drawn: free of all that stands, and on the roads with traffic first of all.

    What a population moves is left out here: a frame's time is drawn so that it is away.

    :raises InputError: the scene has no free ground
    """
    population = scene.population
    if population is None:
        return free_ground(scene)
    objects = tuple(item for item in scene.objects if not _put_in_and_moves(item))
    targets = tuple(target for target in scene.targets if not _put_in_and_moves(target))
    ground = free_ground(replace(scene, objects=objects, targets=targets))
    road = ground.road.copy()
    x, y = np.array(ground.origin)[:, None, None] + (np.indices(road.shape) + 0.5) * ground.cell_m
    for strip in population.roads:
        lanes = Strip(strip.middle, strip.heading_rad, strip.length_m, min(LANE_M, strip.half_width_m))
        road |= ground.free & lanes.holds(x, y)
    return replace(ground, road=road)


def _put_in_and_moves(item: SceneObject | PointTarget) -> bool:
    return item.motion is not None and item.name.startswith(f"{FOLDER}/")


def _is_road(name: str, material: str) -> bool:
    """Whether any part of the object's path, or its material's name, has a road's word in it."""
    found = [word for part in (*name.split("/"), material) for word in words(part)]
    return any(word in ROAD_WORDS or singular(word) in ROAD_WORDS for word in found)


def _distance_to_marked(marked: NDArray[np.bool_], cell_m: float) -> NDArray[np.float64]:
    """Distance [m] between cell centres to the nearest marked cell; inf where nothing is marked."""
    if not marked.any():
        return np.full(marked.shape, np.inf)
    return ndimage.distance_transform_edt(~marked) * cell_m


def _edges_and_obstacles(heights: HeightMap) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Cells at the edge of the ground (nothing beyond, or a drop), and cells that something stands on.

    Within a cell a permitted slope rises by up to slope * cell * (|cos| + |sin|) / 2 from centre to corner and by
    slope * cell to the next centre: only what is above that is a step.
    """
    cell = heights.cell_m
    surface = np.where(np.isnan(heights.surface), -np.inf, heights.surface)
    padded = np.pad(surface, 1, constant_values=-np.inf)
    lowest = ndimage.minimum_filter(padded, footprint=ndimage.generate_binary_structure(2, 1))[1:-1, 1:-1]
    with np.errstate(invalid="ignore"):  # -inf less -inf: no ground on either side
        drop = surface - lowest
    rise = heights.highest - heights.surface  # NaN, hence no step, where the cell's centre has no ground
    allowed = max(MAXIMUM_STEP_M, MAXIMUM_SLOPE * cell)
    edge = ~(drop <= allowed)
    obstacle = rise > MAXIMUM_STEP_M + MAXIMUM_SLOPE * cell * np.sqrt(0.5)
    return edge, obstacle


def _slope(heights: HeightMap) -> NDArray[np.float64]:
    """Steepness of the surface, rise over run; 0 along an axis of one cell."""
    rise_x, rise_y = (
        np.gradient(heights.surface, heights.cell_m, axis=axis) if size > 1 else np.zeros_like(heights.surface)
        for axis, size in enumerate(heights.surface.shape)
    )
    return np.hypot(rise_x, rise_y)


def _without_roofs(gentle: NDArray[np.bool_], heights: HeightMap) -> NDArray[np.bool_]:
    """Gentle patches that are ground: few surfaces around their rim are lower, and they lie at the ground's level.

    The largest such patch sets the level. Another patch counts if its height is within 1 m of that patch's nearest
    cell.
    """
    label, count = ndimage.label(gentle)
    if count == 0:
        return gentle
    sizes = np.bincount(label.ravel(), minlength=count + 1)
    # A cell outside the patches, at most three cells away, is rim of the nearest patch: an edge is that wide.
    distance, (i, j) = ndimage.distance_transform_edt(~gentle, return_indices=True)
    rim = (distance > 0) & (distance <= 3.0) & np.isfinite(heights.surface)
    owner = label[i, j][rim]
    lower = heights.surface[rim] < heights.surface[i, j][rim] - LEVEL_M
    rims = np.bincount(owner, minlength=count + 1)
    lower_rims = np.bincount(owner, weights=lower, minlength=count + 1)
    is_ground = lower_rims <= LOWER_RIM_SHARE * rims
    is_ground[0] = False
    if not is_ground.any():
        return np.zeros_like(gentle)
    main = label == np.argmax(np.where(is_ground, sizes, 0))
    i, j = ndimage.distance_transform_edt(~main, return_distances=False, return_indices=True)
    level = np.abs(heights.surface - heights.surface[i, j]) <= LEVEL_M
    return (is_ground[label] & level) | main


def _raised(ground: NDArray[np.bool_], heights: HeightMap) -> NDArray[np.bool_]:
    """Cells that rise above the nearest ground by more than a step and what a permitted slope gains on the way.

    Roofs, canopies and hillsides are obstacles too, not only the walls that the local steps show.
    """
    if not ground.any():
        return np.zeros_like(ground)
    away, (i, j) = ndimage.distance_transform_edt(~ground, return_indices=True)
    slope_gain = MAXIMUM_SLOPE * heights.cell_m * (away + np.sqrt(0.5))
    return heights.highest > heights.surface[i, j] + MAXIMUM_STEP_M + slope_gain
