"""Jobs of an array to the dataset of the run in one piece: ``datafactory merge``.

Jobs have to belong together, and no frame may be missing. A shard is linked where the jobs lie on the same disk, so
that it takes no room, and copied where not. What jobs finished is read as a resumed run reads it
(:mod:`datafactory.run.progress`), and noted again: a merge that was killed is taken up like a run."""

from __future__ import annotations

import os
import shutil
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from datafactory.defaults import LOCAL
from datafactory.run.memory import free_bytes
from datafactory.run.pipeline import Report, total_counts
from datafactory.run.progress import (
    FOLDER,
    FinishedShard,
    begin,
    claimed,
    completed,
    finish,
    first_difference,
    is_begun,
    is_whole,
    record_finished,
)
from datafactory.run.shards import ARGUMENT, ENTRY, ArrayJob, JobEntry, ShardPlan, is_job_folder, parse_job, provenance
from shared.dataset.documents import MADE, digest
from shared.dataset.folder import MANIFEST
from shared.dataset.manifest import read_manifest
from shared.dataset.writing import PARTIAL, atomic
from shared.physics.errors import InputError
from shared.processes.telling import Announce, Progress
from shared.radar import validated

MOST_RANGES = 12
"""Ranges of missing frames that are named."""
OF_JOBS = ("arguments", "counts", "shards", ENTRY, MADE)
"""Entries of a job's manifest that the dataset's has otherwise, or not at all."""


@dataclass(frozen=True)
class FinishedJob:
    """A job that is done.

    :param entry: what its manifest says of the whole
    :param manifest: the whole of it
    """

    folder: Path
    job: ArrayJob
    entry: JobEntry
    manifest: dict[str, Any]

    @property
    def arguments(self) -> dict[str, Any]:
        """Those of the run in one piece."""
        return {name: value for name, value in self.manifest["arguments"].items() if name != ARGUMENT}


Sources = dict[ShardPlan, tuple[FinishedJob, FinishedShard]]
"""Shards, the job that made each, and what this noted of it."""


def find_jobs(folders: Sequence[Path]) -> tuple[list[FinishedJob], list[Path]]:
    """The finished jobs, by their numbers, and the folders of those that were begun.

    :param folders: each that of a job, or one in which jobs have theirs
    :raises InputError: a folder without jobs, a manifest that is damaged or not of a job, no finished job
    """
    finished, begun = [], []
    if not folders:
        raise InputError("DIR", "no folder", "the --out of jobs of an array")
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


def makers(jobs: Sequence[FinishedJob], begun: Sequence[Path]) -> dict[ShardPlan, FinishedJob]:
    """Every shard of the dataset in its order, and a job that made it.

    :raises InputError: frames are missing
    """
    plans = jobs[0].entry.plans()
    found = {plan: job for job in jobs for plan in job.job.own(plans)}
    if missing := [plan for plan in plans if plan not in found]:
        raise _incomplete(missing, jobs, begun)
    return {plan: found[plan] for plan in plans}


def shards_of_all(jobs: Sequence[FinishedJob], todo: Mapping[ShardPlan, FinishedJob], advance: Progress) -> Sources:
    """What the jobs noted of shards, each checked by its SHA-256.

    A shard that two jobs made, because the array was cut in another way in between, is taken once.

    :param todo: shards that are not in the dataset yet, see :func:`makers`
    :raises InputError: shards that are not as their jobs noted them; two jobs made a shard with other bytes
    """
    plans, mark = jobs[0].entry.plans(), digest(jobs[0].arguments)
    made: Sources = {}
    for done, job in enumerate(jobs):
        advance("checking", done, len(jobs))
        own = [plan for plan in job.job.own(plans) if plan in todo]
        for plan, shard in completed(job.folder, own, mark).shards.items():
            first, before = made.setdefault(plan, (job, shard))
            if before.record != shard.record:
                problem = f"{plan.path} is not the file of this name in {first.folder}"
                raise InputError(job.folder, problem, "jobs that ran on one kind of machine")
    advance("checking", len(jobs), len(jobs))
    if damaged := {plan: job for plan, job in todo.items() if plan not in made}:
        names = _listed([str(job.folder / plan.path) for plan, job in damaged.items()])
        remedies = {f"{job.folder} removed and job {job.job} run again" for job in damaged.values()}
        raise InputError("merge", f"missing or not as recorded in {FOLDER}: {names}", " and ".join(sorted(remedies)))
    return made


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
    entry = validated(JobEntry, manifest[ENTRY], path)
    return FinishedJob(folder, parse_job(arguments[ARGUMENT]), entry, manifest)


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
    problem = f"frames {ranges(frames)} are missing ({len(frames)} of {jobs[0].entry.frames}): {_listed(why)}"
    return InputError("merge", problem, "all jobs finished: begin those again, with --resume where they were begun")


def ranges(numbers: Iterable[int]) -> str:
    """Rising numbers as ``0-5, 8, 16-21``, the first of them."""
    found: list[list[int]] = []
    for number in numbers:
        if found and number == found[-1][1] + 1:
            found[-1][1] = number
        else:
            found.append([number, number])
    return _listed([str(first) if first == last else f"{first}-{last}" for first, last in found])


def _listed(items: Sequence[str]) -> str:
    more = len(items) - MOST_RANGES
    return ", ".join(items[:MOST_RANGES]) + (f", and {more} more" if more > 0 else "")


def merge(folders: Sequence[Path], directory: Path, resume: bool, announce: Announce, advance: Progress) -> Report:
    """Join the jobs' shards into one dataset.

    :param folders: each that of a job, or one in which jobs have theirs
    :param directory: of the dataset
    :param resume: take up a merge that was killed
    :param advance: takes what is being done, shards done, and shards in all
    :raises InputError: jobs or frames are missing, arguments differ, shards are damaged, no room; nothing is written
    :raises OSError: the disk fails; what was done can be resumed
    """
    started = time.perf_counter()
    jobs, begun = find_jobs(folders)
    require_same_arguments(jobs)
    plans = makers(jobs, begun)
    arguments, frames = jobs[0].arguments, jobs[0].entry.frames
    with claimed(directory, resume):
        if resume and begin(directory, arguments, resume):
            announce(f"{directory} is already complete")
            return Report(directory, frames, 0, len(plans), {}, time.perf_counter() - started)
        kept = completed(directory, plans, digest(arguments)).shards
        todo = shards_of_all(jobs, {plan: job for plan, job in plans.items() if plan not in kept}, advance)
        _require_room(todo, directory)
        begin(directory, arguments, resume)
        links = 0
        for done, (plan, (job, shard)) in enumerate(todo.items()):
            advance("joining", done, len(todo))
            links += _bring(job.folder / plan.path, directory / plan.path, plan, shard)
            record_finished(directory, plan, shard)
        advance("joining", len(todo), len(todo))
        announce(_how(links, len(todo) - links))
        for line in _unlike(jobs):
            announce(line)
        seconds = time.perf_counter() - started
        shards = kept | {plan: shard for plan, (_, shard) in todo.items()}
        finished = [shards[plan] for plan in plans]
        counts = total_counts(finished)
        finish(directory, _manifest(jobs, finished, counts, seconds))
    return Report(directory, frames, len(todo), len(kept), counts, seconds)


def _require_room(todo: Sources, directory: Path) -> None:
    """:raises InputError: shards that must be copied, and no room for them"""
    jobs = {job.folder: (job, plan) for plan, (job, _) in todo.items()}
    apart = {folder for folder, (_, plan) in jobs.items() if not _can_link(folder / plan.path, directory)}
    needed = sum(shard.record.bytes for job, shard in todo.values() if job.folder in apart)
    if needed > (free := free_bytes(directory)):
        problem = f"{directory} has {free / 1e6:.0f} MB free; {needed / 1e6:.0f} MB have to be copied there"
        raise InputError("--out", problem, "another disk, or that of the jobs, on which shards are linked")


def _can_link(shard: Path, directory: Path) -> bool:
    probe = directory / f".link{PARTIAL}"  # removed with what a killed run leaves
    try:
        probe.unlink(missing_ok=True)
        os.link(shard, probe)
    except OSError:  # another disk, a file system without links, a file of another user
        return False
    finally:
        probe.unlink(missing_ok=True)
    return True


def _bring(source: Path, target: Path, plan: ShardPlan, shard: FinishedShard) -> bool:
    """Bring a shard to its place; whether it was linked.

    :raises OSError: the disk is full or fails, or the copy is not the shard
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_name(target.name + PARTIAL)
    partial.unlink(missing_ok=True)
    try:
        os.link(source, partial)
    except OSError:
        with atomic(target) as copy:
            shutil.copyfile(source, copy)
        if not is_whole(target, plan, shard.record):
            raise OSError(None, "the copy differs from the shard", str(target)) from None
        return False
    partial.replace(target)
    partial.unlink(missing_ok=True)  # renamed to a link of the same file it stays, as POSIX has it
    return True


def _how(links: int, copies: int) -> str:
    linked = f"{links} shards are links: they take no room, and stay where the jobs' folders are removed"
    copied = f"{copies} shards are copies, from another disk or a file system without links"
    return "; ".join([*([linked] if links else []), *([copied] if copies else [])]) or "no shard was left to bring"


def _unlike(jobs: Sequence[FinishedJob]) -> list[str]:
    """What the jobs state otherwise, under the same arguments: where files lay."""
    first, *others = jobs
    names = [name for name in first.manifest if name not in OF_JOBS]
    differing = {name: [job for job in others if job.manifest.get(name) != first.manifest[name]] for name in names}
    return [
        f"{name} of the manifest is that of job {first.job}; {len(unlike)} jobs, {unlike[0].job} among them, say other"
        for name, unlike in differing.items()
        if unlike
    ]


def _manifest(
    jobs: Sequence[FinishedJob], finished: Sequence[FinishedShard], counts: Mapping[str, float], seconds: float
) -> dict[str, Any]:
    """That of the run in one piece, but for ``made``, which has each job's."""
    step_seconds: Counter[str] = Counter()
    for job in jobs:
        step_seconds.update(job.manifest[MADE]["step_seconds"])
    made = {"jobs": [{"job": str(job.job), **job.manifest[MADE]} for job in jobs]}
    return {
        **{name: value for name, value in jobs[0].manifest.items() if name not in OF_JOBS},
        "arguments": jobs[0].arguments,
        "counts": counts,
        "shards": [shard.record.model_dump() for shard in finished],
        MADE: {**provenance(LOCAL, 1, seconds, step_seconds), **made},
    }
