"""What options are by default, and their limits: constants alone, so that ``--help`` imports nothing that computes."""

from __future__ import annotations

DEFAULT_RADAR = "avr-qdm-110"
"""A name of :data:`shared.radar.PRESETS`."""

LARGEST_SEED = 2**63 - 1
"""Seeds are stored as int64."""
