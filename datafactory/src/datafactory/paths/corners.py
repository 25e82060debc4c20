"""Right-angled corners in one frame: what their edges and their points send back, in place of mirrors that meet there.

The ray that a corner turns back to the radar runs into an edge, or into the point in which three faces meet. A path
solver finds it by chance or not at all. All echoes of two or three mirrors that are the faces of one corner come from
here, and the solver's are left out.
"""

from __future__ import annotations

from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

from datafactory.paths.corner_echoes import corner_echoes
from datafactory.paths.corner_edges import corners_of
from datafactory.paths.corner_point_echoes import corner_point_echoes
from datafactory.paths.corner_points import points_of
from datafactory.paths.merged_scene import MergedScene, slabs_of
from datafactory.paths.ray_hits import clear_between
from datafactory.paths.solver import Bundle, TraceSettings
from datafactory.paths.table import DIFFUSE, ScatteredPaths, SpecularPaths
from datafactory.paths.targets import EDGES_WITHIN_M
from datafactory.scenes.materials.table import MaterialMapping
from datafactory.scenes.poses import Pose


def echoes_of_corners(
    geometry: Any,
    merged_scene: MergedScene,
    materials: MaterialMapping,
    pose: Pose,
    frequency_hz: float,
    settings: TraceSettings,
) -> tuple[list[ScatteredPaths], list[SpecularPaths], dict[str, int]]:
    """The echoes of a frame's corners, and the numbers of those left out.

    :param geometry: Mitsuba's scene in the radar frame
    """
    radar = (slabs_of(merged_scene, materials), frequency_hz, partial(clear_between, geometry), settings.polarization)
    edges = corner_echoes(corners_of(merged_scene).seen_from(pose).within(EDGES_WITHIN_M), *radar)
    points = corner_point_echoes(points_of(merged_scene).seen_from(pose).within(EDGES_WITHIN_M), *radar)
    return [edges[0], points[0]], [edges[1], points[1]], edges[2] | points[2]


def without_corners(bundle: Bundle, merged_scene: MergedScene) -> tuple[Bundle, int]:
    """The paths without those that are mirrored once by each face of a corner and nothing else, and their number."""
    corners = corners_of(merged_scene)
    count = (bundle.interactions > 0).sum(axis=1)
    mirrored = (bundle.interactions != DIFFUSE).all(axis=1) & (bundle.crossings == 0)
    keep = np.ones(len(count), dtype=bool)
    for bounces in range(2, min(bundle.interactions.shape[1], 3) + 1):
        index = np.flatnonzero(mirrored & (count == bounces))
        joined = np.ones(len(index), dtype=bool)
        for one, other in combinations(bundle.triangles[index, :bounces].T, 2):
            joined &= corners.joins(one, other)
        keep[index] = ~joined
    return bundle.take(keep), int((~keep).sum())
