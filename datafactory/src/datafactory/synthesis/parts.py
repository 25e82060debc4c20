"""What every kernel of the cube needs first: the paths as each TX sees them, and RX elements in blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from datafactory.paths.table import PathTable, ScatteredPaths
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar.arrays import AntennaArray

BLOCK_REACH_BINS = 0.205
"""Largest difference between a block's delays and the delay of its centre [bins]: blocks of 64 of the virtual sensor's
RX, which need 8 moments at 1e-6."""


@dataclass(frozen=True)
class Part:
    """Paths in the form of scattered ones, with the TX they serve and the starts of that TX's chirps [s]."""

    paths: ScatteredPaths
    tx: slice
    start: Float64[np.ndarray, " chirps"]


def parts_of(paths: PathTable, array: AntennaArray, times: Float64[np.ndarray, "tx chirps"]) -> list[Part]:
    """Parts of the table: all TX at once where delays factorise, else each TX alone."""
    all_tx = range(len(array.tx_m))
    parts = []
    if len(paths.scattered):
        if np.all(times == times[0]):
            parts.append(Part(paths.scattered, slice(0, len(all_tx)), times[0]))
        else:  # TDM: the targets have moved on when the next TX sends
            parts += [Part(paths.scattered, slice(i, i + 1), times[i]) for i in all_tx]
    if len(paths.specular):
        parts += [Part(paths.specular.as_scattered(array.tx[i]), slice(i, i + 1), times[i]) for i in all_tx]
    return parts


def rx_blocks(array: AntennaArray, bandwidth_hz: float) -> list[slice]:
    """RX in their order, cut so that no block is wider than BLOCK_REACH_BINS to either side of its centre."""
    rx = array.rx
    blocks, first = [], 0
    for last in range(1, len(rx) + 1):
        if last == len(rx) or reach_bins(rx[first : last + 1], bandwidth_hz) > BLOCK_REACH_BINS:
            blocks.append(slice(first, last))
            first = last
    return blocks


def reach_m(elements: Float64[np.ndarray, "elements 3"]) -> float:
    """Largest distance from the elements' centre [m]."""
    return float(np.linalg.norm(elements - centre(elements), axis=1).max())


def reach_bins(elements: Float64[np.ndarray, "elements 3"], bandwidth_hz: float) -> float:
    """Largest distance from the elements' centre, as a delay in range bins."""
    return reach_m(elements) * bandwidth_hz / SPEED_OF_LIGHT


def centre(elements: Float64[np.ndarray, "elements 3"]) -> Float64[np.ndarray, " 3"]:
    """Middle of the box around the elements [m]."""
    return 0.5 * (elements.min(axis=0) + elements.max(axis=0))
