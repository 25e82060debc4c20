"""The dataset factory's method: scenes to plans to frames to shards, with resume and progress."""

from __future__ import annotations

import platform
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pyarrow as pa
from threadpoolctl import threadpool_limits

from datafactory.effects.timing import saving
from datafactory.frame.points import rayleigh_length
from datafactory.paths.backend import select_variant, set_threads
from datafactory.paths.storage import paths_schema
from datafactory.run.job import (
    Job,
    render_shard,
    trace_shard,
)
from datafactory.run.order import Order
from datafactory.run.progress import FinishedShard, begin, completed, fingerprint, finish
from datafactory.run.shards import FRAMES_PER_SHARD, ShardPlan, plan_shards, split_of, write_manifest
from datafactory.run.sources import PATHS, Announce, Sources, sources_of
from datafactory.run.workers import run_shards
from datafactory.scenes.materials.table import MaterialTable
from shared.dataset import VERSION, arrow_schema, description
from shared.dataset.folder import read_manifest
from shared.signal.windows import angle_window, point_spread

PACKAGES = (
    "sparseradar-shared",
    "sparseradar-datafactory",
    "sionna-rt",
    "mitsuba",
    "drjit",
    "numpy",
    "numba",
    "pyarrow",
)


@dataclass(frozen=True)
class Report:
    """What a run did.

    :param frames: frames in the dataset
    :param shards_made, shards_kept: shards rendered now, and found whole from an earlier run
    :param counts: the manifest's counts
    :param seconds: wall-clock seconds of this run
    """

    directory: Path
    frames: int
    shards_made: int
    shards_kept: int
    counts: dict[str, float]
    seconds: float


Advance = Callable[[int, int], None]


def render(
    order: Order,
    table: MaterialTable,
    directory: Path,
    workers: int = 1,
    resume: bool = False,
    announce: Announce = lambda line: None,
    advance: Advance = lambda done, total: None,
) -> Report:
    """Render a dataset into ``directory``.

    :param announce: takes lines for the user: material mappings, warnings
    :param advance: takes frames done and frames in all
    :raises InputError: anything wrong with the order or its inputs, before anything is written
    :raises OSError: the disk fails; what was finished can be resumed
    """
    about = description(order.radar, order.processing.peaks, order.processing.store, _conventions(order))
    sources = sources_of(order, table, announce)
    job = _job(order, sources, arrow_schema(about))
    said = {key: about[key] for key in ("radar", "array", "virtual_sensor", "axes", "shapes", "conventions", "truth")}
    report = _produce(
        job, plan_shards(job.splits), render_shard, {**sources.arguments, **_processing_arguments(order)},
        {**said, "scenes": sources.entries}, directory, workers, resume, announce, advance,
    )  # fmt: skip
    if report.shards_made:
        _say_what_plans_saved(order, sources, directory, announce)
    return report


def trace_paths(
    order: Order,
    table: MaterialTable,
    directory: Path,
    workers: int = 1,
    resume: bool = False,
    announce: Announce = lambda line: None,
    advance: Advance = lambda done, total: None,
) -> Report:
    """Trace scene frames into ``directory/paths``, for :func:`render` with ``Order.paths``; otherwise like it."""
    sources = sources_of(order, table, announce)
    job = _job(order, sources, paths_schema())
    frames = range(len(job.recipes))
    plans = tuple(
        ShardPlan(PATHS, index, tuple(frames[first : first + FRAMES_PER_SHARD]))
        for index, first in enumerate(range(0, len(frames), FRAMES_PER_SHARD))
    )
    return _produce(
        job, plans, trace_shard, sources.arguments, {"scenes": sources.entries},
        directory, workers, resume, announce, advance,
    )  # fmt: skip


def _say_what_plans_saved(order: Order, sources: Sources, directory: Path, announce: Announce) -> None:
    """Time one frame of every scene as planned and with every effect; print it and keep it under ``made``."""
    savings = []
    if sources.probes:
        select_variant()
        set_threads(1)
    with threadpool_limits(limits=1):
        for scene, probe, effects in sources.probes:
            found = saving(scene, probe, effects, order.processing)
            if found is None:
                announce(f"{scene}: every effect was simulated")
                continue
            savings.append(found)
            share = 100.0 * (1.0 - found.planned_seconds / found.all_seconds)
            announce(
                f"{scene}: {found.planned_seconds:.2f} s a frame on one core, {found.all_seconds:.2f} s with "
                f"--effects all: {share:.0f} % saved"
            )
    manifest = read_manifest(directory)
    manifest["made"]["effects_saving"] = [vars(item) for item in savings]
    write_manifest(directory, manifest)


def _processing_arguments(order: Order) -> dict[str, Any]:
    return {
        "processing": asdict(order.processing),
        "prune_db": order.prune_db,
        "close_targets": asdict(order.close_targets),
    }


def _job(order: Order, sources: Sources, schema: pa.Schema) -> Job:
    return Job(
        radar=order.radar,
        processing=order.processing,
        trace=order.trace,
        prune_db=order.prune_db,
        close_targets=order.close_targets,
        seed=order.seed,
        scenes=sources.works,
        recipes=sources.recipes,
        splits=tuple(split_of(index, order.split) for index in range(len(sources.recipes))),
        schema_message=schema.serialize().to_pybytes(),
    )


def _produce(
    job: Job,
    plans: Sequence[ShardPlan],
    write: Callable[..., Any],
    arguments: dict[str, Any],
    sections: dict[str, Any],
    directory: Path,
    workers: int,
    resume: bool,
    announce: Announce,
    advance: Advance,
) -> Report:
    """Write the planned shards that are not there yet, then the manifest.

    :param write: :func:`datafactory.run.job.render_shard` or :func:`datafactory.run.job.trace_shard`
    :param sections: the manifest's own entries beside those that every run has
    """
    started = time.perf_counter()
    if begin(directory, arguments, resume):
        announce(f"{directory} is already complete")
        return Report(directory, len(job.recipes), 0, len(plans), {}, time.perf_counter() - started)
    mark = fingerprint(arguments)
    earlier = completed(directory, plans, mark)
    for path in earlier.damaged:
        announce(f"{path} is not as it was recorded and is made again")
    todo = [plan for plan in plans if plan not in earlier.shards]
    made, stage_seconds = run_shards(job, write, todo, directory, mark, workers, len(job.recipes), advance)
    finished = [(earlier.shards | made)[plan] for plan in plans]
    counts = _total(finished)
    seconds = time.perf_counter() - started
    manifest = {
        "version": VERSION,
        "arguments": arguments,
        **sections,
        "seeds": {"dataset": job.seed, "frame": "SeedSequence(entropy=dataset, spawn_key=(frame_id,))"},
        "counts": counts,
        "shards": [item.record.model_dump() for item in finished],
        "made": _made(workers, seconds, stage_seconds),
    }
    finish(directory, manifest)
    return Report(directory, len(job.recipes), len(made), len(earlier.shards), counts, seconds)


def _made(workers: int, seconds: float, stage_seconds: dict[str, float]) -> dict[str, Any]:
    """The only part of the manifest that may differ between equal runs."""
    return {
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "host": platform.node(),
        "machine": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": {name: version(name) for name in PACKAGES},
        "workers": workers,
        "seconds": round(seconds, 1),
        "stage_seconds": {name: round(value, 1) for name, value in sorted(stage_seconds.items())},
    }


def _conventions(order: Order) -> dict[str, Any]:
    """What a reader of one shard needs to know beside the axes."""
    elements = order.radar.virtual_sensor.channels
    spacing = order.radar.waveform.wavelength_m / 2.0
    if elements > 1:
        rx = order.radar.virtual_sensor.rx
        spacing = abs(float(rx[1, 1] - rx[0, 1]))
    width, sidelobe = point_spread(
        angle_window(order.processing.truth_window, elements), spacing / order.radar.waveform.wavelength_m
    )
    return {
        "conventions": {
            "frame": "x forward, y left, z up, origin at the centroid of the full array's RX; u = y / range",
            "units": "range_channel and image_peak in sqrt(W), noise_power in W per channel and range-Doppler cell",
            "velocity": "range rate, positive is receding",
            "image": "truth magnitude relative to image_peak; row r in the first Doppler cell of range bin r",
        },
        "truth": {
            "window": order.processing.truth_window,
            "width_u": width,
            "width_bins": width / order.radar.grid.step,
            "peak_sidelobe_db": sidelobe,
            "rayleigh_length_u_of_array": rayleigh_length(order.radar),
        },
    }


def _total(finished: Sequence[FinishedShard]) -> dict[str, float]:
    counts: Counter[str] = Counter()
    for item in finished:
        counts.update(item.counts)
    return dict(sorted(counts.items()))
