"""What a worker process does: the frames of one shard, from poses or targets to a file."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import pyarrow as pa
from threadpoolctl import threadpool_limits

from datafactory.effects.catalogue import ALL, EffectSet
from datafactory.frame import chain as stages
from datafactory.frame.points import CloseTargets, PointTargets, draw_close_targets
from datafactory.frame.seeds import frame_seed, generator
from datafactory.paths.density import lit_cells
from datafactory.paths.merged_scene import Stage
from datafactory.paths.prune import pruned
from datafactory.paths.rays import RayFan
from datafactory.paths.solver import TraceSettings
from datafactory.paths.storage import TracedFrame, read_paths, to_row
from datafactory.paths.trace import trace
from datafactory.run.progress import FinishedShard
from datafactory.run.shards import ShardPlan, write_shard, write_tables
from datafactory.scenes.ground import Ground, Split
from datafactory.scenes.materials.table import MaterialMapping
from datafactory.scenes.poses import Pose, sample_pose
from shared.dataset import Frame
from shared.radar import Radar


@dataclass(frozen=True)
class SceneWork:
    """A scene made ready once, for all of its frames.

    :param ground: where poses are drawn; None where they are given
    :param effects: what is simulated of it
    """

    name: str
    stage: Stage
    materials: MaterialMapping
    ground: Ground | None
    effects: EffectSet = ALL


@dataclass(frozen=True)
class SceneFrame:
    """Recipe of a scene frame: which scene, and a given pose or None to draw one in the split's region."""

    scene: int
    pose: Pose | None = None


@dataclass(frozen=True)
class PointFrame:
    """Recipe of a point frame: exactly these targets, or None to draw close targets."""

    targets: PointTargets | None = None


@dataclass(frozen=True)
class StoredFrame:
    """Recipe of a scene frame that was traced before: row ``row`` of a paths shard, and what is simulated of it."""

    shard: Path
    row: int
    effects: EffectSet = ALL


Recipe = SceneFrame | PointFrame | StoredFrame


@dataclass(frozen=True)
class Job:
    """Everything that determines the frames' bytes.

    :param recipes: one a frame, by frame index
    :param splits: split of every frame
    :param schema_message: Arrow's schema message; a pickled :class:`pyarrow.Schema` forgets that the elements of its
        lists are never null, which would cost every reader a quarter of its time
    """

    radar: Radar
    processing: stages.Processing
    trace: TraceSettings
    prune_db: float
    close_targets: CloseTargets
    seed: int
    scenes: tuple[SceneWork, ...]
    recipes: tuple[Recipe, ...]
    splits: tuple[Split, ...]
    schema_message: bytes

    @property
    def schema(self) -> pa.Schema:
        """Of the shards."""
        return pa.ipc.read_schema(pa.py_buffer(self.schema_message))


def render_shard(
    job: Job, plan: ShardPlan, directory: Path, fingerprint: str, report: Callable[[int], None]
) -> tuple[FinishedShard, dict[str, float]]:
    """Write one shard; returns its record with the counts of its frames, and the seconds each stage took.

    :param report: called with 1 for every frame that is finished but for its image
    """
    counts: Counter[str] = Counter()
    seconds: dict[str, float] = defaultdict(float)
    with threadpool_limits(limits=1):
        record = write_shard(directory / plan.path, _frames(job, plan, counts, seconds, report), job.schema)
    return FinishedShard(record=record, counts=dict(counts), fingerprint=fingerprint), dict(seconds)


def _frames(
    job: Job, plan: ShardPlan, counts: Counter[str], seconds: dict[str, float], report: Callable[[int], None]
) -> Iterator[Frame]:
    for first in range(0, len(plan.frame_ids), stages.IMAGE_BATCH):
        batch = []
        for frame_id in plan.frame_ids[first : first + stages.IMAGE_BATCH]:
            batch.append(_measure(job, frame_id, counts, seconds))
            report(1)
        started = time.perf_counter()
        for frame, left_out in stages.image(batch, job.radar, job.processing.store):
            counts.update(left_out)
            yield frame
        seconds["image and write"] += time.perf_counter() - started


def _measure(job: Job, frame_id: int, counts: Counter[str], seconds: dict[str, float]) -> stages.Measurement:
    recipe, seed = job.recipes[frame_id], frame_seed(job.seed, frame_id)
    processing = job.processing
    started = time.perf_counter()
    if isinstance(recipe, PointFrame):
        targets = recipe.targets
        if targets is None:
            targets = draw_close_targets(job.radar, job.close_targets, generator(seed, "targets"))
        setting = stages.Setting(frame_id, "points", "points", seed)
        paths, known = targets.path_table(job.radar), targets.truth(job.radar)
    else:
        traced = _stored(recipe) if isinstance(recipe, StoredFrame) else trace_frame(job, frame_id, recipe)
        pose, seed = traced.pose, traced.seed
        setting = stages.Setting(frame_id, "scene", traced.scene, seed, pose.position, pose.velocity, pose.quaternion())
        table = traced.table.at_wavelength(traced.wavelength_m, job.radar.waveform.wavelength_m)
        effects = recipe.effects if isinstance(recipe, StoredFrame) else job.scenes[recipe.scene].effects
        processing = effects.processing(processing)
        illuminated = table.within(job.radar).illuminated(effects.front_end(job.radar.front_end))
        paths = pruned(illuminated, job.radar, job.prune_db)
        known = stages.object_targets(paths, len(paths.objects) - traced.point_targets, job.radar)
        counts.update(lit_cells(paths, job.radar))
    counts.update({**paths.counts, "frames": 1, "paths": len(paths)})
    seconds["paths"] += time.perf_counter() - started
    started = time.perf_counter()
    measurement = stages.measure(setting, paths, known, job.radar, processing, generator(seed, "noise"))
    seconds["cube and truth"] += time.perf_counter() - started
    return measurement


def trace_frame(job: Job, frame_id: int, recipe: SceneFrame) -> TracedFrame:
    """Pose and multipath of a scene frame, independent of the radar but for its wavelength."""
    work, seed = job.scenes[recipe.scene], frame_seed(job.seed, frame_id)
    pose = recipe.pose
    if pose is None:
        assert work.ground is not None  # the pipeline finds the ground wherever poses are drawn
        pose = sample_pose(work.ground, job.splits[frame_id], generator(seed, "pose"))
    rays = generator(seed, "rays")
    fan = RayFan(job.trace.rays, offset=(float(rays.random()), float(rays.random())))
    waveform, solver_seed = job.radar.waveform, int(rays.integers(2**31))
    front_end = job.radar.front_end
    polarization = (front_end.tx_polarization, front_end.rx_polarization)
    settings = replace(work.effects.trace(job.trace), polarization=polarization)
    table = trace(work.stage, work.materials, pose, waveform.mid_sweep_hz, settings, fan, solver_seed)
    return TracedFrame(frame_id, work.name, seed, pose, waveform.wavelength_m, len(work.stage.targets), table)


def _stored(recipe: StoredFrame) -> TracedFrame:
    return next(islice(read_paths(recipe.shard), recipe.row, None))


def trace_shard(
    job: Job, plan: ShardPlan, directory: Path, fingerprint: str, report: Callable[[int], None]
) -> tuple[FinishedShard, dict[str, float]]:
    """Write one shard of traced paths; returns what :func:`render_shard` does."""
    counts: Counter[str] = Counter()
    started = time.perf_counter()

    def rows() -> Iterator[pa.Table]:
        for frame_id in plan.frame_ids:
            recipe = job.recipes[frame_id]
            assert isinstance(recipe, SceneFrame)  # only scenes are traced
            traced = trace_frame(job, frame_id, recipe)
            counts.update({**traced.table.counts, "frames": 1, "paths": len(traced.table)})
            yield pa.Table.from_pylist([to_row(traced)], schema=job.schema)
            report(1)

    with threadpool_limits(limits=1):
        record = write_tables(directory / plan.path, rows(), job.schema, compression="zstd")
    seconds = {"paths": time.perf_counter() - started}
    return FinishedShard(record=record, counts=dict(counts), fingerprint=fingerprint), seconds
