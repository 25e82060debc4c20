"""What is in a dataset, in numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from shared.dataset.folder import MANIFEST, Dataset
from shared.physics.errors import InputError


@dataclass(frozen=True)
class Summary:
    """The numbers of a dataset.

    :param frames: (split, kind) to number of frames; empty for a folder of traced paths alone
    :param scenes: scene name to number of frames
    :param sequences: number of sequences of frames along a track
    :param traced: frames whose traced paths are stored
    :param radar: its name; "" where there are no frames
    :param shapes: array columns and their shapes
    :param shards: number of shards
    :param bytes: size of all shards
    :param counts: what the manifest counted, e.g. what was left out
    """

    frames: dict[tuple[str, str], int]
    scenes: dict[str, int]
    sequences: int
    traced: int
    radar: str
    shapes: dict[str, list[int]]
    shards: int
    bytes: int
    counts: Mapping[str, Any]

    def to_json(self) -> dict[str, Any]:
        """What ``datafactory inspect --json`` prints: ``frames`` by split, then by kind; the rest as it stands here."""
        by_split: dict[str, dict[str, int]] = {}
        for (split, kind), count in self.frames.items():
            by_split.setdefault(split, {})[kind] = count
        return {**vars(self), "frames": by_split, "counts": dict(self.counts)}


def summarise(dataset: Dataset) -> Summary:
    """Count a dataset's frames; only the columns of a few bytes are read.

    :raises InputError: a shard that is damaged
    """
    kinds: Counter[tuple[str, str]] = Counter()
    scenes: Counter[str] = Counter()
    sequences: set[int] = set()
    for split in dataset.splits:
        for frame in dataset.frames(split, columns=()):
            kinds[split, frame.kind] += 1
            scenes[frame.scene] += 1
            sequences.add(frame.sequence)
    counts = dataset.manifest.get("counts", {})
    if not isinstance(counts, dict):
        raise InputError(dataset.path / MANIFEST, f"counts = {counts!r}", "a number for each thing counted")
    description: dict[str, Any] = dataset.description() if dataset.splits else {"radar": {"name": ""}, "shapes": {}}
    return Summary(
        frames=dict(kinds),
        scenes=dict(scenes),
        sequences=len(sequences - {-1}),
        traced=sum(record.rows for record in dataset.records if record.path.startswith("paths/")),
        radar=description["radar"]["name"],
        shapes=description["shapes"],
        shards=len(dataset.records),
        bytes=sum(record.bytes for record in dataset.records),
        counts=counts,
    )
