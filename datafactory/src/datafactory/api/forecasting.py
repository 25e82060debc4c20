"""What a run will take, before it is begun: ``datafactory render --dry-run``.

Paths are not known before a frame is traced. So time follows from rates of one machine: seconds a ray, a path and a
sample, by which the same run has the same forecast everywhere.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from datafactory.defaults import CPU
from datafactory.frame.deal import dealt
from datafactory.run.memory import (
    CLOSE_TARGETS,
    STREETS,
    amount,
    frame_bytes,
    free_bytes,
    most_workers,
    processes,
    statement,
)
from datafactory.run.preparation import Order, load_of, opened_scenes
from datafactory.run.shards import parse_job, plan_shards
from shared.dataset.locations import Location, RemotePath
from shared.processes.machine import usable_memory

RAY_S = 7e-6
"""Of a ray: 0.8 to 2.1 s for 2e5 of them in a canyon, munich and the shipped street (a manifest's ``step_seconds``)."""
PATH_S = 1.3e-5
"""Of a path's share in cube and truth of the default radar: 2.0 s for 1.5e5 paths."""
SAMPLE_S = 7e-8
"""Of a sample of the cube, in receiver, spectra and image: 0.45 s for 48 x 128 x 1024."""
CHANNELS = 48 + 256
"""Of the default radar and its truth, which ``PATH_S`` is for."""
PATHS_A_RAY = 0.7
"""Paths of a frame for each ray, after thinning and pruning: 0.60 to 0.78 in the same three scenes."""


@dataclass(frozen=True)
class Forecast:
    """What a run will take.

    :param frames: by split; :param shards: their number
    :param bytes: on the disk, of which ``free_bytes`` are free; None in an object store
    :param memory_bytes: of all processes together; ``memory``: in words, and how much may be used
    :param seconds: wall-clock
    :param workers: no more than there are frames, cores and memory for
    :param device: that the run will use
    """

    frames: dict[str, int]
    shards: int
    bytes: float
    free_bytes: float | None
    memory_bytes: float
    memory: str
    seconds: float
    workers: int
    device: str = CPU

    def lines(self) -> list[str]:
        """In words."""
        split = ", ".join(f"{name} {count}" for name, count in self.frames.items())
        rates = "rates of another machine" if self.device == CPU else "rates of a CPU, for none of a GPU were measured"
        where = "in the store"
        if self.free_bytes is not None:
            where = f"on the disk, where {amount(self.free_bytes)} are free"
        return [
            f"{sum(self.frames.values())} frames ({split}) in {self.shards} shards",
            f"about {amount(self.bytes)} {where}",
            self.memory,
            f"about {_duration(self.seconds)}, by {rates}; half or twice that would be no surprise",
        ]


def forecast(order: Order, directory: Location, workers: int, shard: str | None = None) -> Forecast:
    """What a run of this order will take; its scenes are opened and its frames dealt, nothing is traced or written.

    :param workers: 0 for as many as there are cores and memory for
    :param shard: of :func:`datafactory.render`: what this job will take
    :raises InputError: what a run would refuse of its scenes, poses and split
    """
    scenes = opened_scenes(order)
    deal = dealt(order, scenes)
    for frame_id in {deal.frames_of(number)[0] for number in range(len(scenes)) if deal.frames_of(number)}:
        deal.frame(frame_id)  # a scene without free ground is refused here
    splits, scene_frames = deal.splits(), deal.scene_frames
    settings, waveform, channels = order.settings, order.radar.waveform, order.radar.array.channels
    rays = float(settings.trace.rays)
    of_points = SAMPLE_S * channels * waveform.chirps * waveform.samples
    synthesis = PATH_S * PATHS_A_RAY * rays * (channels + order.radar.virtual_sensor.channels) / CHANNELS
    of_scene = of_points + synthesis + (RAY_S * rays if order.traced is None else 0.0)
    plans = plan_shards(splits)
    if shard is not None:
        plans = parse_job(shard).own(plans)
        own = {frame_id for plan in plans for frame_id in plan.frame_ids}
        splits = tuple(split for frame_id, split in enumerate(splits) if frame_id in own)
        scene_frames = sum(frame_id < scene_frames for frame_id in own)
    shards, point_frames = len(plans), len(splits) - scene_frames
    load, limit = load_of(order, sum(scene.triangle_count for scene in scenes)), usable_memory()
    workers = min(workers or min(processes(0, settings.device), max(1, most_workers(load, limit))), len(splits))
    return Forecast(
        frames=dict(Counter(splits)),
        shards=shards,
        bytes=frame_bytes(order.radar, settings.processing) * (STREETS * scene_frames + CLOSE_TARGETS * point_frames),
        free_bytes=None if isinstance(directory, RemotePath) else free_bytes(directory),
        memory_bytes=load.total_bytes(workers),
        memory=statement(load, workers, limit),
        seconds=(scene_frames * of_scene + point_frames * of_points) / workers,
        workers=workers,
        device=settings.device,
    )


def _duration(seconds: float) -> str:
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"
