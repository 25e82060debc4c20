"""What options are by default, and their limits: constants alone, so that ``--help`` imports nothing that computes."""

from __future__ import annotations

DEFAULT_RADAR = "avr-qdm-110"
"""A name of :data:`shared.radar.PRESETS`."""

BOARD_NAMES = ("iwr1443", "iwr1642", "iwr1843", "awr2944", "mmwcas", "mmwcas-azimuth")
"""Of :data:`shared.radar.boards.BOARDS`."""

LARGEST_SEED = 2**63 - 1
"""Seeds are stored as int64."""

STORES = ("range-channel", "range-doppler", "cube")
"""What can be kept of a frame, see :func:`shared.dataset.description`."""

ANGLE_WINDOWS = ("none", "taylor-25", "taylor-30", "hann")
"""Windows over the virtual sensor's elements that the truth can be made with."""

TRUTH_WINDOW = "taylor-30"
"""Of these, the one that truths are made with where none is stated."""
