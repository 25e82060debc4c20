"""What a frame is by default: constants alone, so that ``--help`` imports nothing that computes."""

from __future__ import annotations

DEFAULT_PATTERN = "6:1:1"
"""Of the splits: train:validation:test."""

DEFAULT_BUDGET_DB = -30.0
"""What leaving an effect out may change [dB of the peak]."""

IMAGE_BATCH = 16
"""Frames imaged together: twice as many would save a tenth of the time, for 200 MB more."""

SMALLEST_BUDGET_DB, LARGEST_BUDGET_DB = -120.0, -1.0
"""What can be asked for: complex64, in which signals are stored, rounds at -138 dB."""

DEFAULT_FRAMES = 8
"""Scene frames of a run that states neither their number nor poses."""
