"""Right-angled corners in one frame: what their edges and their points send back, in place of mirrors that meet there.

The ray that a corner turns back to the radar runs into an edge, or into the point in which three faces meet. A path
solver finds it by chance or not at all. All echoes of two or three mirrors that are the faces of one corner come from
here, and the solver's are left out.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from datafactory.paths.corner_edges import corners_of
from datafactory.paths.merged_scene import MergedScene
from datafactory.paths.solver import Bundle
from datafactory.paths.table import DIFFUSE


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
