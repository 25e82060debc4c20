"""Datasets and traced paths: :func:`datafactory.render` and :func:`datafactory.trace`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from typing import TypeAlias

from datafactory.accuracy.budget import menu_for, settle
from datafactory.accuracy.check import check
from datafactory.accuracy.prices import Menu
from datafactory.api.asking import (
    Announce,
    Effects,
    FileName,
    MaterialsLike,
    PosesLike,
    Progress,
    RadarLike,
    SceneLike,
    TrajectoryLike,
    choice,
    materials_of,
    order_of,
    require,
    silent,
)
from datafactory.effects.catalogue import AUTO
from datafactory.frame.defaults import DEFAULT_FRAMES
from datafactory.frame.points import PointTargets
from datafactory.paths.defaults import AUTO_DEVICE, CPU, CUDA
from datafactory.run import pipeline
from datafactory.run.array_job import OPTION, parse_job
from datafactory.run.engines import ENGINES, LOCAL, Engine, opened
from datafactory.run.order import Order
from datafactory.run.pipeline import Execution, Report
from datafactory.scenes.materials.table import MaterialTable
from datafactory.scenes.scene import Scene
from shared.dataset import STORES
from shared.dataset.folder import open_dataset
from shared.dataset.locations import locate
from shared.physics.errors import InputError
from shared.processes.defaults import DEFAULT_RADAR

Make: TypeAlias = Callable[[Order, MaterialTable, Execution], Report]
"""A job of :mod:`datafactory.run.pipeline`."""


def render(
    scenes: SceneLike | Sequence[SceneLike] | None,
    out: FileName,
    *,
    paths: FileName | None = None,
    radar: RadarLike = DEFAULT_RADAR,
    frames: int = DEFAULT_FRAMES,
    points: int = 0,
    targets: Sequence[PointTargets] = (),
    poses: PosesLike | None = None,
    trajectory: TrajectoryLike | None = None,
    frame_rate: float | None = None,
    seed: int = 0,
    split: str | None = None,
    materials: MaterialsLike | None = None,
    rays: int | None = None,
    depth: int | None = None,
    effects: Effects = AUTO,
    error_budget: float | None = None,
    noise: bool = True,
    store: str = STORES[0],
    truth_window: str = "taylor-30",
    license: str | None = None,
    workers: int = 1,
    engine: str = LOCAL,
    address: str | None = None,
    device: str = CPU,
    resume: bool = False,
    keep_going: bool = False,
    shard: str | None = None,
    camera: bool = False,
    announce: Announce = silent,
    progress: Progress = silent,
) -> Report:
    """Render frames of scenes, and close-target frames beside them, into a dataset, as ``datafactory render`` does.

    >>> report = render("scenes/tiny.usda", "build/two", frames=2)  # doctest: +SKIP

    :param scenes: one scene or several, dealt to the frames in turn; None with ``paths`` or for close targets alone
    :param out: folder of the dataset, local or ``s3://`` or ``gs://``; new or empty, or with ``resume`` that of an
        unfinished run
    :param paths: folder of :func:`datafactory.trace`, local or a URI, instead of ``scenes``: the same paths again
    :param radar: a preset's name, a TOML file, or a :class:`shared.radar.Radar`
    :param frames: scene frames in total, where no poses are given
    :param points: close-target frames after them
    :param targets: frames of exactly these point targets, instead of ``points`` drawn ones
    :param poses: one frame a pose, in the world frame [m, deg, m/s]; else they are drawn on free ground
    :param trajectory: sequences of frames along tracks: a file of poses with times, several, or ``"drive"`` to draw
        drives along the scenes' streets, ``frames`` frames in all
    :param frame_rate: frames a second along the tracks [Hz]; by default a frame for each row of a file, 10 of drives
    :param seed: of the dataset: same seed, same bytes
    :param split: pattern train:validation:test over the frames; by default 6:1:1, or that of ``paths``
    :param materials: overrides the material table
    :param rays: of a frame, over the field of view; 200 000 by default
    :param depth: largest number of bounces; 2 by default
    :param effects: what is simulated: "auto" for what each scene calls for, "all", or names
    :param error_budget: choose rays, depth, pruning, tolerance and truth terms for this error [dB] from a sweep made
        once; ``rays`` and ``depth`` stay as given. None sweeps nothing.
    :param noise: add receiver noise
    :param store: "range-channel", "range-doppler" or "cube": what else to keep
    :param truth_window: over the virtual sensor: "none", "taylor-25", "taylor-30" or "hann"
    :param license: of the data, an SPDX identifier as "CC-BY-4.0", for the dataset's card and manifest; by default none
        is stated: frames belong to whoever owns the scenes
    :param workers: processes; 1 works in this process, 0 takes one for each core where there is memory for so many,
        with "cuda" one. The bytes do not depend on it. On a cluster: shards at work at a time, 0 for as many as its
        nodes have cores and memory for.
    :param engine: "local", or "ray" for a Ray cluster; the bytes do not depend on it
    :param address: HOST:PORT of the cluster, which this machine is a node of; None for the one that runs here, or for
        a Ray that is started on this machine and ends with the run
    :param device: where rays are traced and signals made: "cpu", "cuda", or "auto" for CUDA where it can be used. The
        bytes depend on it: it stands in the manifest, and a run is resumed on the same one alone.
    :param resume: go on with an unfinished run in the same folder, on either engine
    :param keep_going: finish the other shards where three worker processes died of one
    :param shard: "i/n": make the shards of job i of n alone, i from 0, into ``out/job-i-of-n``;
        :func:`datafactory.merge` joins the jobs to the dataset of the run in one piece
    :param camera: also write what a camera at the sensor sees, ``out/camera/frame-NNNNNN.png`` for each scene frame;
        ``datafactory inspect`` shows it beside the images. The shards stay the same.
    :param announce: takes lines for the user
    :param progress: takes what is being done, how much of it is done, and of how much
    :returns: what was made; the frames are read by :class:`trainer.RadarDataset` or any Parquet reader
    :raises InputError: anything wrong with the arguments or their files, before anything is written
    :raises OSError: the disk or the store fails; what was finished can be resumed
    :raises RunFailed: worker processes died; what was finished can be resumed
    """
    order = order_of(
        scenes, paths=paths, radar=radar, frames=frames, points=points, targets=targets, poses=poses,
        trajectory=trajectory, frame_rate=frame_rate, seed=seed, split=split, rays=rays, depth=depth, effects=effects,
        error_budget=error_budget, noise=noise, store=store, truth_window=truth_window, device=device, license=license,
    )  # fmt: skip
    if camera and shard is not None:
        raise InputError("--camera", f"beside {OPTION}", "datafactory inspect --camera once the jobs are merged")
    menu = None if error_budget is None else menu_for(rays, depth)
    table = materials_of(materials)
    with engine_of(engine, address, workers, announce) as made_by:
        execution = execution_of(
            out, workers, resume, keep_going, shard, announce, progress, made_by, order.settings.device
        )
        _say_device(device, execution, order)
        report = _made(order, table, execution, menu, progress, pipeline.render)
    return _with_cameras(order, table, report, progress) if camera else report


def trace(
    scenes: SceneLike | Sequence[SceneLike],
    out: FileName,
    *,
    radar: RadarLike = DEFAULT_RADAR,
    frames: int = DEFAULT_FRAMES,
    poses: PosesLike | None = None,
    trajectory: TrajectoryLike | None = None,
    frame_rate: float | None = None,
    seed: int = 0,
    split: str | None = None,
    materials: MaterialsLike | None = None,
    rays: int | None = None,
    depth: int | None = None,
    effects: Effects = AUTO,
    error_budget: float | None = None,
    workers: int = 1,
    engine: str = LOCAL,
    address: str | None = None,
    device: str = CPU,
    resume: bool = False,
    keep_going: bool = False,
    shard: str | None = None,
    announce: Announce = silent,
    progress: Progress = silent,
) -> Report:
    """Trace multipath into ``out/paths``, for ``render(None, ..., paths=out)`` with any radar.

    Of the radar only wavelength and polarisation matter, with ``error_budget`` also its antennas and resolution.
    :func:`datafactory.paths.storage.read_paths` reads the paths themselves. Arguments and errors are those of
    :func:`datafactory.render`.
    """
    order = order_of(
        scenes, radar=radar, frames=frames, poses=poses, trajectory=trajectory, frame_rate=frame_rate, seed=seed,
        split=split, rays=rays, depth=depth, effects=effects, error_budget=error_budget, device=device,
        synthesis=False,
    )  # fmt: skip
    menu, table = None if error_budget is None else menu_for(rays, depth).of_paths(), materials_of(materials)
    with engine_of(engine, address, workers, announce) as made_by:
        execution = execution_of(
            out, workers, resume, keep_going, shard, announce, progress, made_by, order.settings.device
        )
        _say_device(device, execution, order)
        return _made(order, table, execution, menu, progress, pipeline.trace_paths)


def engine_of(engine: str, address: str | None, workers: int, announce: Announce) -> AbstractContextManager[Engine]:
    """Where shards are made, from the beginning of the block to its end.

    :raises InputError: an unknown name, a number of workers that cannot be; see :func:`datafactory.run.engines.opened`
    """
    require("--workers", workers, 0)
    return opened(choice("--engine", engine, ENGINES), address, announce)


def execution_of(
    out: FileName,
    workers: int,
    resume: bool,
    keep_going: bool,
    shard: str | None,
    announce: Announce,
    progress: Progress,
    engine: Engine,
    device: str = CPU,
) -> Execution:
    """How a run is carried out.

    :param shard: of :func:`render`
    :raises InputError: a number of workers or a job that cannot be; a GPU on a cluster: its nodes do not share one
    """
    require("--workers", workers, 0)
    if device == CUDA and engine.name != LOCAL:
        raise InputError("--device", f"{device} beside --engine {engine.name}", f"{CPU}, or --engine {LOCAL}")
    job = None if shard is None else parse_job(shard)
    return Execution(
        locate(out) / job.folder if job else locate(out),
        workers,
        resume,
        keep_going,
        job,
        engine,
        announce=announce,
        looked=partial(progress, "planning"),
        advance=partial(progress, "frames"),
    )


def _say_device(asked: str, execution: Execution, order: Order) -> None:
    """What was found for ``auto``, and what processes share."""
    device = order.settings.device
    if asked == AUTO_DEVICE:
        execution.announce(f"device: {device}")
    if device == CUDA and execution.workers > 1:
        execution.announce(f"{execution.workers} workers share one GPU, and its memory")


def _with_cameras(order: Order, table: MaterialTable, report: Report, progress: Progress) -> Report:
    """The pictures of a camera at the sensor beside a finished run; those that are there are kept."""
    from datafactory.view.cameras import Cameras, write_cameras  # where needed: Matplotlib takes a quarter of a second

    started = time.perf_counter()
    dataset = open_dataset(report.directory)
    cameras = Cameras(dataset, [scene for scene in order.scenes if isinstance(scene, Scene)], table)
    scene_frames = report.frames - order.points
    progress("camera pictures", 0, scene_frames)
    for done, _ in enumerate(write_cameras(dataset, cameras), 1):
        progress("camera pictures", done, scene_frames)
    return replace(report, seconds=report.seconds + time.perf_counter() - started)


def _made(
    order: Order, table: MaterialTable, execution: Execution, menu: Menu | None, progress: Progress, make: Make
) -> Report:
    """The job; with a menu its settings are chosen from it first, and what they achieved is measured afterwards."""
    if menu is None:
        return make(order, table, execution)
    started, announce = time.perf_counter(), execution.announce
    settled = settle(
        order, table, order.budget_db, menu, announce, lambda done, total, label: progress(label, done, total)
    )
    report = make(settled.order, table, execution)
    if execution.job is None:
        check(settled, execution.directory, announce)
    else:  # the frames to be looked at are those of other jobs as well
        announce("what the error budget achieves is measured of a run in one piece alone, not of its jobs")
    return replace(report, seconds=time.perf_counter() - started)
