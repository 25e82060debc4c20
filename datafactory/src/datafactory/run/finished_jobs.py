"""The jobs of an array as a merge finds them: whether they belong together, and whether no frame is missing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from datafactory.run.array_job import ARGUMENT, ENTRY, ArrayJob, JobEntry, is_job_folder, parse_job
from datafactory.run.progress import FinishedShard, fingerprint, first_difference, is_begun
from datafactory.run.shards import ShardPlan
from shared.dataset.folder import MANIFEST
from shared.dataset.manifest import ShardRecord, read_manifest, shard_records
from shared.physics.errors import InputError
from shared.radar import first_validation_error

MOST_RANGES = 12
"""Ranges of missing frames that are named."""


@dataclass(frozen=True)
class FinishedJob:
    """A job that is done.

    :param entry: what its manifest says of the whole
    :param records: of its shards
    :param manifest: the whole of it
    """

    folder: Path
    job: ArrayJob
    entry: JobEntry
    records: tuple[ShardRecord, ...]
    manifest: dict[str, Any]

    @property
    def arguments(self) -> dict[str, Any]:
        """Those of the run in one piece."""
        return {name: value for name, value in self.manifest["arguments"].items() if name != ARGUMENT}

    def shards(self) -> Iterator[FinishedShard]:
        """Its shards, as a run in one piece would note them."""
        mark = fingerprint(self.arguments)
        for record, counts in zip(self.records, self.entry.counts, strict=True):
            yield FinishedShard(record=record, counts=counts, fingerprint=mark)


def find_jobs(folders: Sequence[Path]) -> tuple[list[FinishedJob], list[Path]]:
    """The finished jobs, by their numbers, and the folders of those that were begun.

    :param folders: each that of a job, or one in which jobs have theirs
    :raises InputError: a folder without jobs, a manifest that is damaged or not of a job, no finished job
    """
    finished, begun = [], []
    for folder in folders:
        for path in _job_folders(folder):
            if (path / MANIFEST).is_file():
                finished.append(_read(path))
            else:
                begun.append(path)
    if not finished:
        raise InputError(folders[0], "no job in it is finished", "the --out of jobs of an array that are done")
    return sorted(finished, key=lambda item: (item.job.of, item.job.number)), begun


def require_same_arguments(jobs: Sequence[FinishedJob]) -> None:
    """Refuse jobs that are not of one dataset.

    :raises InputError: naming the first argument that differs
    """
    first, *others = jobs
    for other in others:
        if different := first_difference(first.arguments, other.arguments):
            name, had, has = different
            raise InputError(
                other.folder, f"{name} is {has}; {first.folder} has {had}", "jobs with the same arguments but --shard"
            )


def shards_of_all(
    jobs: Sequence[FinishedJob], begun: Sequence[Path]
) -> dict[ShardPlan, tuple[FinishedJob, FinishedShard]]:
    """Every shard of the dataset in its order, and the job that made it.

    A shard that two jobs made, because the array was cut in another way in between, is taken once.

    :raises InputError: frames are missing; two jobs made a shard with other bytes
    """
    made: dict[str, tuple[FinishedJob, FinishedShard]] = {}
    for job in jobs:
        for shard in job.shards():
            before = made.setdefault(shard.record.path, (job, shard))
            if before[1].record != shard.record:
                problem = f"{shard.record.path} is not the file of this name in {before[0].folder}"
                raise InputError(job.folder, problem, "jobs that ran on one kind of machine")
    plans = jobs[0].entry.plans()
    if missing := [plan for plan in plans if plan.path not in made]:
        raise _incomplete(missing, jobs, begun)
    return {plan: made[plan.path] for plan in plans}


def _job_folders(folder: Path) -> list[Path]:
    """:raises InputError: none"""
    if not folder.is_dir():
        raise InputError(folder, "no such folder", "the --out of jobs of an array")
    if (folder / MANIFEST).is_file() or is_begun(folder):
        return [folder]
    found = sorted(path for path in folder.iterdir() if path.is_dir() and is_job_folder(path.name))
    if not found:
        raise InputError(folder, "holds no job", "the --out of a render, points or trace with --shard")
    return found


def _read(folder: Path) -> FinishedJob:
    path, manifest = folder / MANIFEST, read_manifest(folder)
    arguments = manifest.get("arguments")
    if not isinstance(arguments, dict) or ENTRY not in manifest or not isinstance(arguments.get(ARGUMENT), str):
        raise InputError(path, "is not of a job of an array", "the --out of a render, points or trace with --shard")
    try:
        entry = JobEntry.model_validate(manifest[ENTRY])
    except ValidationError as error:
        raise InputError(path, *first_validation_error(error)) from error
    records = shard_records(path, manifest)
    if len(entry.counts) != len(records):
        raise InputError(path, f"counts of {len(entry.counts)} shards for {len(records)}", "one for each shard")
    return FinishedJob(folder, parse_job(arguments[ARGUMENT]), entry, records, manifest)


def _incomplete(missing: Sequence[ShardPlan], jobs: Sequence[FinishedJob], begun: Sequence[Path]) -> InputError:
    frames = sorted(frame_id for plan in missing for frame_id in plan.frame_ids)
    there = {str(item.job) for item in jobs}
    absent = [
        str(ArrayJob(number, of))
        for of in sorted({item.job.of for item in jobs})
        for number in range(of)
        if f"{number}/{of}" not in there and ArrayJob(number, of).folder not in {path.name for path in begun}
    ]
    why = [f"{path} is not finished" for path in begun] + [f"job {name} is not there" for name in absent]
    problem = f"frames {ranges(frames)} are missing ({len(frames)} of {jobs[0].entry.frames}): {_listed(why, ', ')}"
    return InputError("merge", problem, "all jobs finished: begin those again, with --resume where they were begun")


def ranges(numbers: Iterable[int]) -> str:
    """Rising numbers as ``0-5, 8, 16-21``, the first of them."""
    found: list[list[int]] = []
    for number in numbers:
        if found and number == found[-1][1] + 1:
            found[-1][1] = number
        else:
            found.append([number, number])
    return _listed([str(first) if first == last else f"{first}-{last}" for first, last in found], ", ")


def _listed(items: Sequence[str], between: str) -> str:
    more = len(items) - MOST_RANGES
    return between.join(items[:MOST_RANGES]) + (f"{between}and {more} more" if more > 0 else "")
