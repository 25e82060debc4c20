"""Echoes that may come, each with a bound, before anything is tested for visibility (docs/notes/planning.md).

Edges, corners and targets are listed. What is not listed, waves scattered twice and chains of mirrors, has an estimate
from a thin share of the frame's rays in its place. Candidates are independent of the radar, as paths are: a trace that
serves many radars stores them, and each then decides what it would not notice (:mod:`datafactory.paths.notice`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.columns import Columns
from shared.physics.vectors import Real

EDGE, CORNER, TARGET_SEEN, TARGET_MIRRORED, PANE, TWICE, MIRRORED, CHAIN, PASSED = range(9)
"""What a candidate may become: an edge's echo, a right-angled corner's, a target's own or round an edge, a target's
over mirrors; what lies beyond a pane; waves scattered twice, mirrored and then scattered, mirrored twice or more, and
the same through panes.
"""
GROUPS = (PANE, TWICE, MIRRORED, CHAIN, PASSED)
"""Followed altogether or not at all; the others one by one."""

Float = NDArray[np.float32]


@dataclass(frozen=True)
class Candidates(Columns):
    """N of them, in the radar frame.

    :param family: [N] ``EDGE`` to ``PASSED``
    :param departure: [N, 3] point at which the TX sees it [m]; :param arrival: [N, 3] at which the RX does [m]
    :param range_m: [N] half of the way from and to the origin [m]
    :param power: [N] what the square of its amplitude, or of the sum of its amplitudes, does not exceed; isotropic
        antennas, unit transmit power
    """

    family: NDArray[np.uint8]
    departure: Float
    arrival: Float
    range_m: Float
    power: Float

    @staticmethod
    def of(
        family: int,
        arrival: Real,
        power: Real,
        range_m: Real | None = None,
        departure: Real | None = None,
    ) -> Candidates:
        """Of one family; seen where they stand, by TX and RX alike, unless said otherwise."""
        place = np.asarray(arrival, dtype=np.float32).reshape(-1, 3)
        far = np.linalg.norm(place, axis=1) if range_m is None else np.asarray(range_m, dtype=np.float32)
        out = place if departure is None else np.asarray(departure, dtype=np.float32).reshape(-1, 3)
        return Candidates(np.full(len(place), family, np.uint8), out, place, far, np.asarray(power, dtype=np.float32))

    @staticmethod
    def group(family: int, members: Candidates) -> Candidates:
        """A group, its members behind a first candidate that is nothing by itself and stands for the whole."""
        return Candidates.joined([Candidates.of(family, np.zeros((1, 3)), np.zeros(1)), members])

    @staticmethod
    def none() -> Candidates:
        """None at all."""
        return Candidates.of(EDGE, np.zeros((0, 3)), np.zeros(0))
