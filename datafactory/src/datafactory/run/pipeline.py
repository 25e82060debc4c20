"""The dataset factory's method: scenes, then shards of frames or of paths, then the manifest.

What makes one frame stands in :mod:`datafactory.frame.chain`.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from datafactory.effects.catalogue import ALL
from datafactory.frame.points import rayleigh_length
from datafactory.paths.storage import paths_schema
from datafactory.run.array_job import ARGUMENT, ENTRY, ArrayJob, JobEntry
from datafactory.run.engines import LOCAL, Engine, Local
from datafactory.run.job import Job
from datafactory.run.memory import processes_ahead, workers_for
from datafactory.run.order import Order
from datafactory.run.portions import PortionWork, Writer, deal_out
from datafactory.run.preparation import Prepared, load_of, opened_scenes, prepare
from datafactory.run.progress import FinishedShard, begin, claimed, completed, fingerprint, finish, handed_over
from datafactory.run.provenance import provenance
from datafactory.run.room import require_room
from datafactory.run.shards import PATHS, ShardPlan, plan_shards, portions_of
from datafactory.scenes.materials.table import MaterialTable
from shared.dataset import VERSION, arrow_schema, description
from shared.dataset.locations import Location
from shared.signal.tdm import statement
from shared.signal.windows import angle_window, point_spread

Announce = Callable[[str], None]
Advance = Callable[[int, int], None]


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
    :param advance: takes frames done and frames in all
    """

    directory: Location
    workers: int = 1
    resume: bool = False
    keep_going: bool = False
    job: ArrayJob | None = None
    engine: Engine = field(default_factory=Local)
    announce: Announce = lambda line: None
    advance: Advance = lambda done, total: None

    @property
    def processes_here(self) -> int:
        """Processes of this machine that trace at a time."""
        return self.engine.processes_here(self.workers)


def render(order: Order, table: MaterialTable, execution: Execution) -> Report:
    """Render a dataset.

    :raises InputError: anything wrong with the order or its inputs, before anything is written
    :raises OSError: the disk or the store fails; what was finished can be resumed
    :raises RunFailed: worker processes died; what was finished can be resumed
    """
    with claimed(execution.directory, execution.resume), _ahead(order, execution):
        return _rendered(order, table, execution)


def _rendered(order: Order, table: MaterialTable, execution: Execution) -> Report:
    started = time.perf_counter()
    settings = order.settings
    about = description(order.radar, settings.processing.peaks, settings.processing.store, _conventions(order))
    frames = order.scene_frames + (len(order.targets) or order.points)
    require_room(execution.directory, math.ceil(frames / (execution.job.of if execution.job else 1)), about["shapes"])
    order, execution = _fitted(order, execution)
    if said := statement(order.radar):
        execution.announce(said)
    prepared = prepare(order, table, execution.announce)
    job = _job(order, prepared, arrow_schema(about).serialize().to_pybytes())
    arguments = {
        **prepared.arguments,
        "processing": asdict(settings.processing),
        "prune_db": settings.prune_db,
        "close_targets": asdict(settings.close_targets),
    }
    stated = {key: about[key] for key in ("radar", "array", "virtual_sensor", "axes", "shapes", "conventions", "truth")}
    if order.licence is not None:
        arguments["license"] = stated["license"] = order.licence
    manifest = {"arguments": arguments, **stated, "scenes": prepared.entries}
    return _produce(job, order.split, plan_shards(job.deal.splits()), manifest, execution, started)


def trace_paths(order: Order, table: MaterialTable, execution: Execution) -> Report:
    """Trace scene frames into ``paths/`` of the folder, for :func:`render` with ``Order.paths``; otherwise like it."""
    with claimed(execution.directory, execution.resume), _ahead(order, execution):
        return _traced(order, table, execution)


def _traced(order: Order, table: MaterialTable, execution: Execution) -> Report:
    started = time.perf_counter()
    order, execution = _fitted(order, execution, rendered=False)
    # One trace serves many radars: each leaves out for itself what it would not notice.
    order = replace(order, effects=order.effects or ALL)
    prepared = prepare(order, table, execution.announce)
    job = replace(_job(order, prepared, paths_schema().serialize().to_pybytes()), paths_alone=True)
    manifest = {"arguments": prepared.arguments, "scenes": prepared.entries}
    return _produce(job, None, plan_shards((PATHS,) * len(job.deal)), manifest, execution, started)


def _ahead(order: Order, execution: Execution) -> AbstractContextManager[None]:
    """Workers get ready while scenes are opened: libraries take as long."""
    device, frames = order.settings.device, order.scene_frames + (len(order.targets) or order.points)
    count = processes_ahead(execution.workers, device)
    if order.paths is None:
        return execution.engine.ahead(min(count, frames), device if order.scenes else None)
    return execution.engine.ahead(count, None)


def _fitted(order: Order, execution: Execution, rendered: bool = True) -> tuple[Order, Execution]:
    """The order with its scenes opened, and the execution with as many workers as there is memory for.

    :raises InputError: a scene that cannot be read, a run that cannot fit into memory
    """
    scenes = opened_scenes(order)
    workers = workers_for(load_of(order, scenes, rendered), execution.processes_here, execution.announce)
    if execution.engine.name == LOCAL:
        execution = replace(execution, workers=workers)
    return replace(order, scenes=tuple(scenes)), execution


def _job(order: Order, prepared: Prepared, schema_message: bytes) -> Job:
    return Job(
        radar=order.radar,
        deal=prepared.deal,
        scenes=prepared.scenes,
        settings=order.settings,
        of_scenes=order.of_scenes,
        stored=prepared.stored,
        schema_message=schema_message,
    )


def _produce(
    job: Job,
    split: str | None,
    plans: Sequence[ShardPlan],
    manifest: dict[str, Any],
    execution: Execution,
    started: float,
) -> Report:
    """Write the planned shards that are not there yet, then the manifest.

    :param split: pattern that the plans follow; None for traced paths
    :param plans: of the whole dataset
    :param manifest: the entries that are the run's own, its ``arguments`` among them
    :param started: when the run began, by :func:`time.perf_counter`
    """
    directory, arguments = execution.directory, manifest["arguments"]
    if execution.job is not None:
        plans = execution.job.own(plans)
        arguments = {**arguments, ARGUMENT: str(execution.job)}
        manifest = {**manifest, "arguments": arguments}
    frames = sum(len(plan.frame_ids) for plan in plans)
    if begin(directory, arguments, execution.resume):
        execution.announce(f"{directory} is already complete")
        return Report(directory, frames, 0, len(plans), {}, time.perf_counter() - started)
    mark = fingerprint(arguments)
    earlier = completed(directory, plans, mark)
    for path in earlier.damaged:
        execution.announce(f"{path} is not as it was recorded and is made again")
    todo = [plan for plan in plans if plan not in earlier.shards]
    portions = portions_of(todo, execution.engine.at_a_time(execution.workers))
    made = Writer(job, directory, mark)
    if portions:
        job.find_shapes()
    with handed_over(directory) as folder:
        pool = execution.engine.pool(PortionWork(job, folder), len(portions), execution.workers)
        deal_out(portions, pool, made, execution.keep_going, lambda left: execution.advance(frames - left, frames))
    finished = [(earlier.shards | made.shards)[plan] for plan in plans]
    counts = total_counts(finished)
    if execution.job is not None:
        entry = JobEntry(frames=len(job.deal), split=split, counts=tuple(item.counts for item in finished))
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


def _conventions(order: Order) -> dict[str, Any]:
    """What a reader of one shard needs to know beside the axes."""
    elements, window = order.radar.virtual_sensor.channels, order.settings.processing.truth_window
    y, wavelength = order.radar.virtual_sensor.rx[:, 1], order.radar.waveform.wavelength_m
    spacing = abs(float(y[1] - y[0])) if len(y) > 1 else 0.0
    width = sidelobe = None  # of what is no line of elements
    if spacing > 0.0:
        width, sidelobe = point_spread(angle_window(window, elements), spacing / wavelength)
    return {
        "conventions": {
            "frame": "x forward, y left, z up, origin at the centroid of the full array's RX; u = y / range",
            "units": "range_channel and image_peak in sqrt(W), noise_power in W per channel and range-Doppler cell",
            "velocity": "; ".join(filter(None, ("range rate, positive is receding", statement(order.radar)))),
            "image": "truth magnitude relative to image_peak; row r in the first Doppler cell of range bin r",
        },
        "truth": {
            "window": window,
            "width_u": width,
            "width_bins": None if width is None else width / order.radar.grid.step,
            "peak_sidelobe_db": sidelobe,
            "rayleigh_length_u_of_array": rayleigh_length(order.radar),
        },
    }


def total_counts(finished: Sequence[FinishedShard]) -> dict[str, float]:
    """The manifest's ``counts``: those of the shards, in their order, added up."""
    counts: Counter[str] = Counter()
    for item in finished:
        counts.update(item.counts)
    return dict(sorted(counts.items()))
