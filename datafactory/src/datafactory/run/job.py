"""What a worker process does: the frames of one shard, from the deal to a file."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TypeVar

import pyarrow as pa
from threadpoolctl import threadpool_limits

from datafactory.effects.plan import EffectPlan
from datafactory.frame.chain import ChainSettings, PointSource, SceneSource, Source, StoredSource, make_frames
from datafactory.frame.deal import Deal
from datafactory.frame.prepared import PreparedScene
from datafactory.paths.storage import to_row, writer_options
from datafactory.run.memory import Load
from datafactory.run.progress import FinishedShard
from datafactory.run.shards import ShardPlan, write_shard, write_tables
from shared.dataset import Frame
from shared.dataset.locations import Location
from shared.processes.tasks import StepsDone
from shared.radar import Radar

Value = TypeVar("Value")


@dataclass(frozen=True)
class Job:
    """Everything that determines the frames' bytes.

    :param deal: which frame is which
    :param scenes: those that are traced; none where paths were traced before
    :param plans: what is simulated of every scene
    :param settings: of the run, with every effect; point frames are made with these
    :param stored: shard and row of every scene frame whose paths were traced before
    :param schema_message: Arrow's schema message; a pickled :class:`pyarrow.Schema` forgets that the elements of its
        lists are never null, which would cost every reader a quarter of its time
    """

    radar: Radar
    deal: Deal
    scenes: tuple[PreparedScene, ...]
    plans: tuple[EffectPlan, ...]
    settings: ChainSettings
    stored: tuple[tuple[Location, int], ...]
    schema_message: bytes

    @property
    def schema(self) -> pa.Schema:
        """Of the shards."""
        return pa.ipc.read_schema(pa.py_buffer(self.schema_message))

    @property
    def load(self) -> Load:
        """What decides over the memory of a process that makes its frames."""
        triangles = sum(len(mesh.triangles) for scene in self.scenes for mesh in scene.merged.meshes)
        rays = self.settings.trace.rays if self.stored else 0
        return Load(self.radar, self.settings, triangles, traced=bool(self.scenes), stored_rays=rays)

    def source(self, frame_id: int) -> Source:
        """Where a frame comes from."""
        frame = self.deal.frame(frame_id)
        if frame.kind == "points":
            return PointSource(frame, self.settings)
        settings = self.plans[frame.scene].settings(self.settings, frame.pose)
        if self.stored:
            return StoredSource(*self.stored[frame_id], settings)
        return SceneSource(frame, self.scenes[frame.scene], settings)


@dataclass
class StepSeconds:
    """A hook of the chain that adds up seconds by step and tells of every frame that needs only its image.

    :param report: called with 1 for each
    """

    report: StepsDone
    seconds: dict[str, float] = field(default_factory=lambda: defaultdict(float))

    def __call__(self, step: str, function: Callable[..., Value], *arguments: object) -> Value:
        started = time.perf_counter()
        value = function(*arguments)
        self.seconds[step] += time.perf_counter() - started
        if step == "truth":
            self.report(1)
        return value


def render_shard(
    job: Job, plan: ShardPlan, directory: Location, fingerprint: str, report: StepsDone
) -> tuple[FinishedShard, dict[str, float]]:
    """Write one shard; returns its record with the counts of its frames, and the seconds that each step took.

    :param report: called with 1 for every frame that is finished but for its image
    """
    counts: Counter[str] = Counter()
    hook = StepSeconds(report)
    started = time.perf_counter()

    def frames() -> Iterator[Frame]:
        sources = (job.source(frame_id) for frame_id in plan.frame_ids)
        for frame, counted in make_frames(sources, job.radar, hook):
            counts.update(counted)
            yield frame

    with threadpool_limits(limits=1):
        record = write_shard(directory / plan.path, frames(), job.schema)
    rest = time.perf_counter() - started - sum(hook.seconds.values())
    finished = FinishedShard(record=record, counts=dict(counts), fingerprint=fingerprint)
    return finished, {**hook.seconds, "write and between": rest}


def trace_shard(
    job: Job, plan: ShardPlan, directory: Location, fingerprint: str, report: StepsDone
) -> tuple[FinishedShard, dict[str, float]]:
    """Write one shard of traced paths; returns what :func:`render_shard` does."""
    counts: Counter[str] = Counter()
    started = time.perf_counter()

    def rows() -> Iterator[pa.Table]:
        for frame_id in plan.frame_ids:
            source = job.source(frame_id)
            assert isinstance(source, SceneSource)  # only scenes are traced
            traced = source.traced(job.radar)
            counts.update({**traced.table.counts, "frames": 1, "paths": len(traced.table)})
            yield pa.Table.from_pylist([to_row(traced)], schema=job.schema)
            report(1)

    with threadpool_limits(limits=1):
        record = write_tables(directory / plan.path, rows(), job.schema, **writer_options())
    seconds = {"trace and write": time.perf_counter() - started}
    return FinishedShard(record=record, counts=dict(counts), fingerprint=fingerprint), seconds


WriteShard = Callable[[Job, ShardPlan, Location, str, StepsDone], tuple[FinishedShard, dict[str, float]]]
"""What makes a shard: :func:`render_shard` or :func:`trace_shard`."""
