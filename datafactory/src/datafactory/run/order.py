"""What the user asked for: a frozen value that the command line builds and the pipeline obeys; and paths traced before:
which frame and scene each row is, and what may be simulated of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from pydantic import BaseModel

from datafactory.defaults import DEFAULT_BUDGET_DB, DEFAULT_RAYS
from datafactory.effects.catalogue import ALL, PATH_EFFECTS, EffectSet
from datafactory.frame.chain import ChainSettings
from datafactory.frame.deal import StoredRow, Wanted
from datafactory.paths.storage import read_places
from datafactory.run.shards import PATHS
from datafactory.scenes.scene import Scene
from shared.dataset.locations import Location
from shared.dataset.manifest import MANIFEST, ShardRecord, read_manifest, shard_records
from shared.physics.errors import InputError
from shared.radar import Radar, validated


@dataclass(frozen=True)
class TracedFolder:
    """A folder that ``datafactory trace`` wrote, its manifest read.

    :param split: pattern that its paths were traced with; None where the manifest says nothing of the kind
    :param rays: of a frame that they were traced with, or the usual number where it says nothing of the kind
    """

    folder: Location
    manifest: dict[str, Any]

    @staticmethod
    def opened(folder: Location) -> TracedFolder:
        """:raises InputError: no manifest there, or a damaged one"""
        return TracedFolder(folder, read_manifest(folder))

    @property
    def split(self) -> str | None:
        split = self._argument("split")
        return split if isinstance(split, str) else None

    @property
    def rays(self) -> int:
        trace = self._argument("trace")
        rays = trace.get("rays") if isinstance(trace, dict) else None
        return rays if isinstance(rays, int) else DEFAULT_RAYS

    def _argument(self, name: str) -> Any:
        arguments = self.manifest.get("arguments")
        return arguments.get(name) if isinstance(arguments, dict) else None


@dataclass(frozen=True, kw_only=True)
class Order(Wanted):
    """What the user asked for: which frames, of what, and how they are made.

    :param scenes: ``--scene`` arguments, or scenes that were read before
    :param traced: folder of :func:`datafactory.run.pipeline.trace_paths`, instead of scenes
    :param settings: how a frame is made, with every effect
    :param effects: what is simulated of the scenes; None for what each frame calls for
    :param budget_db: what leaving effects out of a frame may change then
    :param licence: of the data, an SPDX expression; None where none is stated
    """

    radar: Radar
    scenes: tuple[str | Scene, ...] = ()
    traced: TracedFolder | None = None
    settings: ChainSettings = field(default_factory=ChainSettings)
    effects: EffectSet | None = None
    budget_db: float = DEFAULT_BUDGET_DB
    licence: str | None = None

    @property
    def of_scenes(self) -> ChainSettings:
        """How scene frames are made: with what was chosen, or with what each calls for by the budget."""
        if self.effects is not None:
            return self.effects.settings(self.settings)
        every = ALL.settings(self.settings)
        return replace(every, budget_db=self.budget_db, below_noise=self.settings.processing.noise)


@dataclass(frozen=True)
class StoredPaths:
    """A folder of traced paths.

    :param rows: of every frame, by frame index
    :param entries: the manifest's ``scenes``
    :param checksums: SHA-256 of the shards
    """

    rows: tuple[StoredRow, ...]
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
    understood = validated(_Traced, manifest, folder / MANIFEST)
    traced, entries = understood.arguments.radar.front_end, manifest["scenes"]
    _require_same_regions(folder, manifest["arguments"], order.split)
    for end in ("tx_polarization", "rx_polarization"):
        before, wanted = traced.get(end, "V"), getattr(order.radar.front_end, end)
        if before != wanted:
            problem = f"paths were traced with {end} = {before!r}, the radar has {wanted!r}"
            raise InputError(folder, problem, "the same polarisation, or datafactory trace with this radar")
    if order.effects is not None:
        _require_same_paths(folder, EffectSet.of(set(understood.arguments.effects)), order.effects)
    rows = _rows(folder, records, len(entries))
    return StoredPaths(rows, entries, tuple(record.sha256 for record in records))


def _rows(folder: Location, records: Sequence[ShardRecord], scenes: int) -> tuple[StoredRow, ...]:
    """The row of every frame index: it says itself which frame it is, of which scene and sequence."""
    found: dict[int, StoredRow] = {}
    for record in records:
        shard = folder / record.path
        for row, (frame_id, scene, sequence) in enumerate(read_places(shard)):
            if not 0 <= scene < scenes:
                raise InputError(shard, f"row {row} has scene_number = {scene}", f"one of the {scenes} of {MANIFEST}")
            if frame_id in found:
                raise InputError(shard, f"row {row} has frame_id = {frame_id}, as another row", "each frame once")
            found[frame_id] = StoredRow(shard, row, scene, sequence)
    if sorted(found) != list(range(len(found))):
        missing = min(set(range(len(found))) - set(found))
        raise InputError(folder, f"frame {missing} of its {len(found)} is missing", "all frames of one trace")
    return tuple(found[frame_id] for frame_id in range(len(found)))


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
