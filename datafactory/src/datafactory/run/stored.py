"""Paths traced before: which frame and scene each row is, and what may be simulated of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ValidationError

from datafactory.effects.catalogue import PATH_EFFECTS, EffectSet
from datafactory.paths.storage import read_places
from datafactory.run.order import Order, TracedFolder
from datafactory.run.shards import PATHS
from shared.dataset.locations import Location
from shared.dataset.manifest import MANIFEST, ShardRecord, shard_records
from shared.physics.errors import InputError
from shared.radar import first_validation_error


@dataclass(frozen=True)
class StoredPaths:
    """A folder of traced paths.

    :param places: shard and row of every frame, by frame index
    :param scene_numbers: number of the scene of every frame, as its row says
    :param sequences: number of the sequence of every frame, likewise; -1 for none
    :param entries: the manifest's ``scenes``
    :param checksums: SHA-256 of the shards
    """

    places: tuple[tuple[Location, int], ...]
    scene_numbers: tuple[int, ...]
    sequences: tuple[int, ...]
    entries: list[dict[str, Any]]
    checksums: tuple[str, ...]


class _Radar(BaseModel):
    front_end: dict[str, Any]


class _Arguments(BaseModel):
    radar: _Radar
    effects: tuple[str, ...]


class _Traced(BaseModel):
    """What rendering needs to know of a manifest of traced paths."""

    arguments: _Arguments


def stored_paths(order: Order, traced_folder: TracedFolder) -> StoredPaths:
    """The paths of a folder, with the effects that they were traced with, or those asked for where they hold them.

    :raises InputError: a folder without traced paths, of another version or polarisation, or whose paths were traced
        without what ``order.effects`` asks for
    """
    folder, manifest = traced_folder.folder, traced_folder.manifest
    all_records = shard_records(folder / MANIFEST, manifest)
    records = [record for record in all_records if record.path.startswith(f"{PATHS}/")]
    if not records:
        raise InputError(folder, "holds no traced paths", "a folder written by datafactory trace")
    try:
        understood = _Traced.model_validate(manifest)
    except ValidationError as error:
        raise InputError(folder / MANIFEST, *first_validation_error(error)) from error
    traced, entries = understood.arguments.radar.front_end, manifest["scenes"]
    _require_same_regions(folder, manifest["arguments"], order.split)
    for field in ("tx_polarization", "rx_polarization"):
        before, wanted = traced.get(field, "V"), getattr(order.radar.front_end, field)
        if before != wanted:
            problem = f"paths were traced with {field} = {before!r}, the radar has {wanted!r}"
            raise InputError(folder, problem, "the same polarisation, or datafactory trace with this radar")
    if order.effects is not None:
        _require_same_paths(folder, EffectSet.of(set(understood.arguments.effects)), order.effects)
    places, scene_numbers, sequences = _places(folder, records, len(entries))
    return StoredPaths(places, scene_numbers, sequences, entries, tuple(record.sha256 for record in records))


def _places(
    folder: Location, records: Sequence[ShardRecord], scenes: int
) -> tuple[tuple[tuple[Location, int], ...], tuple[int, ...], tuple[int, ...]]:
    """Shard and row, scene number and sequence of every frame index: the rows say it."""
    found: dict[int, tuple[tuple[Location, int], int, int]] = {}
    for record in records:
        shard = folder / record.path
        for row, (frame_id, scene, sequence) in enumerate(read_places(shard)):
            if not 0 <= scene < scenes:
                raise InputError(shard, f"row {row} has scene_number = {scene}", f"one of the {scenes} of {MANIFEST}")
            if frame_id in found:
                raise InputError(shard, f"row {row} has frame_id = {frame_id}, as another row", "each frame once")
            found[frame_id] = ((shard, row), scene, sequence)
    if sorted(found) != list(range(len(found))):
        missing = min(set(range(len(found))) - set(found))
        raise InputError(folder, f"frame {missing} of its {len(found)} is missing", "all frames of one trace")
    ordered = [found[frame_id] for frame_id in range(len(found))]
    places, scene_numbers, sequences = zip(*ordered, strict=True)
    return places, scene_numbers, sequences


def _require_same_regions(folder: Location, arguments: dict[str, Any], split: str) -> None:
    """Drawn poses stand in the region of their frame's split: another split would test where was trained."""
    traced = arguments.get("split")
    if not (arguments.get("poses") or arguments.get("tracks")) and traced != split:
        problem = f"{split!r}: the poses of {folder} were drawn in the regions of {traced!r}, and would change sides"
        raise InputError("--split", problem, f"--split {traced}, or datafactory trace with this split")


def _require_same_paths(folder: Location, traced: EffectSet, asked: EffectSet) -> None:
    """Which paths there are was settled when they were traced."""
    for name in PATH_EFFECTS:
        if getattr(traced, name) != getattr(asked, name):
            had, wants = ("with", "without") if getattr(traced, name) else ("without", "with")
            problem = f"its paths were traced {had} {name}, --effects asks for frames {wants} it"
            raise InputError(folder, problem, "--effects auto, or datafactory trace with these effects")
