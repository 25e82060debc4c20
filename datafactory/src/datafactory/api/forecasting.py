"""What a run will take, before it is begun: ``datafactory render --dry-run``.

Time follows from counted work (:mod:`datafactory.accuracy.work`), so that the same run has the same forecast on every
machine; only the one rate by which work becomes seconds is a measurement.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import psutil

from datafactory.accuracy.knobs import KnobSettings
from datafactory.accuracy.work import counted_work, trace_work
from datafactory.frame.deal import split_of
from datafactory.run.order import Order
from datafactory.run.preparation import deal_of
from datafactory.run.room import CLOSE_TARGETS, STREETS, free_bytes, trace_memory
from datafactory.run.shards import plan_shards
from datafactory.run.stored import stored_paths
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from shared.dataset import description, row_bytes

RATE = 4e9
"""Multiply-adds of counted work that a core does in a second: 2.7e9 and 4.1e9 in runs of 80 frames and of one on a
shared two-core machine. A forecast is right within a factor of two or three."""
PATHS_A_RAY = 0.4
"""Paths of a frame for each ray, after thinning and pruning: 0.13 in open streets, 0.68 in a narrow one."""
TARGETS = 10.0
"""Paths of a close-target frame, hardly any work."""


@dataclass(frozen=True)
class Forecast:
    """What a run will take.

    :param frames: by split; :param shards: their number
    :param bytes: on the disk, of which ``free_bytes`` are free
    :param memory_bytes: of all workers together, where the machine has ``machine_bytes``
    :param seconds: wall-clock, planning included
    :param workers: no more than there are shards
    """

    frames: dict[str, int]
    shards: int
    bytes: float
    free_bytes: float
    memory_bytes: float
    machine_bytes: float
    seconds: float
    workers: int

    def lines(self) -> list[str]:
        """In words."""
        split = ", ".join(f"{name} {count}" for name, count in self.frames.items())
        most = "process" if self.workers == 1 else "processes"
        return [
            f"{sum(self.frames.values())} frames ({split}) in {self.shards} shards",
            f"about {_amount(self.bytes)} on the disk, where {_amount(self.free_bytes)} are free",
            f"about {_amount(self.memory_bytes)} of memory in {self.workers} {most}; this machine has "
            f"{_amount(self.machine_bytes)}",
            f"about {_duration(self.seconds)}, by counted work; half or twice that would be no surprise",
        ]


def forecast(order: Order, directory: Path, workers: int) -> Forecast:
    """What a run of this order will take; its scenes are opened and its frames dealt, nothing is traced or written.

    :raises InputError: what a run would refuse of its scenes, poses and split
    """
    if order.paths is None:
        scenes = [scene if isinstance(scene, Scene) else open_scene(scene) for scene in order.scenes]
        deal = deal_of(order, scenes)
        splits, scene_frames, point_frames = deal.splits(), deal.scene_frames, len(deal) - deal.scene_frames
        for frame_id in {deal.frames_of(number)[0] for number in range(len(scenes)) if deal.frames_of(number)}:
            deal.frame(frame_id)  # a scene without free ground is refused here
    else:
        scene_frames = len(stored_paths(order, order.paths).places)
        point_frames = len(order.targets) or order.points
        splits = tuple(split_of(frame_id, order.split) for frame_id in range(scene_frames + point_frames))
    settings = order.settings
    knobs = KnobSettings(rays=settings.trace.rays, depth=settings.trace.depth)
    paths = PATHS_A_RAY * settings.trace.rays
    of_scene = counted_work(knobs, paths, order.radar) - (trace_work(knobs) if order.paths is not None else 0.0)
    of_points = counted_work(knobs, TARGETS, order.radar) - trace_work(knobs)
    planning = 0.0 if order.effects is not None or order.paths is not None else trace_work(knobs) * len(order.scenes)
    shapes = description(order.radar, settings.processing.peaks, settings.processing.store)["shapes"]
    shards = len(plan_shards(splits))
    workers = min(workers, shards)
    return Forecast(
        frames=dict(Counter(splits)),
        shards=shards,
        bytes=row_bytes(shapes) * (STREETS * scene_frames + CLOSE_TARGETS * point_frames),
        free_bytes=free_bytes(directory),
        memory_bytes=trace_memory(settings.trace.rays if scene_frames and order.paths is None else 0, workers),
        machine_bytes=float(psutil.virtual_memory().total),
        seconds=(planning + (scene_frames * of_scene + point_frames * of_points) / workers) / RATE,
        workers=workers,
    )


def _amount(size: float) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.0f} MB"


def _duration(seconds: float) -> str:
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"
