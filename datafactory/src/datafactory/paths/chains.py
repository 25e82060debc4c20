"""Whether a frame has chains of mirrors: what a thin share of its rays tells before the solver is asked.

A chain is a sequence of mirrors, each of which reflects the wave onto the next, and the last one home. Its rays are all
rays that meet these faces one after another. So the sequences of triangles that some rays meet, as from mirrors, hold
the chains between faces that these rays do not miss. Of each the image method says whether there is a way that closes:
with I_0 = 0 and I_j the image of I_j-1 in the plane of mirror j, the wave comes home along the line from I_n to the
radar, and meets the mirrors where that line, unfolded mirror by mirror, crosses their planes. A triangle counts as
``LARGER`` times as large here: its neighbours in the same face are not looked for, and rays that miss a small face by
a little stand for those that do not. The echo of a chain of length L is at most lambda / (4 pi L), that of perfect
mirrors. Visibility and the true reflections are the solver's (:mod:`datafactory.paths.solver`).

Mirrors that are the faces of one right-angled corner are left to :mod:`datafactory.paths.corner_echoes` and
:mod:`datafactory.paths.corner_point_echoes`. The ray that a corner turns back to the radar runs into an edge, or into
the point in which three faces meet. A path solver finds it by chance or not at all, and what it finds is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from datafactory.paths.candidates import Candidates
from datafactory.paths.corner_edges import CornerEdges, corners_of
from datafactory.paths.merged_scene import MergedScene, barycentric
from datafactory.paths.solver import Bundle
from datafactory.paths.table import DIFFUSE
from datafactory.paths.view import View
from shared.physics.vectors import Index, Real

LARGER = 2.0
"""How much larger than it is, about its centre, a triangle counts in each direction."""


def chain_candidates(family: int, sequences: Sequence[Index], view: View, corners: CornerEdges | None) -> Candidates:
    """Of every sequence of triangles over which a way closes.

    :param family: ``CHAIN``, or ``PASSED`` where rays went through panes
    :param sequences: triangles [n, mirrors] in the order in which rays met them
    :param corners: right-angled, whose own chains are left out; None where those are the solver's, behind panes
    """
    found, wavelength_m = [Candidates.none()], view.wavelength_m
    for sequence in sequences:
        some = np.unique(sequence, axis=0)
        if corners is not None:
            own = np.ones(len(some), dtype=bool)
            for one, other in combinations(some.T, 2):
                own &= corners.joins(one, other)
            some = some[~own]
        image, departure = _closed(view.corners[some], view.normals[some], view.heights[some])
        length = np.linalg.norm(image, axis=1)
        power = (wavelength_m / (4.0 * np.pi * np.maximum(length, wavelength_m))) ** 2
        found.append(Candidates.of(family, image, power, 0.5 * length, departure))
    return Candidates.joined(found)


def _closed(corner: Real, normal: Real, height: Real) -> tuple[Real, Real]:
    """Of the sequences [n, m] whose way closes: the image of the origin [k, 3] and the first mirror's point [k, 3]."""
    count, mirrors = height.shape
    images = [np.zeros((count, 3))]
    for step in range(mirrors):
        n = normal[:, step]
        images.append(images[-1] - 2.0 * (np.einsum("ni,ni->n", n, images[-1]) - height[:, step])[:, None] * n)
    place, closes = np.zeros((count, 3)), np.ones(count, dtype=bool)
    for step in range(mirrors - 1, -1, -1):
        n, along = normal[:, step], images[step + 1] - place
        slope = np.einsum("ni,ni->n", n, along)
        share = (height[:, step] - np.einsum("ni,ni->n", n, place)) / np.where(slope == 0.0, np.inf, slope)
        place = place + share[:, None] * along
        closes &= (share > 0.0) & (share < 1.0)
        closes &= barycentric(corner[:, step], place).min(axis=1) >= (1.0 - LARGER) / 3.0
    return images[-1][closes], place[closes]


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
