"""What options are by default, and their limits: constants alone, so that ``--help`` imports nothing that computes."""

from __future__ import annotations

CPU, CUDA, AUTO_DEVICE = "cpu", "cuda", "auto"
DEVICES = (CPU, CUDA)
"""Where frames are traced and their signals made: on the processor, or on an NVIDIA GPU."""
ASKED_DEVICES = (AUTO_DEVICE, *DEVICES)
"""What can be asked for: ``auto`` takes the GPU where everything that a command needs of it is there."""

INSTALL_TORCH = "torch for CUDA: pip install --force-reinstall torch (the public index has it for Linux)"
"""What signals on a GPU need."""

DEFAULT_RAYS = 200_000
"""Three times as many light two thirds of the cells within 30 m by five paths, where these light half, and bring the
error of a cell's power from -29 to -33 dB (docs/notes/speckle.md)."""

MOST_RAYS = 20_000_000
"""See :data:`datafactory.run.memory.RAY_BYTES`."""

DEFAULT_DEPTH = 2
"""Bounces; chains of mirrors have up to :data:`LARGEST_DEPTH`."""

LARGEST_DEPTH = 3
"""Bounces of the longest paths that are followed."""


DEFAULT_PATTERN = "6:1:1"
"""Of the splits: train:validation:test."""

DEFAULT_BUDGET_DB = -30.0
"""What leaving an effect out may change [dB of the peak]."""

IMAGE_BATCH = 8
"""Frames imaged together at most, those of a portion: their images share matrices, which cost as much as eight."""

SMALLEST_BUDGET_DB, LARGEST_BUDGET_DB = -120.0, -1.0
"""What can be asked for: complex64, in which signals are stored, rounds at -138 dB."""

DEFAULT_FRAMES = 8
"""Scene frames of a run that states neither their number nor poses."""


LOCAL, RAY = "local", "ray"
ENGINES = (LOCAL, RAY)
