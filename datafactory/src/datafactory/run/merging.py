"""Jobs of an array to the dataset of the run in one piece: ``datafactory merge``.

A shard is linked where the jobs lie on the same disk, so that it takes no room, and copied where not. Shards are noted
as a run notes them (:mod:`datafactory.run.progress`): a merge that was killed is taken up like a run.
"""

from __future__ import annotations

import os
import shutil
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from datafactory.run.array_job import ENTRY
from datafactory.run.engines import LOCAL
from datafactory.run.finished_jobs import FinishedJob, find_jobs, require_same_arguments, shards_of_all
from datafactory.run.memory import free_bytes
from datafactory.run.pipeline import Report, total_counts
from datafactory.run.progress import (
    FinishedShard,
    begin,
    claimed,
    completed,
    fingerprint,
    finish,
    is_whole,
    record_finished,
)
from datafactory.run.provenance import provenance
from datafactory.run.shards import ShardPlan
from shared.dataset.documents import MADE
from shared.dataset.writing import PARTIAL, atomic
from shared.physics.errors import InputError

Advance = Callable[[str, int, int], None]
Sources = Mapping[ShardPlan, tuple[FinishedJob, FinishedShard]]

OF_JOBS = ("arguments", "counts", "shards", ENTRY, MADE)
"""Entries of a job's manifest that the dataset's has otherwise, or not at all."""


def merge(
    folders: Sequence[Path], directory: Path, resume: bool, announce: Callable[[str], None], advance: Advance
) -> Report:
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
    sources = shards_of_all(jobs, begun)
    arguments = jobs[0].arguments
    with claimed(directory, resume):
        frames = sum(len(plan.frame_ids) for plan in sources)
        if resume and begin(directory, arguments, resume):
            announce(f"{directory} is already complete")
            return Report(directory, frames, 0, len(sources), {}, time.perf_counter() - started)
        kept = completed(directory, list(sources), fingerprint(arguments)).shards
        todo = {plan: source for plan, source in sources.items() if plan not in kept}
        _require_whole(todo, advance)
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
        counts = total_counts([shard for _, shard in sources.values()])
        finish(directory, _manifest(jobs, sources, counts, seconds))
    return Report(directory, frames, len(todo), len(kept), counts, seconds)


def _require_whole(todo: Sources, advance: Advance) -> None:
    """:raises InputError: shards that are not as their jobs recorded them"""
    damaged = []
    for done, (plan, (job, shard)) in enumerate(todo.items()):
        advance("checking", done, len(todo))
        if not is_whole(job.folder / plan.path, plan, shard.record):
            damaged.append((job, plan))
    advance("checking", len(todo), len(todo))
    if damaged:
        names = ", ".join(str(job.folder / plan.path) for job, plan in damaged)
        remedy = " and ".join(sorted({f"{job.folder} removed and job {job.job} run again" for job, _ in damaged}))
        raise InputError("merge", f"missing or not as recorded: {names}", remedy)


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
    jobs: Sequence[FinishedJob], sources: Sources, counts: Mapping[str, float], seconds: float
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
        "shards": [shard.record.model_dump() for _, shard in sources.values()],
        MADE: {**provenance(LOCAL, 1, seconds, step_seconds), **made},
    }
