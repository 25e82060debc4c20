"""What the user asked for: a frozen value that the command line builds and the pipeline obeys; and paths traced before:
which frame and scene each row is, and what may be simulated of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from pydantic import BaseModel

from datafactory.defaults import DEFAULT_BUDGET_DB, DEFAULT_PATTERN, DEFAULT_RAYS
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
class Traced:
    """What a folder that ``datafactory trace`` wrote says of its frames together.

    :param split: pattern that they were traced with; None where its manifest says none
    :param rays: of a frame
    :param entries: the manifest's ``scenes``
    :param checksums: SHA-256 of the shards
    """

    split: str | None
    rays: int
    entries: list[dict[str, Any]]
    checksums: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Order(Wanted):
    """What the user asked for: which frames, of what, and how they are made.

    :param scenes: ``--scene`` arguments, or scenes that were read before
    :param traced: of the folder that ``stored`` lies in, instead of scenes
    :param settings: how a frame is made, with every effect
    :param effects: what is simulated of the scenes; None for what each frame calls for
    :param budget_db: what leaving effects out of a frame may change then
    :param licence: of the data, an SPDX expression; None where none is stated
    """

    radar: Radar
    scenes: tuple[str | Scene, ...] = ()
    traced: Traced | None = None
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


class _Radar(BaseModel):
    front_end: dict[str, Any]


class _Trace(BaseModel):
    rays: int = DEFAULT_RAYS


class _Arguments(BaseModel):
    radar: _Radar
    effects: tuple[str, ...]
    split: str | None = None
    trace: _Trace = _Trace()
    poses: list[Any] = []
    tracks: list[Any] = []


class _Manifest(BaseModel):
    """What rendering needs to know of a manifest of traced paths."""

    arguments: _Arguments
    scenes: list[dict[str, Any]]


def stored_paths(
    folder: Location, radar: Radar, split: str | None, effects: EffectSet | None
) -> tuple[Traced, tuple[StoredRow, ...]]:
    """A folder of traced paths: what it says of them, and the row of every frame, by frame index.

    :param split: pattern that is asked for; None for that of the trace
    :param effects: that are asked for; None for those that the paths were traced with
    :raises InputError: a folder without traced paths, of another version or polarisation, or whose paths were traced
        with other regions or without the effects that are asked for
    """
    path, manifest = folder / MANIFEST, read_manifest(folder)
    records = [record for record in shard_records(path, manifest) if record.path.startswith(f"{PATHS}/")]
    if not records:
        raise InputError(folder, "holds no traced paths", "a folder written by datafactory trace")
    understood = validated(_Manifest, manifest, path)
    arguments = understood.arguments
    _require_same_regions(folder, arguments, split or arguments.split or DEFAULT_PATTERN)
    for end in ("tx_polarization", "rx_polarization"):
        before, wanted = arguments.radar.front_end.get(end, "V"), getattr(radar.front_end, end)
        if before != wanted:
            problem = f"paths were traced with {end} = {before!r}, the radar has {wanted!r}"
            raise InputError(folder, problem, "the same polarisation, or datafactory trace with this radar")
    if effects is not None:
        _require_same_paths(folder, EffectSet.of(set(arguments.effects)), effects)
    rows = _rows(folder, records, len(understood.scenes))
    checksums = tuple(record.sha256 for record in records)
    return Traced(arguments.split, arguments.trace.rays, manifest["scenes"], checksums), rows


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


def _require_same_regions(folder: Location, arguments: _Arguments, split: str) -> None:
    """Drawn poses stand in the region of their frame's split: another split would test where was trained."""
    traced = arguments.split
    if not (arguments.poses or arguments.tracks) and traced != split:
        problem = f"{split!r}: the poses of {folder} were drawn in the regions of {traced!r}, and would change sides"
        raise InputError("--split", problem, f"--split {traced}, or datafactory trace with this split")


def _require_same_paths(folder: Location, traced: EffectSet, asked: EffectSet) -> None:
    """Which paths there are was settled when they were traced."""
    for name in PATH_EFFECTS:
        if getattr(traced, name) != getattr(asked, name):
            had, wants = ("with", "without") if getattr(traced, name) else ("without", "with")
            problem = f"its paths were traced {had} {name}, --effects asks for frames {wants} it"
            raise InputError(folder, problem, "--effects auto, or datafactory trace with these effects")
