"""Counted work beside measured processor time, stage by stage: whether the price list's unit is one.

    python tests/benchmarks/counted.py [--paths 30000] [--repeats 3] [--rays 100000]

A row's rate is its counted multiply-adds over its seconds. Were every loop counted right, all rows had one rate.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits
from workloads import street

from datafactory.accuracy.knobs import DEFAULT
from datafactory.accuracy.work import cube_work, frame_work, trace_work, truth_work
from datafactory.frame.defaults import IMAGE_BATCH
from datafactory.synthesis.cube import cube_of_sorted
from datafactory.synthesis.sorting import sorted_paths
from datafactory.synthesis.truth import truth_moments
from shared.radar import Radar
from shared.signal.imaging import near_field_images
from shared.signal.spectrum import range_doppler, select_doppler

Measured = tuple[str, float, Callable[[], object]]


def signals(radar: Radar, paths: int) -> Iterator[Measured]:
    """Name, counted work and call of the stages after tracing."""
    for speed in (0.0, 2.5, 10.0):
        for count in (paths // 10, paths):
            table = street(count, speed)
            for tolerance in (1e-3, 1e-4, 1e-6, 1e-9):
                if (speed == 2.5 and tolerance != 1e-3) or (tolerance == 1e-9 and count != paths // 10):
                    continue
                groups = sorted_paths(table, radar, tolerance, radar.array, intra_chirp=False)
                yield (
                    f"cube, {count} paths, {speed:g} m/s, {tolerance:g}",
                    cube_work(groups, radar, tolerance, radar.array, intra_chirp=False).total,
                    partial(cube_of_sorted, groups, radar, tolerance, radar.array, 1, intra_chirp=False),
                )
            groups = sorted_paths(table, radar, 1e-3, radar.array, intra_chirp=False)
            cube = cube_of_sorted(groups, radar, 1e-3, radar.array, 1, intra_chirp=False)
            cells = select_doppler(range_doppler(cube, radar), 0.0).cells[0]
            yield (
                f"truth, {count} paths, {speed:g} m/s",
                truth_work(table, radar, cells, DEFAULT.truth_terms, intra_chirp=False).total,
                partial(truth_moments, table, radar, cells),
            )
    moments = np.tile(truth_moments(table, radar, cells), (IMAGE_BATCH, 1, 1, 1))

    def spectra_and_images() -> None:
        for _ in range(IMAGE_BATCH):
            range_doppler(cube, radar)
        near_field_images(moments, radar, radar.virtual_sensor)

    yield f"{IMAGE_BATCH} times spectra, and images", IMAGE_BATCH * frame_work(DEFAULT, radar), spectra_and_images


def tracing(radar: Radar, rays: int) -> Measured:
    """The same of a ray's bounces in the shipped street."""
    from datafactory.frame.chain import SceneSource
    from datafactory.paths.backend import select_variant, set_threads
    from datafactory.run.order import Order
    from datafactory.run.preparation import prepare
    from datafactory.scenes.materials.table import load_materials

    select_variant()
    set_threads(1)
    scene = Path(__file__).resolve().parents[2] / "scenes" / "street.usda"
    prepared = prepare(
        Order(radar=radar, scenes=(str(scene),), frames=4, effects=DEFAULT.effects), load_materials(None)
    )
    settings = replace(DEFAULT, rays=rays)
    source = SceneSource(prepared.deal.frame(0), prepared.scenes[0], settings.chain())
    return f"trace, {rays} rays of the street", trace_work(settings), lambda: source.traced(radar)


def main(
    paths: Annotated[int, typer.Option(help="Of the synthetic street.")] = 30_000,
    repeats: Annotated[int, typer.Option(help="Of which the median is taken.")] = 3,
    rays: Annotated[int, typer.Option(help="Traced in the shipped street; 0 leaves it out.")] = 100_000,
) -> None:
    """Print counted work and processor seconds of every stage, and their ratio."""
    radar = Radar()
    table = Table("stage", "counted", "seconds", "counted a second", title="one core, processor time")
    with threadpool_limits(limits=1):
        for name, counted, call in [*signals(radar, paths), *([tracing(radar, rays)] if rays else [])]:
            call()
            seconds = []
            for _ in range(repeats):
                started = time.process_time()
                call()
                seconds.append(time.process_time() - started)
            table.add_row(name, f"{counted:.3g}", f"{median(seconds):.3f}", f"{counted / median(seconds):.3g}")
    Console(width=140).print(table)


if __name__ == "__main__":
    typer.run(main)
