"""Draws of a city. All of its chances come from one generator, in a fixed order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def drawn(rng: np.random.Generator, weights: Sequence[tuple[str, float]]) -> str:
    """One of the names, by weight."""
    at = rng.random() * sum(weight for _, weight in weights)
    for name, weight in weights:
        at -= weight
        if at < 0.0:
            return name
    return weights[-1][0]
