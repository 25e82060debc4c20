"""What a sensor would see from a place on free ground: how far, whether anything, and on whose side of the gaps.

A fan of rays over the field of view is followed over the ground's map of obstacles. The map marks every cell that
anything stands in by more than 0.3 m, so that what it calls free is free of the triangles too, and nothing but ground
lies within 1.5 m of free ground.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.ground import Ground
from shared.dataset.folder import SPLITS, Split

SIGHT_M = 95.0
"""The default radar's 94.4 m."""
SECTOR_DEG = 58.0
"""To each side: the default radar's images end at u = 0.85."""
SECTOR_RAYS = 25
"""One heading every 5 deg across the sector: one of them meets a facade 8 m wide at 90 m."""
SECTOR_RAD = np.radians(np.linspace(-SECTOR_DEG, SECTOR_DEG, SECTOR_RAYS))
FREE_AHEAD_M = 8.0
FAR_M = 15.0


@dataclass(frozen=True)
class View:
    """A sensor's view.

    :param ahead_m: free path along the boresight [m]; inf where nothing stands within ``SIGHT_M``
    :param farthest_m: the longest free path in the field of view [m]
    :param seen: whether anything stands in the field of view within ``SIGHT_M``
    :param foreign: of the rays that meet something, the share that meets it on another split's side
    """

    ahead_m: float
    farthest_m: float
    seen: bool
    foreign: float

    @property
    def worth(self) -> tuple[bool, float, float]:
        """The better of two views has the larger: along a street at something; of its own; free ahead."""
        along = self.seen and self.farthest_m >= FAR_M
        return along, -self.foreign, min(self.ahead_m, FREE_AHEAD_M)


BEST = (True, 0.0, FREE_AHEAD_M)
"""The worth of a view that nothing is wrong with."""


def view_from(ground: Ground, x: float, y: float, yaw_rad: float, split: Split) -> View:
    """The view of a sensor of a split that stands at (x, y) [m] and looks along a heading."""
    headings = yaw_rad + SECTOR_RAD
    free = ground.free_path(x, y, headings, SIGHT_M)
    met = np.isfinite(free)
    side = _sides(ground, x + np.cos(headings[met]) * free[met], y + np.sin(headings[met]) * free[met])
    foreign = float(np.mean(side != SPLITS.index(split))) if met.any() else 0.0
    return View(float(free[SECTOR_RAYS // 2]), float(free.max()), bool(met.any()), foreign)


def _sides(ground: Ground, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.int8]:
    """[n] whose side the points' cells [n] lie on."""
    i, j = ground.cell_of(x, y)
    return ground.side[i, j]
