"""What a frame is by default: constants alone, so that ``--help`` imports nothing that computes."""

from __future__ import annotations

DEFAULT_PATTERN = "6:1:1"
"""Of the splits: train:validation:test."""

DEFAULT_BUDGET_DB = -30.0
"""What leaving an effect out may change [dB of the peak]."""

IMAGE_BATCH = 16
"""Frames imaged together: twice as many would save a tenth of the time, for 200 MB more."""
