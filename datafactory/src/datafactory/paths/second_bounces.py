"""Second bounces of a frame: estimated first, followed with all its rays only where they matter.

Waves scattered twice (:func:`.scattered.scattered_twice`) are found from one ray in many as it is: they are their own
estimate. Waves mirrored and then scattered (:func:`.scattered.over_mirrors`) are looked for along a thin share of the
rays first: every k-th ray, so that some ``THIN_RAYS`` of those that met a surface are among them, and at least one ray
in ``THINNEST``. Each echo of the share stands for what k rays would bring. Of n echoes alike in a resolution cell the
sum has the standard error 1 / sqrt(n) of itself, of a single one its own size, so that three times the echo's power is
the estimate and two standard errors above. What is found here is not looked for again: where the group is followed, the
other rays are added. The same share tells the faces over which there may be chains of mirrors (:mod:`.chains`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from datafactory.defaults import LARGEST_DEPTH
from datafactory.paths.arrivals import Arrivals, Echoes
from datafactory.paths.candidates import CHAIN, MIRRORED, TWICE, Candidates
from datafactory.paths.chains import chain_candidates
from datafactory.paths.corner_edges import corners_of
from datafactory.paths.scattered import over_mirrors, scattered_twice
from datafactory.paths.table import SPECULAR
from shared.physics.vectors import lengths

THIN_RAYS, THINNEST = 12_500, 16
"""As many rays as find chains between small faces (:data:`datafactory.paths.solver.LEAST_SOLVER_RAYS`)."""
SURE = 3.0
"""Estimate and two standard errors of a cell in which one echo was found, over that echo."""


class SecondBounces:
    """What a frame's rays meet after their first surface.

    :param first: where they meet it; :param seed: of the directions in which it scatters
    """

    def __init__(self, first: Arrivals, seed: int) -> None:
        self._each = max(min(THINNEST, len(first.ray) // THIN_RAYS), 1)
        self._thin, self._rest = first.share(self._each)
        self._mirrored, self._twice = over_mirrors(self._thin), scattered_twice(first, seed)

    def candidates(self) -> dict[int, Candidates]:
        """Of each group."""
        mirrored = [_estimates(MIRRORED, echoes, self._each) for echoes in self._mirrored]
        twice = [_estimates(TWICE, echoes, 1) for echoes in self._twice]
        return {
            MIRRORED: Candidates.joined([Candidates.none(), *mirrored]),
            TWICE: Candidates.joined([Candidates.none(), *twice]),
            CHAIN: self._chains(),
        }

    def _chains(self) -> Candidates:
        arrivals, sequences = self._thin, list[NDArray[np.int64]]()
        if not arrivals.settings.specular:
            return Candidates.none()
        for _ in range(LARGEST_DEPTH - 1):
            arrivals = arrivals.reflected()
            sequences.append(np.concatenate([arrivals.waves.triangles, arrivals.hits.triangle[:, None]], axis=1))
        return chain_candidates(sequences, arrivals.view, corners_of(arrivals.view.merged))

    def echoes(self, group: int) -> list[Echoes]:
        """All echoes of a group, by the kinds of bounce."""
        if group == TWICE:
            return self._twice
        if not len(self._rest.ray):
            return self._mirrored
        return [Echoes.joined(parts) for parts in zip(self._mirrored, over_mirrors(self._rest), strict=True)]


def _estimates(group: int, echoes: Echoes, stands_for: int) -> Candidates:
    """Of echoes in a thin share: each way round, for what begins with a mirror stands for its reverse as well.

    :param stands_for: as many rays as one of the share
    """
    waves, last = echoes.arrivals.waves, echoes.arrivals.hits.point
    first, range_m = waves.bounced[:, 0], 0.5 * (waves.length + lengths(last))
    power = SURE * stands_for * echoes.power
    there = Candidates.of(group, last, power, range_m, first)
    if echoes.kinds[0] != SPECULAR:
        return there
    return Candidates.joined([there, Candidates.of(group, first, power, range_m, last)])
