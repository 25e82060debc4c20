"""What options are by default, and their limits: constants alone, so that ``--help`` imports nothing that computes."""

from __future__ import annotations

DEFAULT_RADAR = "avr-qdm-110"
"""A name of :data:`shared.radar.PRESETS`."""

LARGEST_SEED = 2**63 - 1
"""Seeds are stored as int64."""

STORES = ("range-channel", "range-doppler", "cube")
"""What can be kept of a frame, see :func:`shared.dataset.description`."""

ANGLE_WINDOWS = ("none", "taylor-25", "taylor-30", "hann")
"""Windows over the virtual sensor's elements that the truth can be made with."""
