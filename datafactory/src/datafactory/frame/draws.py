"""What follows from a frame's number alone: its seeds and streams, its split, and the scene that it stands in.

A frame's streams depend on (dataset seed, frame index) alone, so that frame 17 is the same whether it is rendered
alone, first, last, by one worker or by eight. Each purpose has one of its own: adding a purpose does not change the
others.
"""

from __future__ import annotations

import math

import numpy as np

from datafactory.defaults import DEFAULT_PATTERN
from shared.dataset.folder import SPLITS, Split
from shared.physics.errors import InputError

PURPOSES = ("pose", "rays", "targets", "noise", "traffic")
SEQUENCES = 1
"""First spawn key of sequences; those of frames have one number alone."""


def frame_seed(dataset_seed: int, frame_id: int) -> int:
    """The frame's own seed, a non-negative int64 as the ``seed`` column holds it."""
    return _seed(dataset_seed, frame_id)


def sequence_seed(dataset_seed: int, sequence: int) -> int:
    """Of what the frames of a sequence have in common; no frame's own seed."""
    return _seed(dataset_seed, SEQUENCES, sequence)


def _seed(dataset_seed: int, *key: int) -> int:
    child = np.random.SeedSequence(entropy=dataset_seed, spawn_key=key)
    return int(child.generate_state(1, np.uint64)[0] >> np.uint64(1))


def generator(seed: int, purpose: str) -> np.random.Generator:
    """The stream of one purpose in a frame with this seed."""
    return np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(PURPOSES.index(purpose),)))


def parse_split_pattern(pattern: str) -> tuple[int, int, int]:
    """The three numbers of a split pattern A:B:C.

    :raises InputError: a pattern that is not three whole numbers with a positive sum
    """
    parts = pattern.split(":")
    if len(parts) != 3 or not all(part.isascii() and part.isdigit() for part in parts) or not any(map(int, parts)):
        raise InputError("--split", f"{pattern!r}", "train:validation:test as three whole numbers, e.g. 6:1:1 or 1:0:0")
    train, validation, test = map(int, parts)
    return train, validation, test


def split_of(frame_id: int, pattern: str = DEFAULT_PATTERN) -> Split:
    """Split of a frame under a pattern A:B:C: the first A of every A + B + C frames are train, and so on.

    :raises InputError: see :func:`parse_split_pattern`
    """
    train, validation, test = parse_split_pattern(pattern)
    place = frame_id % (train + validation + test)
    return SPLITS[(place >= train) + (place >= train + validation)]


def drawn_scene(frame_id: int, scenes: int, pattern: str = DEFAULT_PATTERN) -> int:
    """Scene of a frame whose pose is drawn: in turn, so that every split has frames of every scene.

    Four scenes in turn under eight splits in turn would meet always alike: all test frames in the last scene. Where the
    two numbers have a common divisor, the turn begins one scene later each time that both have come round.

    :param scenes: their number
    :param pattern: see :func:`split_of`
    """
    splits = sum(parse_split_pattern(pattern))
    rounds = frame_id // math.lcm(scenes, splits) if math.gcd(scenes, splits) > 1 else 0
    return (frame_id + rounds) % scenes
