"""What a run will take, before it is begun: ``datafactory render --dry-run``.

Paths are not known before a frame is traced. So time follows from the rates of one machine by which an error budget
chooses, see :func:`datafactory.accuracy.prices.work`: the same run has the same forecast everywhere.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from datafactory.accuracy.knobs import KnobSettings
from datafactory.accuracy.prices import trace_work, work
from datafactory.defaults import CPU
from datafactory.run.memory import (
    CLOSE_TARGETS,
    STREETS,
    amount,
    frame_bytes,
    require_room,
    room,
    statement,
    workers_for,
)
from datafactory.run.preparation import Recipe
from datafactory.run.shards import parse_job
from shared.dataset.locations import Location, RemotePath
from shared.processes.machine import usable_memory

RECEIVER_S = 1.7e-8
"""Of a sample of the cube, noise and converter: 0.11 s for 48 x 128 x 1024 (``receiver`` of a manifest's
``step_seconds``, 14 frames of munich: docs/notes/costs.md)."""
PATHS_A_RAY = 0.7
"""Paths of a frame for each ray, after thinning and pruning: 0.60 to 0.78 in a canyon, munich and the shipped
street."""

START_S, OPEN_S = 6.0, 6e-5
"""Before the first frame: imports, compiled kernels and the tracer; and of a triangle of the scenes, which are read and
searched for edges and corners. 8.5, 9.6 and 23 s for the street of 29 000 triangles, munich of 39 000 and Sionna's
san_francisco of 268 000, by ``datafactory render --scene sionna:munich --frames 1 --rays 1000 --workers 1``, kernels
compiled, on 2026-11-28."""


@dataclass(frozen=True)
class Forecast:
    """What a run will take.

    :param frames: by split; :param shards: their number
    :param bytes: on the disk, where there is ``room`` for so many; None in an object store
    :param memory: of all processes together, and how much may be used
    :param seconds: wall-clock
    :param workers: no more than there are frames, cores and memory for
    :param device: that the run will use
    """

    frames: dict[str, int]
    shards: int
    bytes: float
    room: float | None
    memory: str
    seconds: float
    workers: int
    device: str = CPU

    def lines(self) -> list[str]:
        """In words."""
        split = ", ".join(f"{name} {count}" for name, count in self.frames.items())
        rates = "rates of another machine" if self.device == CPU else "rates of a CPU, for none of a GPU were measured"
        where = "in the store"
        if self.room is not None:
            where = f"on the disk, where {amount(self.room)} are free"
            if self.bytes > self.room:
                where += ": the disk will probably be full before the run is done"
        return [
            f"{sum(self.frames.values())} frames ({split}) in {self.shards} shards",
            f"about {amount(self.bytes)} {where}",
            self.memory,
            f"about {_duration(self.seconds)}, by {rates}; half or twice that would be no surprise",
        ]


def forecast(recipe: Recipe, directory: Location, workers: int, shard: str | None = None) -> Forecast:
    """What a run will take; nothing is traced or written.

    :param workers: 0 for as many as there are cores and memory for
    :param shard: of :func:`datafactory.render`: what this job will take
    :raises InputError: what a run would refuse of its scenes, poses and split; frames that fit neither the disk nor the
        memory
    """
    job, plans = recipe.job, recipe.plans
    deal, radar, settings, load, limit = job.deal, job.radar, job.settings, job.load, usable_memory()
    for number in range(deal.scenes):
        for frame_id in deal.frames_of(number)[:1]:
            deal.frame(frame_id)  # a scene without free ground is refused here
    knobs = KnobSettings.of(settings)
    tracing = trace_work(knobs)
    receiving = RECEIVER_S * radar.array.channels * radar.waveform.chirps * radar.waveform.samples
    of_points = receiving + work(knobs, 0.0, radar) - tracing  # a few targets are no work
    of_scene = receiving + work(knobs, PATHS_A_RAY * knobs.rays, radar) - (tracing if deal.stored else 0.0)
    if shard is not None:
        array_job = parse_job(shard)
        plans, directory = array_job.own(plans), directory / array_job.folder
    frames = Counter[str]()
    for plan in plans:
        frames[plan.split] += len(plan.frame_ids)
    require_room(directory, frames.total(), radar, job.of_scenes.processing)
    scene_frames = sum(frame_id < deal.scene_frames for plan in plans for frame_id in plan.frame_ids)
    point_frames = frames.total() - scene_frames
    workers = min(workers_for(load, workers), frames.total())
    return Forecast(
        frames=dict(frames),
        shards=len(plans),
        bytes=frame_bytes(radar, settings.processing) * (STREETS * scene_frames + CLOSE_TARGETS * point_frames),
        room=None if isinstance(directory, RemotePath) else room(directory),
        memory=statement(load, workers, limit),
        seconds=START_S + OPEN_S * load.triangles + (scene_frames * of_scene + point_frames * of_points) / workers,
        workers=workers,
        device=settings.device,
    )


def _duration(seconds: float) -> str:
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"
