"""How many rays a frame has by default: a constant alone, so that ``--help`` imports nothing that computes."""

from __future__ import annotations

DEFAULT_RAYS = 200_000
"""Three times as many, with which half of the cells within 30 m have five paths, take 1.6 times the time of a frame
(docs/speckle.md)."""
