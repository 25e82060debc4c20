"""Datasets and traced paths, :func:`datafactory.render` and :func:`datafactory.trace`; what is done with finished ones,
:func:`datafactory.convert` and :func:`datafactory.merge`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from datafactory.accuracy.budget import check, settle
from datafactory.accuracy.knobs import Menu, menu_for
from datafactory.api.asking import materials_of, order_of
from datafactory.api.options import ConvertOptions, MergeOptions, OrderOptions, RenderOptions, TraceOptions
from datafactory.api.turns import in_turn
from datafactory.defaults import AUTO_DEVICE, CPU, CUDA, LOCAL
from datafactory.run import merging, pipeline
from datafactory.run.pipeline import Execution, Report
from datafactory.run.portions import opened
from datafactory.run.preparation import Order
from datafactory.run.shards import OPTION, parse_job
from datafactory.scenes.materials.table import MaterialTable
from datafactory.scenes.scene import Scene
from shared.dataset.folder import open_dataset
from shared.dataset.locations import local, locate
from shared.dataset.writing import atomic_folder
from shared.physics.errors import InputError
from shared.processes.declared import common, taking
from shared.processes.telling import Progress

MCAP = "mcap"


@dataclass(frozen=True)
class Converted:
    """What was written.

    :param frames: frames in the new layout
    :param notes: what has no place in it, with counts, and what was assumed
    """

    directory: Path
    frames: int
    notes: tuple[str, ...] = ()


@taking(RenderOptions)
@in_turn
def render(asked: RenderOptions) -> Report:
    """Render frames of scenes, and close-target frames beside them, into a dataset, as ``datafactory render`` does.

    Threads of a process take turns: a call begins once no other thread is in ``render``, ``trace`` or ``plan``.

    >>> report = render("scenes/tiny.usda", "build/two", frames=2)  # doctest: +SKIP

    :returns: what was made; the frames are read by :class:`trainer.RadarDataset` or any Parquet reader
    :raises InputError: anything wrong with the arguments or their files, before anything is written
    :raises OSError: the disk or the store fails; what was finished can be resumed
    :raises RunFailed: worker processes died; what was finished can be resumed
    """
    order = order_of(asked)
    if asked.camera and asked.shard is not None:
        raise InputError("--camera", f"beside {OPTION}", "datafactory inspect --camera once the jobs are merged")
    # Of stored paths it is that of the effects alone: their trace has settled rays and depth.
    swept = asked.error_budget is not None and asked.paths is None
    menu = menu_for(asked.rays, asked.depth) if swept else None
    report = _made(asked, order, menu)
    return _with_cameras(order, report, asked.progress) if asked.camera else report


@taking(TraceOptions)
@in_turn
def trace(asked: TraceOptions) -> Report:
    """Trace multipath into ``out/paths``, for ``render(None, ..., paths=out)`` with any radar.

    Of the radar only wavelength and polarisation matter, with ``error_budget`` also its antennas and resolution.
    :func:`datafactory.read_paths` reads the paths themselves. Errors are those of :func:`datafactory.render`.
    """
    menu = None if asked.error_budget is None else menu_for(asked.rays, asked.depth).of_paths()
    order = order_of(common(OrderOptions, asked), synthesis=False)
    return _made(asked, replace(order, paths_alone=True), menu)


def _made(asked: RenderOptions | TraceOptions, order: Order, menu: Menu | None) -> Report:
    """The job, on the engine and the device that were asked for.

    :raises InputError: a job that cannot be; a GPU on a cluster: its nodes do not share one
    """
    table, device = materials_of(asked.materials), order.settings.device
    with opened(asked.engine, asked.address, asked.announce) as engine:
        if device == CUDA and engine.name != LOCAL:
            raise InputError("--device", f"{device} beside --engine {engine.name}", f"{CPU}, or --engine {LOCAL}")
        job = None if asked.shard is None else parse_job(asked.shard)
        execution = Execution(
            directory=locate(asked.out) / job.folder if job else locate(asked.out), workers=asked.workers,
            resume=asked.resume, keep_going=asked.keep_going, job=job, engine=engine, announce=asked.announce,
            advance=asked.progress,
        )  # fmt: skip
        if asked.device == AUTO_DEVICE:
            asked.announce(f"device: {device}")
        if device == CUDA and asked.workers > 1:
            asked.announce(f"{asked.workers} workers share one GPU, and its memory")
        if menu is None:
            return pipeline.render(order, table, execution)
        return _within_budget(order, table, execution, menu)


def _with_cameras(order: Order, report: Report, progress: Progress) -> Report:
    """The pictures of a camera at the sensor beside a finished run; those that are there are kept."""
    from datafactory.view.camera import Cameras, write_cameras  # where needed: Matplotlib takes a quarter of a second

    started = time.perf_counter()
    dataset = open_dataset(report.directory)
    cameras = Cameras(dataset, [scene for scene in order.scenes if isinstance(scene, Scene)])
    progress("camera pictures", 0, order.scene_frames)
    for done, _ in enumerate(write_cameras(dataset, cameras), 1):
        progress("camera pictures", done, order.scene_frames)
    return replace(report, seconds=report.seconds + time.perf_counter() - started)


def _within_budget(order: Order, table: MaterialTable, execution: Execution, menu: Menu) -> Report:
    """The job, its settings chosen from a menu; what they achieved is measured afterwards."""
    started, announce = time.perf_counter(), execution.announce
    settled = settle(order, table, order.budget_db, menu, announce, execution.advance)
    report = pipeline.render(settled.order, table, execution)
    if execution.job is None:
        check(settled, execution.directory, announce)
    else:  # the frames to be looked at are those of other jobs as well
        announce("what the error budget achieves is measured of a run in one piece alone, not of its jobs")
    return replace(report, seconds=time.perf_counter() - started)


@taking(ConvertOptions)
def convert(asked: ConvertOptions) -> Converted:
    """Write a dataset in another layout, as ``datafactory convert`` does.

    >>> convert("build/dataset", "build/mcap", to="mcap")  # doctest: +SKIP

    :returns: how many frames were written, and what has no place in the new layout
    :raises InputError: an unknown format, a folder that is there already, a package that is not installed
    :raises OSError: the disk fails; nothing is left behind
    """
    dataset, out = open_dataset(str(asked.directory)), local(asked.out, "--out")
    if asked.to != MCAP:
        raise InputError("--to", f"{asked.to!r}", MCAP)
    if out.exists():
        raise InputError("--out", f"{out} is there already", "a folder that does not exist yet")
    dataset.description()  # refuses a folder of traced paths
    try:
        from datafactory.conversion import write_mcap
    except ImportError as error:
        expected = "it: pip install 'sparseradar-datafactory[convert]'"
        raise InputError("--to mcap", "needs the package foxglove-sdk, which is not installed", expected) from error
    with atomic_folder(out) as partly:  # the new folder is there once it is whole
        return Converted(out, *write_mcap(dataset, partly, partial(asked.progress, "frames")))


@taking(MergeOptions)
def merge(asked: MergeOptions) -> Report:
    """Join the jobs of an array into the dataset of the run in one piece, as ``datafactory merge`` does.

    >>> merge("build/jobs", "build/dataset")  # doctest: +SKIP

    :returns: what is in the dataset; its shards and its manifest, but for ``made``, have the bytes of the run in one
        piece
    :raises InputError: frames or jobs are missing, arguments differ, shards are damaged, the disk has no room; before
        anything is written
    :raises OSError: the disk fails; what was done can be resumed
    """
    several = [asked.folders] if isinstance(asked.folders, str | Path) else asked.folders
    folders, out = [local(folder, "DIR") for folder in several], local(asked.out, "--out")
    return merging.merge(folders, out, asked.resume, asked.announce, asked.progress)
