"""What a frame is made with, decided from its own paths.

Which of its candidates a radar would not notice says :mod:`datafactory.paths.notice`. Of the effects of the signal one
is a decision: without Doppler one chirp stands for all. It is off where nothing moves, or where in no resolution cell
the paths' powers, each times the square of what its motion changes (:func:`.changes.doppler_change`), exceed the
frame's limit together. Range migration and motion within the chirp come with it; leaving them, the near field or the
patterns out saves nothing.

A decision is a function of the frame's own paths, the radar and the budget. It knows nothing of other frames, so that a
frame is the same rendered alone, by any worker, or from stored paths.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.frame import changes
from datafactory.paths.candidates import PANE
from datafactory.paths.density import cell_map
from datafactory.paths.notice import Notice, strongest
from datafactory.paths.table import CORNER, DIFFRACTED, DIFFUSE, REFRACTED, SPECULAR, TARGET, PathTable
from shared.radar import Radar


@dataclass(frozen=True, eq=False)
class Decided:
    """What a frame's radar would notice.

    :param limit_w: power that may be left out of a resolution cell [W]
    :param worth: [N] of the table's candidates, those that are followed
    """

    limit_w: float
    worth: NDArray[np.bool_]

    @staticmethod
    def of(table: PathTable, notice: Notice) -> Decided:
        """:param table: as traced, at the radar's wavelength"""
        limit = notice.limit_w(table)
        return Decided(limit, notice.worth(table.candidates, limit))

    def kept(self, table: PathTable) -> PathTable:
        """The table without the paths that are not followed: of a frame traced for this radar there are none."""
        panes = bool(self.worth[table.candidates.family == PANE].any())

        def kept(candidate: NDArray[np.int32], kinds: NDArray[np.uint8]) -> NDArray[np.bool_]:
            followed = np.append(self.worth, True)[candidate]  # -1, of what is always there, is the last
            return followed if panes else followed & (kinds & REFRACTED == 0)

        scattered, specular = table.scattered, table.specular
        return table.take(kept(scattered.candidate, scattered.kinds), kept(specular.candidate, specular.kinds))


def doppler_called_for(paths: PathTable, radar: Radar, truth_window: str, limit_w: float) -> bool:
    """Whether a frame's illuminated paths need more than one chirp: where nothing may be left out, if anything moves.

    :param limit_w: power that may be left out of a resolution cell [W]
    """
    if radar.waveform.chirps == 1 or not paths.moves():
        return False
    if limit_w == 0.0:
        return True
    for some in (strongest(paths), paths):  # a few are enough in most frames that move
        share = changes.doppler_change(changes.range_rates_mps(some, radar.waveform), radar.waveform) ** 2
        if cell_map(some, radar, truth_window).sums(share).max(initial=0.0) > limit_w:
            return True
    return False


def bounces_more_than_once(paths: PathTable) -> NDArray[np.bool_]:
    """[K] whether a path has two or more bounces; diffraction at an edge does not count as one, and the bounces in a
    right-angled corner are an effect of their own.
    """
    depth = np.concatenate([paths.scattered.depth, paths.specular.depth])
    return (depth > 1) & (kinds_of(paths) & (DIFFRACTED | CORNER) == 0)


def kinds_of(paths: PathTable) -> NDArray[np.uint8]:
    """[K] kinds of interaction, scattered paths first."""
    return np.concatenate([paths.scattered.kinds, paths.specular.kinds])


KINDS = {
    "specular": SPECULAR,
    "diffuse": DIFFUSE,
    "refraction": REFRACTED,
    "diffraction": DIFFRACTED,
    "corners": CORNER,
    "rcs_targets": TARGET,
}
"""Effects that a path shows by its kinds."""


def path_effects(paths: PathTable) -> dict[str, bool]:
    """Effects on paths that a frame has: whether any path in it is of that kind."""
    there = int(np.bitwise_or.reduce(kinds_of(paths), initial=0))
    found = {name: bool(there & kind) for name, kind in KINDS.items()}
    return {**found, "multi_bounce": bool(bounces_more_than_once(paths).any())}
