"""Randomness: one dataset seed, one stream a frame, one stream a purpose.

A frame's streams depend on (dataset seed, frame index) alone, so that frame 17 is the same whether it is rendered
alone, first, last, by one worker or by eight; and adding a purpose does not change the others.
"""

from __future__ import annotations

import numpy as np

PURPOSES = ("pose", "rays", "targets", "noise", "traffic")
SEQUENCES = 1
"""First spawn key of sequences; those of frames have one number alone."""


def frame_seed(dataset_seed: int, frame_id: int) -> int:
    """The frame's own seed, a non-negative int64 as the ``seed`` column holds it."""
    sequence = np.random.SeedSequence(entropy=dataset_seed, spawn_key=(frame_id,))
    return int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(1))


def sequence_seed(dataset_seed: int, sequence: int) -> int:
    """Of what the frames of a sequence have in common; no frame's own seed."""
    child = np.random.SeedSequence(entropy=dataset_seed, spawn_key=(SEQUENCES, sequence))
    return int(child.generate_state(1, np.uint64)[0] >> np.uint64(1))


def generator(seed: int, purpose: str) -> np.random.Generator:
    """The stream of one purpose in a frame with this seed."""
    return np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(PURPOSES.index(purpose),)))
