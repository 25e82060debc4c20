"""An order to a dataset or to traced paths: its scenes are opened while workers get ready, then the recipe is made.

From there on there are frames, portions and shards. Portions of frames are dealt to workers, shards written as they are
whole, then the manifest. What makes one frame stands in :mod:`datafactory.frame.chain`."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from datafactory.defaults import CPU, LOCAL
from datafactory.effects.catalogue import ALL
from datafactory.frame.deal import Deal
from datafactory.frame.points import require_close_targets
from datafactory.paths.free_extent import all_strips
from datafactory.paths.trace import find_shapes
from datafactory.run.memory import processes_ahead, require_room, workers_for
from datafactory.run.portions import Engine, PortionWork, Writer, deal_out
from datafactory.run.preparation import Order, Recipe, prepare
from datafactory.run.progress import FinishedShard, begin, claimed, completed, finish, handed_over
from datafactory.run.shards import ARGUMENT, ENTRY, ArrayJob, JobEntry, portions_of, provenance
from datafactory.scenes.materials.table import MaterialTable
from datafactory.scenes.poses import require_ground
from datafactory.synthesis.doppler_moments import add_doppler_moments
from shared.dataset import VERSION
from shared.dataset.documents import digest
from shared.dataset.locations import Location
from shared.physics.compiled import is_kept
from shared.processes.telling import Announce, Progress, silent
from shared.radar import Radar
from shared.signal.tdm import statement


@dataclass(frozen=True)
class Report:
    """What a run did.

    :param frames: frames in the dataset
    :param shards_made, shards_kept: shards rendered now, and found whole from an earlier run
    :param counts: the manifest's counts
    :param seconds: wall-clock seconds of this run, opening its scenes included
    """

    directory: Location
    frames: int
    shards_made: int
    shards_kept: int
    counts: dict[str, float]
    seconds: float


@dataclass(frozen=True)
class Execution:
    """How a run is carried out; nothing of it changes a byte of the shards.

    :param workers: processes; one works in this process; 0 for as many as there are cores and memory for. On a cluster:
        of all its nodes, 0 for all that they have
    :param resume: take up an unfinished run
    :param keep_going: finish the other shards where three worker processes died of a portion of one
    :param job: make the shards of this job alone; ``directory`` is then the job's own
    :param engine: where shards are made
    :param announce: takes lines for the user: material mappings, warnings
    :param advance: takes "frames", those done, and those in all
    """

    directory: Location
    workers: int = 1
    resume: bool = False
    keep_going: bool = False
    job: ArrayJob | None = None
    engine: Engine = field(default_factory=Engine)
    announce: Announce = silent
    advance: Progress = silent


def produce(recipe: Recipe, execution: Execution, started: float) -> Report:
    """Write the shards that are not there yet, then the manifest.

    :param started: when the run began, by :func:`time.perf_counter`
    :raises InputError: a folder of other arguments, more jobs than shards
    :raises OSError: the disk or the store fails; what was finished can be resumed
    :raises RunFailed: worker processes died; what was finished can be resumed
    """
    directory, job, plans, manifest = execution.directory, recipe.job, recipe.plans, recipe.manifest
    arguments = manifest["arguments"]
    mark = digest(arguments)  # a job's is that of the run in one piece
    if execution.job is not None:
        plans = execution.job.own(plans)
        arguments = {**arguments, ARGUMENT: str(execution.job)}
        manifest = {**manifest, "arguments": arguments}
    frames = sum(len(plan.frame_ids) for plan in plans)
    if begin(directory, arguments, execution.resume):
        execution.announce(f"{directory} is already complete")
        return Report(directory, frames, 0, len(plans), {}, time.perf_counter() - started)
    earlier = completed(directory, plans, mark)
    for path in earlier.damaged:
        execution.announce(f"{path} is not as it was recorded and is made again")
    todo = [plan for plan in plans if plan not in earlier.shards]
    # Two kernels stand for all: that of right angles in scenes, and the truth's, which comes after the cube's.
    right_angles, truth = job.scenes and job.of_scenes.trace.corners, not job.paths_alone and job.settings.device == CPU
    dear = [kernel for kernel, used in ((all_strips, right_angles), (add_doppler_moments, truth)) if used]
    if todo and not all(map(is_kept, dear)):
        execution.announce("what makes frames is compiled for this machine, once; that takes about a minute")
    for scene in job.scenes if todo else ():  # found here once for all workers
        find_shapes(scene.merged, job.of_scenes.trace)
    portions = portions_of(todo, execution.engine.at_a_time(execution.workers))
    made = Writer(job, directory, mark)
    with handed_over(directory) as folder:
        pool = execution.engine.pool(PortionWork(job, folder), len(portions), execution.workers)
        deal_out(
            portions, pool, made, execution.keep_going, lambda left: execution.advance("frames", frames - left, frames)
        )
    every = earlier.shards | made.shards
    finished = [every[plan] for plan in plans]
    counts = total_counts(finished)
    if execution.job is not None:
        split = None if job.paths_alone else job.deal.split
        entry = JobEntry(frames=len(job.deal), split=split, sequences=job.deal.sequences)
        manifest = {**manifest, ENTRY: entry.model_dump()}
    seconds = time.perf_counter() - started
    finish(
        directory,
        {
            "version": VERSION,
            **manifest,
            "seeds": {"dataset": job.deal.seed, "frame": "SeedSequence(entropy=dataset, spawn_key=(frame_id,))"},
            "counts": counts,
            "shards": [item.record.model_dump() for item in finished],
            "made": provenance(execution.engine.name, execution.workers, seconds, made.seconds, job.settings.device),
        },
    )
    return Report(directory, frames, len(made.shards), len(earlier.shards), counts, seconds)


def _require_makeable(deal: Deal, radar: Radar) -> None:
    """Refuse before the run begins what a frame in the middle of it would be refused for.

    :raises InputError: no free ground for a pose that is to be drawn, no range bins for close targets
    """
    if deal.points:
        require_close_targets(radar)
    if deal.grounds and not deal.tracks:
        for scene, split in dict.fromkeys((deal.scene_of(n), deal.split_of(n)) for n in range(deal.scene_frames)):
            require_ground(deal.grounds[scene], split)


def total_counts(finished: Sequence[FinishedShard]) -> dict[str, float]:
    """The manifest's ``counts``: those of the shards, in their order, added up."""
    counts: Counter[str] = Counter()
    for item in finished:
        counts.update(item.counts)
    return dict(sorted(counts.items()))


def render(order: Order, table: MaterialTable, execution: Execution) -> Report:
    """Render a dataset, or trace scene frames into ``paths/`` of the folder, for orders of stored paths.

    :raises InputError: anything wrong with the order or its inputs, before anything is written
    :raises OSError: the disk or the store fails; what was finished can be resumed
    :raises RunFailed: worker processes died; what was finished can be resumed
    """
    started, device = time.perf_counter(), order.settings.device
    if order.paths_alone:  # one trace serves many radars: each leaves out for itself what it would not notice
        order = replace(order, effects=order.effects or ALL)
    # Workers get ready while scenes are opened: libraries take as long.
    count = min(processes_ahead(execution.workers, device), len(order))
    ahead = execution.engine.ahead(count, device if order.scenes else None)
    with claimed(execution.directory, execution.resume), ahead:
        if not order.paths_alone:
            frames = execution.job.least_frames(len(order)) if execution.job else len(order)
            require_room(execution.directory, frames, order.radar, order.of_scenes.processing)
        recipe = prepare(order, table, execution.announce)
        _require_makeable(recipe.job.deal, order.radar)
        load = recipe.job.load
        if execution.engine.name == LOCAL:
            execution = replace(execution, workers=workers_for(load, execution.workers, execution.announce))
        else:  # this process hands out; what the nodes hold is counted by Ray
            workers_for(load, 1, execution.announce)
        if not order.paths_alone and (said := statement(order.radar)):
            execution.announce(said)
        return produce(recipe, execution, started)
