"""The sweep: one knob at a time away from a converged reference, its price and its error.

Signal knobs share the paths of the pipeline's own tracing, unpruned, and are held against a cube of 1e-11 and a truth
whose Doppler filter and range walk are exact. Power knobs change the paths and with them the speckle; their error is
that of the amplitude in a resolution cell, sqrt(mean power), averaged over the same realisations for every setting.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from datafactory.accuracy import chain
from datafactory.accuracy.errors import detections_changed, level_db, peak_error, relative_l2
from datafactory.accuracy.knobs import CONVERGED, DEFAULT, REFERENCE_DEPTH, Knob, Settings
from datafactory.accuracy.probes import Probe, mean_cell_power, traced
from datafactory.accuracy.work import counted_work
from datafactory.frames import IMAGE_BATCH
from datafactory.paths.table import PathTable
from shared.radar import Radar

SAME_PATHS = "same paths: cube at 1e-11 in complex128, truth by the virtual sensor's whole cube"
Advance = Callable[[int, int, str], None]
Means = dict[tuple[int, Settings], tuple[NDArray[np.float64], float]]
"""Mean cell power and number of paths, by frame and settings."""


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    :param reference_rays: rays of the converged tracing
    :param realisations: of the rays, averaged in power
    :param repeats: of each timed stage and frame
    :param batch: frames that share the image stage
    :param rays: of every setting that does not state its own
    """

    reference_rays: int
    realisations: int = 4
    repeats: int = 1
    batch: int = IMAGE_BATCH
    rays: int = DEFAULT.rays


@dataclass(frozen=True)
class Row:
    """One setting of one knob, measured; errors are the largest over the frames.

    :param seconds: a frame on one core; :param stage_seconds: the same by stage
    :param cube_error_db: relative L2; for power knobs of the cells' mean amplitudes
    :param image_error_db: largest difference over the peak; for power knobs of the cells' mean amplitudes
    :param image_l2_db: relative L2 of the images; for power knobs as ``cube_error_db``
    :param power_bias_db: total power over the reference's [dB]
    :param detections_changed: [%] of the truth's cells above noise; for power knobs the speckle's change is in it
    :param doppler_rows_changed: [%] of the image rows with a detection whose strongest Doppler cell is another
    :param peak_mb: growth of the resident set [MB], see :mod:`datafactory.accuracy.chain`
    :param work: counted multiply-adds; :param paths: mean over the frames, after pruning
    :param reference: what the errors are held against
    """

    knob: str
    setting: str
    default: bool
    kind: str
    seconds: float
    stage_seconds: dict[str, float]
    cube_error_db: float
    image_error_db: float
    image_l2_db: float
    power_bias_db: float
    detections_changed: float
    doppler_rows_changed: float
    peak_mb: float
    paths: float
    work: float
    reference: str


def sweep(
    probes: Sequence[Probe],
    signal: Sequence[Knob],
    power: Sequence[Knob],
    effort: Effort,
    radar: Radar,
    advance: Advance = lambda done, total, label: None,
) -> list[Row]:
    """Measure every setting of every knob on the probes, on one core; the defaults together come first.

    :param advance: takes settings done, settings in all, and what is being measured
    """
    default = replace(DEFAULT, rays=effort.rays, video_phase=radar.waveform.residual_video_phase)
    converged = replace(CONVERGED, rays=effort.rays, video_phase=default.video_phase)
    steps = [("defaults", "all", default), *((k.name, v, k.at(converged, v)) for k in signal for v in k.values)]
    powers = [
        ("defaults", "all, power", None, default),
        *((k.name, v, k, k.at(default, v)) for k in power for v in k.values),
    ]
    rows: list[Row] = []
    total = len(steps) + len(powers)
    with threadpool_limits(limits=1):
        advance(0, total, "reference")
        _warm_up(probes[0], default, radar)
        clock = chain.Clock(effort.repeats)
        tables = [clock("trace", partial(traced, probe, default, radar)) for probe in probes]
        reference = chain.reference_of(tables, converged, radar)
        fixed = {"trace": clock.seconds()["trace"]}
        kept: dict[Any, Any] = {}
        chain.run(tables, converged, radar, chain.Clock(effort.repeats, kept, keep=True), reference, effort.batch)
        fixed["write"] = chain.write_seconds(reference.cubes[0], reference.images[0], radar, max(3, effort.repeats))
        for knob, value, settings in steps:
            advance(len(rows), total, f"{knob} {value}")
            rows.append(_signal_row(knob, value, settings, default, tables, reference, fixed, effort, radar, kept))
        del reference, kept
        means: Means = {}
        usual = chain.run(tables[:1], default, radar, chain.Clock(), batch=1)
        for name, value, power_knob, settings in powers:
            advance(len(rows), total, f"{name} {value}")
            against = power_reference(power_knob, settings, effort)
            errors = [power_error(probe, settings, against, effort, radar, means) for probe in probes]
            about = (
                f"fan of {against.rays} rays, depth {against.depth}: cell power over {effort.realisations} realisations"
            )
            rows.append(
                _power_row(name, value, settings, default, probes[0], usual, errors, fixed, about, effort, radar)
            )
    advance(total, total, "done")
    return rows


def power_reference(knob: Knob | None, settings: Settings, effort: Effort) -> Settings:
    """What a power setting is held against.

    Number and lattice of the rays against the densest fan of the same depth; depth and effects against all of them
    with the same rays, whose sampling error is then common to both and cancels; the defaults against all of it.
    """
    complete = replace(settings, specular=True, diffuse=True, lattice="fan")
    if knob is None:
        return replace(complete, rays=effort.reference_rays, depth=REFERENCE_DEPTH)
    if knob.name in ("rays", "lattice"):
        return replace(complete, rays=effort.reference_rays)
    return replace(complete, depth=REFERENCE_DEPTH)


def power_error(
    probe: Probe,
    settings: Settings,
    against: Settings,
    effort: Effort,
    radar: Radar,
    means: Means,
    first: int = 0,
) -> tuple[float, float, float]:
    """(largest over peak, relative L2, total power ratio) of the mean amplitudes in resolution cells.

    :param means: what was averaged before, by frame and settings; added to
    :param first: number of the first realisation
    """
    for wanted in (settings, against):
        if (probe.frame_id, wanted) not in means:
            numbers = range(first, first + effort.realisations)
            means[probe.frame_id, wanted] = mean_cell_power(probe, wanted, radar, numbers)
    value, reference = means[probe.frame_id, settings][0], means[probe.frame_id, against][0]
    ratio = float(value.sum() / reference.sum()) if reference.any() else 1.0
    return peak_error(np.sqrt(value), np.sqrt(reference)), relative_l2(np.sqrt(value), np.sqrt(reference)), ratio


def _signal_row(
    knob: str,
    value: Any,
    settings: Settings,
    default: Settings,
    tables: Sequence[PathTable],
    reference: chain.Reference,
    fixed: dict[str, float],
    effort: Effort,
    radar: Radar,
    kept: dict[Any, Any],
) -> Row:
    clock = chain.Clock(effort.repeats, kept)
    outcome = chain.run(tables, settings, radar, clock, reference, effort.batch)
    stages = {**fixed, **clock.seconds()}
    pairs = list(zip(outcome.images, reference.images, strict=True))
    expected = replace(outcome, images=reference.images).detections(radar)
    paths = float(np.mean(outcome.paths))
    return Row(
        knob=knob,
        setting=str(value),
        default=_is_default(knob, value, default),
        kind="signal",
        seconds=sum(stages.values()),
        stage_seconds={name: stages[name] for name in chain.STAGES},
        cube_error_db=_worst([relative_l2(a, b) for a, b in zip(outcome.cubes, reference.cubes, strict=True)]),
        image_error_db=_worst([peak_error(a, b) for a, b in pairs]),
        image_l2_db=_worst([relative_l2(a, b) for a, b in pairs]),
        power_bias_db=_widest([float((a**2).sum() / (b**2).sum()) if b.any() else 1.0 for a, b in pairs]),
        detections_changed=_changed(outcome.detections(radar), expected),
        doppler_rows_changed=_moved(outcome.cells, reference.cells, expected),
        peak_mb=clock.peak_mb(),
        paths=paths,
        work=counted_work(settings, paths, radar),
        reference=SAME_PATHS,
    )


def _power_row(
    knob: str,
    value: Any,
    settings: Settings,
    default: Settings,
    probe: Probe,
    usual: chain.Outcome,
    errors: Sequence[tuple[float, float, float]],
    fixed: dict[str, float],
    about: str,
    effort: Effort,
    radar: Radar,
) -> Row:
    clock = chain.Clock(effort.repeats)
    table = clock("trace", lambda: traced(probe, settings, radar))
    outcome = chain.run([table], settings, radar, clock, batch=effort.batch)
    stages = {**fixed, **clock.seconds()}
    worst, l2, ratio = zip(*errors, strict=True)
    paths = float(outcome.paths[0])
    return Row(
        knob=knob,
        setting=str(value),
        default=_is_default(knob, value, default),
        kind="power",
        seconds=sum(stages.values()),
        stage_seconds={name: stages[name] for name in chain.STAGES},
        cube_error_db=_worst(l2),
        image_error_db=_worst(worst),
        image_l2_db=_worst(l2),
        power_bias_db=_widest(ratio),
        detections_changed=_changed(outcome.detections(radar), usual.detections(radar)),
        doppler_rows_changed=_moved(outcome.cells, usual.cells, usual.detections(radar)),
        peak_mb=clock.peak_mb(),
        paths=paths,
        work=counted_work(settings, paths, radar),
        reference=about,
    )


def _warm_up(probe: Probe, settings: Settings, radar: Radar) -> None:
    """Everything is compiled once before it is timed."""
    few = replace(settings, rays=1000, prune_db=0.0)
    table = traced(probe, few, radar)
    for tolerance in (1e-6, 1e-9):
        chain.run([table], replace(few, tolerance=tolerance), radar, chain.Clock(), batch=1)


def _worst(ratios: Sequence[float]) -> float:
    return level_db(max(ratios))


def _widest(ratios: Sequence[float]) -> float:
    """The power ratio furthest from 1, in dB."""
    return max((0.5 * level_db(ratio) for ratio in ratios), key=abs)


def _changed(values: Sequence[NDArray[np.bool_]], expected: Sequence[NDArray[np.bool_]]) -> float:
    return max(detections_changed(a, b) for a, b in zip(values, expected, strict=True))


def _moved(
    cells: Sequence[NDArray[np.int64]], expected: Sequence[NDArray[np.int64]], detections: Sequence[NDArray[np.bool_]]
) -> float:
    """Rows with a detection whose Doppler cell is another, in percent of all rows with one."""
    changed = [(a != b)[map_.any(axis=1)] for a, b, map_ in zip(cells, expected, detections, strict=True)]
    every = np.concatenate(changed)
    return 100.0 * float(every.mean()) if len(every) else 0.0


def _is_default(knob: str, value: Any, default: Settings) -> bool:
    """Whether this is what the pipeline does, whatever rays the sweep itself is made with."""
    return knob == "defaults" or getattr(replace(default, rays=DEFAULT.rays), knob) == value
