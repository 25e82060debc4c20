"""What a run has finished so far, beside the shards: ``DIR/.progress`` while it lasts, and that of a job for its
merge; the manifest after it.

Each finished shard leaves ``DIR/.progress/<split>-part-NNNNN.json``, written after the shard was renamed; a run that is
killed and resumed ends in the same bytes as one that never was.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from datafactory.run.card import CARD, card
from datafactory.run.shards import ENTRY, ShardPlan
from shared.dataset.claims import claimed as hold
from shared.dataset.documents import read_json, sealed, unsealed
from shared.dataset.folder import MANIFEST, ShardRecord, read_manifest
from shared.dataset.locations import Location, file_names, file_size
from shared.dataset.manifest import shard_records, write_manifest
from shared.dataset.stores import objects_under
from shared.dataset.writing import is_as_recorded, remove_folder, remove_partial, scratch, write_json, write_text
from shared.physics.errors import InputError

Item = TypeVar("Item")
Value = TypeVar("Value")

FOLDER = ".progress"
ARGUMENTS = "arguments.json"
ASKED_AT_A_TIME = 16
"""Shards that a store is asked for at a time: an answer takes it tens of milliseconds."""
LONGEST_VALUE = 200
"""Characters of an argument that are shown."""


class FinishedShard(BaseModel, frozen=True, extra="forbid"):
    """A shard that is whole.

    :param record: its entry in the manifest
    :param counts: what its frames counted (rays, targets left out, ...), added up in the manifest
    :param fingerprint: of the arguments it was made with, see :func:`shared.dataset.documents.digest`
    """

    record: ShardRecord
    counts: dict[str, int | float]
    fingerprint: str


@dataclass(frozen=True)
class KeptShards:
    """What a resumed run need not do again.

    :param shards: finished shards whose size and SHA-256 are still right, see :func:`is_as_recorded`
    :param damaged: paths of shards that were recorded but are missing or changed, and will be made again
    """

    shards: dict[ShardPlan, FinishedShard]
    damaged: tuple[str, ...]


@contextmanager
def claimed(directory: Location, resume: bool) -> Iterator[None]:
    """Hold the dataset's folder for one run, from before any work is done until it is over.

    A folder that was made for this and that nothing came into is removed again.

    :param resume: take up an unfinished run in this folder
    :raises InputError: a folder that is not writable, that another process works in, or that is not empty where there
        is nothing to resume
    """

    def check() -> None:
        if not resume and _has_content(directory):
            raise InputError("--out", f"{directory} is not empty", "an empty or new folder, or --resume")

    with hold(directory, directory / FOLDER, "--out", check):
        yield


def begin(directory: Location, arguments: Mapping[str, Any], resume: bool) -> bool:
    """Begin a run in a claimed folder, or take one up.

    :param arguments: those that determine the bytes, as JSON values by the names that the user knows; the manifest's
        ``arguments`` must be the same mapping
    :param resume: take up an unfinished run in this folder
    :returns: True if an earlier run with these arguments has already finished the dataset
    :raises InputError: with ``resume`` a folder that holds something else, or a run with other arguments; a finished
        dataset whose shards are not as its manifest says: what each had counted is not kept
    """
    progress = directory / FOLDER
    if file_size(directory / MANIFEST) is not None:
        manifest = read_manifest(directory)
        _same_arguments(directory / MANIFEST, directory, manifest.get("arguments"), arguments)
        _require_shards(directory, shard_records(directory / MANIFEST, manifest))
        _remove_notes(directory, manifest)  # it may have been killed before it did
        return True
    if file_size(progress / ARGUMENTS) is not None:
        before = read_json(progress / ARGUMENTS, "an unfinished run; start again in a new folder")
        _same_arguments(progress / ARGUMENTS, directory, before, arguments)
    elif resume and _has_content(directory):
        raise InputError("--out", f"{directory} is not empty and holds no unfinished run", "an empty or new folder")
    remove_partial(directory)
    write_json(progress / ARGUMENTS, arguments)
    return False


def is_begun(directory: Location) -> bool:
    """Whether a run was begun in a folder, and is not finished."""
    return file_size(directory / FOLDER / ARGUMENTS) is not None


@contextmanager
def handed_over(directory: Location) -> Iterator[Path]:
    """A folder on this machine for what workers are given and hand over: empty, and removed at the end of the block."""
    folder = (directory / FOLDER if isinstance(directory, Path) else scratch(directory)) / "workers"
    shutil.rmtree(folder, ignore_errors=True)  # of a run that was killed
    folder.mkdir(parents=True, mode=0o700)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _has_content(directory: Location) -> bool:
    """Whether a folder holds anything but a claim."""
    if isinstance(directory, Path):
        return any(item.name != FOLDER for item in directory.iterdir()) or is_begun(directory)
    begun = f"{FOLDER}/{ARGUMENTS}"
    return any(not name.startswith(f"{FOLDER}/") or name == begun for name in objects_under(directory))


def record_finished(directory: Location, plan: ShardPlan, finished: FinishedShard) -> None:
    """Note a shard as finished, after it was written."""
    write_json(_note(directory, plan), sealed(finished.model_dump()))


def completed(directory: Location, plans: Iterable[ShardPlan], fingerprint: str) -> KeptShards:
    """The shards of ``plans`` that an earlier run finished, each checked by its size and SHA-256."""
    noted = set(file_names(directory / FOLDER))
    there = [plan for plan in plans if _note(directory, plan).name in noted]
    found = _of_each(lambda plan: _finished(directory, plan, fingerprint), there, directory)
    shards = {plan: finished for plan, finished in zip(there, found, strict=True) if finished is not None}
    return KeptShards(shards, tuple(plan.path for plan in there if plan not in shards))


def _of_each(function: Callable[[Item], Value], items: Sequence[Item], directory: Location) -> list[Value]:
    """What a function says of each shard of a folder."""
    with ThreadPoolExecutor(1 if isinstance(directory, Path) else ASKED_AT_A_TIME) as pool:
        return list(pool.map(function, items))


def _require_shards(directory: Location, records: Sequence[ShardRecord]) -> None:
    """:raises InputError: shards of a finished dataset that are not as recorded, see :func:`is_as_recorded`"""
    whole = _of_each(lambda item: is_as_recorded(directory / item.path, item.bytes, item.sha256), records, directory)
    damaged = [record.path for record, right in zip(records, whole, strict=True) if not right]
    if damaged:
        more = f", and {len(damaged) - 1} more" if damaged[1:] else ""
        problem = f"{directory} was finished; missing or not as {MANIFEST} says: {damaged[0]}{more}"
        raise InputError("--resume", problem, "shards as they were written, or the run in a new folder")


def _finished(directory: Location, plan: ShardPlan, fingerprint: str) -> FinishedShard | None:
    """A shard that was noted as finished; None where note or shard are not as they were written."""
    note = _note(directory, plan)
    try:
        finished = FinishedShard.model_validate(unsealed(note, read_json(note, "the note of a finished shard")))
    except (InputError, ValidationError):
        return None
    record = finished.record
    if finished.fingerprint != fingerprint:
        return None
    return finished if is_whole(directory / plan.path, plan, record) else None


def finish(directory: Location, manifest: Mapping[str, Any]) -> Location:
    """Write the card of a dataset that holds frames and the manifest, which makes it complete, and remove the notes.

    :returns: the manifest's path
    """
    if "shapes" in manifest and manifest["shards"]:
        write_text(directory / CARD, card(manifest))
    path = write_manifest(directory, manifest)
    _remove_notes(directory, manifest)
    remove_partial(directory)
    return path


def _remove_notes(directory: Location, manifest: Mapping[str, Any]) -> None:
    """Of a finished dataset, but those of a job of an array, which its merge reads."""
    if ENTRY not in manifest:
        remove_folder(directory / FOLDER)


def _note(directory: Location, plan: ShardPlan) -> Location:
    return directory / FOLDER / f"{plan.split}-part-{plan.index:05d}.json"


def is_whole(path: Location, plan: ShardPlan, record: ShardRecord) -> bool:
    """Whether a shard is the one planned, with the size and the SHA-256 of its record, see :func:`is_as_recorded`."""
    if record.path != plan.path or record.rows != len(plan.frame_ids):
        return False
    return is_as_recorded(path, record.bytes, record.sha256)


def _same_arguments(source: Location, directory: Location, before: Any, now: Mapping[str, Any]) -> None:
    """Refuse to mix runs: the first argument that differs, with both values."""
    if not isinstance(before, dict):
        raise InputError(source, f"arguments = {before!r}", "the arguments of the run to resume")
    now = json.loads(json.dumps(now, allow_nan=False))  # tuples read back as lists
    if different := first_difference(before, now):
        name, had, has = different
        values = f"{name} is {has}, but the run in {directory} had {had}"
        raise InputError("--resume", values, "the arguments that it was started with")


def first_difference(
    before: Mapping[str, Any], now: Mapping[str, Any], within: str = ""
) -> tuple[str, str, str] | None:
    """Name of the first entry that differs, ``radar.waveform.chirps`` or ``poses.3.time`` for one in others, and both
    values in short."""
    for name in [*now, *(name for name in before if name not in now)]:
        had, has = before.get(name), now.get(name)
        if isinstance(had, list) and isinstance(has, list) and len(had) == len(has) and _are_nested([*had, *has]):
            had, has = dict(enumerate(had)), dict(enumerate(has))
        if isinstance(had, dict) and isinstance(has, dict):
            if different := first_difference(had, has, f"{within}{name}."):
                return different
        elif had != has or (name in before) != (name in now):
            return f"{within}{name}", _short(before, name), _short(now, name)
    return None


def _are_nested(values: Sequence[Any]) -> bool:
    """Whether all are dictionaries or lists: together they are too long to be shown."""
    return all(isinstance(item, dict | list) for item in values)


def _short(arguments: Mapping[str, Any], name: str) -> str:
    text = repr(arguments[name]) if name in arguments else "nothing"
    return text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 3]}..."
