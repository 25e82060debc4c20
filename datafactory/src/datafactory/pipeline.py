"""The dataset factory's method: scenes to plans to frames to shards, with resume and progress."""

from __future__ import annotations

import multiprocessing
import platform
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from datafactory.frames import Processing
from datafactory.paths.backend import select_variant, set_threads
from datafactory.paths.prune import DEFAULT_LEVEL_DB
from datafactory.paths.stage import stage_of
from datafactory.paths.trace import TraceSettings
from datafactory.points import CloseTargets, PointTargets, rayleigh_length
from datafactory.progress import FinishedShard, begin, completed, fingerprint, finish, record_finished
from datafactory.scenes.ground import free_ground
from datafactory.scenes.materials import MaterialTable
from datafactory.scenes.open import open_scene
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import Scene
from datafactory.shards import ShardPlan, plan_shards, split_of
from datafactory.worker import Job, PointFrame, Recipe, SceneFrame, SceneWork, render_shard
from shared.dataset import VERSION, arrow_schema, description
from shared.radar import Radar
from shared.windows import angle_window, point_spread

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
class Order:
    """What the user asked for.

    :param scenes: ``--scene`` arguments, dealt to the frames in turn
    :param frames: scene frames in total
    :param points: close-target frames after them
    :param poses: one frame a pose, instead of ``frames`` drawn ones; empty to draw
    :param targets: frames of exactly these targets, instead of drawn ones
    """

    radar: Radar
    scenes: tuple[str, ...] = ()
    frames: int = 0
    points: int = 0
    seed: int = 0
    split: str = "6:1:1"
    poses: tuple[Pose, ...] = ()
    targets: tuple[PointTargets, ...] = ()
    processing: Processing = field(default_factory=Processing)
    trace: TraceSettings = field(default_factory=TraceSettings)
    prune_db: float = DEFAULT_LEVEL_DB
    close_targets: CloseTargets = field(default_factory=CloseTargets)


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


def render(
    order: Order,
    table: MaterialTable,
    directory: Path,
    workers: int = 1,
    resume: bool = False,
    announce: Callable[[str], None] = lambda line: None,
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> Report:
    """Render a dataset into ``directory``.

    :param announce: takes lines for the user: material mappings, warnings
    :param advance: takes frames done and frames in all
    :raises InputError: anything wrong with the order or its inputs, before anything is written
    :raises OSError: the disk fails; what was finished can be resumed
    """
    started = time.perf_counter()
    scenes = [open_scene(source) for source in order.scenes]
    works = tuple(_prepare(scene, table, draw=not order.poses, announce=announce) for scene in scenes)
    recipes = _recipes(order)
    splits = tuple(split_of(index, order.split) for index in range(len(recipes)))
    about = description(order.radar, order.processing.peaks, order.processing.store, _conventions(order))
    job = Job(
        radar=order.radar,
        processing=order.processing,
        trace=order.trace,
        prune_db=order.prune_db,
        close_targets=order.close_targets,
        seed=order.seed,
        scenes=works,
        recipes=recipes,
        splits=splits,
        schema=arrow_schema(about),
    )
    arguments = _arguments(order, scenes, works)
    plans = plan_shards(splits)
    if begin(directory, arguments, resume):
        announce(f"{directory} is already complete")
        return Report(directory, len(recipes), 0, len(plans), {}, time.perf_counter() - started)
    mark = fingerprint(arguments)
    kept = completed(directory, plans, mark).shards
    todo = [plan for plan in plans if plan not in kept]
    made, stage_seconds = _run(job, todo, directory, mark, workers, len(recipes), advance)
    finished = [(kept | made)[plan] for plan in plans]
    counts = _total(finished)
    seconds = time.perf_counter() - started
    finish(
        directory,
        {
            "version": VERSION,
            "arguments": arguments,
            **{
                key: about[key]
                for key in ("radar", "array", "virtual_sensor", "axes", "shapes", "conventions", "truth")
            },
            "seeds": {"dataset": order.seed, "frame": "SeedSequence(entropy=dataset, spawn_key=(frame_id,))"},
            "scenes": [_scene_entry(scene, work) for scene, work in zip(scenes, works, strict=True)],
            "counts": counts,
            "shards": [item.record.model_dump() for item in finished],
            "made": {
                "finished": datetime.now(UTC).isoformat(timespec="seconds"),
                "host": platform.node(),
                "machine": f"{platform.system()} {platform.machine()}",
                "python": platform.python_version(),
                "versions": {name: version(name) for name in PACKAGES},
                "workers": workers,
                "seconds": round(seconds, 1),
                "stage_seconds": {name: round(value, 1) for name, value in sorted(stage_seconds.items())},
            },
        },
    )
    return Report(directory, len(recipes), len(made), len(kept), counts, seconds)


def _prepare(scene: Scene, table: MaterialTable, draw: bool, announce: Callable[[str], None]) -> SceneWork:
    materials = table.map_materials([item.material for item in scene.objects])
    for warning in scene.warnings:
        announce(f"{scene.name}: {warning}")
    pairs = ", ".join(f"{name or '(none)'} -> {material.name}" for name, (material, _) in materials.entries.items())
    announce(f"{scene.name}: {len(scene.objects)} objects, {scene.triangle_count} triangles; materials {pairs}")
    if materials.unknown:
        announce(f"{scene.name}: unknown materials given the default: {', '.join(materials.unknown)}")
    return SceneWork(scene.name, stage_of(scene, materials), materials, free_ground(scene) if draw else None)


def _recipes(order: Order) -> tuple[Recipe, ...]:
    recipes: list[Recipe] = []
    for index in range(len(order.poses) or order.frames):
        recipes.append(SceneFrame(index % len(order.scenes), order.poses[index] if order.poses else None))
    recipes += [PointFrame(targets) for targets in order.targets] or [PointFrame()] * order.points
    return tuple(recipes)


def _arguments(order: Order, scenes: Sequence[Scene], works: Sequence[SceneWork]) -> dict[str, Any]:
    """All that determines the bytes, by the names that the user knows; scenes and materials by content."""
    return {
        "scenes": [{"scene": scene.name, "content": scene.content_hash()} for scene in scenes],
        "materials": [work.materials.to_json() for work in works],
        "radar": order.radar.model_dump(mode="json"),
        "frames": order.frames,
        "points": order.points,
        "seed": order.seed,
        "split": order.split,
        "poses": [asdict(pose) for pose in order.poses],
        "targets": [{name: getattr(t, name).tolist() for name in vars(t)} for t in order.targets],
        "processing": asdict(order.processing),
        "trace": asdict(order.trace),
        "prune_db": order.prune_db,
        "close_targets": asdict(order.close_targets),
        "versions": {"sparseradar-datafactory": version("sparseradar-datafactory"), "sionna-rt": version("sionna-rt")},
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


def _scene_entry(scene: Scene, work: SceneWork) -> dict[str, Any]:
    return {
        "name": scene.name,
        "source": scene.source,
        "content_sha256": scene.content_hash(),
        "objects": len(scene.objects),
        "triangles": scene.triangle_count,
        "point_targets": len(scene.targets),
        "warnings": list(scene.warnings),
        "materials": work.materials.to_json(),
    }


def _total(finished: Sequence[FinishedShard]) -> dict[str, float]:
    counts: Counter[str] = Counter()
    for item in finished:
        counts.update(item.counts)
    return dict(sorted(counts.items()))


def _run(
    job: Job,
    todo: list[ShardPlan],
    directory: Path,
    mark: str,
    workers: int,
    total: int,
    advance: Callable[[int, int], None],
) -> tuple[dict[ShardPlan, FinishedShard], Counter[str]]:
    """Render the shards in worker processes; each is recorded as soon as it is whole."""
    context = multiprocessing.get_context("spawn")
    ticks = context.SimpleQueue()
    made: dict[ShardPlan, FinishedShard] = {}
    seconds: Counter[str] = Counter()
    done = total - sum(len(plan.frame_ids) for plan in todo)
    advance(done, total)
    with ProcessPoolExecutor(
        workers, mp_context=context, initializer=_start, initargs=(job, directory, mark, ticks)
    ) as pool:
        pending: dict[Future, ShardPlan] = {pool.submit(_render, plan): plan for plan in todo}
        try:
            while pending:
                finished, _ = wait(pending, timeout=0.5, return_when=FIRST_COMPLETED)
                while not ticks.empty():
                    done += ticks.get()
                    advance(done, total)
                for future in finished:
                    plan = pending.pop(future)
                    made[plan], spent = future.result()
                    record_finished(directory, plan, made[plan])
                    seconds.update(spent)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return made, seconds


_state: dict[str, Any] = {}
"""What a worker process was given at its start; a process pool hands tasks nothing else."""


def _start(job: Job, directory: Path, mark: str, ticks: Any) -> None:
    if job.scenes:
        select_variant()
        set_threads(1)
    _state.update(job=job, directory=directory, mark=mark, ticks=ticks)


def _render(plan: ShardPlan) -> tuple[FinishedShard, dict[str, float]]:
    return render_shard(_state["job"], plan, _state["directory"], _state["mark"], _state["ticks"].put)
