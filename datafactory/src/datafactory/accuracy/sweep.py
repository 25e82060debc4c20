"""The sweep: one knob at a time away from a converged reference, its price and its error.

Signal knobs share the paths of the pipeline's own tracing, unpruned, and are held against a cube of 1e-11 and a truth
whose Doppler filter and range walk are exact. Power knobs change the paths and with them the speckle; their error is
that of the power in resolution cells (:mod:`datafactory.accuracy.power`). Everything is varied around the effects that
the scene's plan calls for; an effect's row is the difference that it makes to the frame as planned.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from datafactory.accuracy.clock import STAGES, Clock
from datafactory.accuracy.errors import detections_changed, level_db, peak_error, relative_l2
from datafactory.accuracy.knobs import CONVERGED, DEFAULT, REFERENCE_DEPTH, Knob, KnobSettings
from datafactory.accuracy.looking import Outcome, reference_of, run, write_seconds
from datafactory.accuracy.power import Effort, Kept, power_error
from datafactory.accuracy.samples import SampleFrame, traced
from datafactory.accuracy.work import counted_work
from datafactory.effects.catalogue import NAMES
from datafactory.paths.storage import TracedFrame
from shared.radar import Radar

SAME_PATHS = "same paths: cube at 1e-11 in complex128, truth by the virtual sensor's whole cube"
DEFAULTS = "defaults"
Advance = Callable[[int, int, str], None]


@dataclass(frozen=True)
class Row:
    """One setting of one knob, measured; errors are the largest over the frames.

    :param seconds: a frame on one core; :param stage_seconds: the same by stage
    :param cube_error_db: relative L2; for power knobs of the amplitudes in cells, rms over realisations
    :param image_error_db: largest difference over the peak; for power knobs of the amplitudes in cells, mean over
        realisations
    :param image_l2_db: relative L2 of the images; for power knobs as ``cube_error_db``
    :param power_l1_db, power_l1_range_weighted_db: for power knobs sum |P - P_ref| / sum P_ref over cells [dB], mean
        over realisations; the second with both weighted by range^4
    :param power_bias_db: total power over the reference's [dB]
    :param detections_changed: [%] of the truth's cells above noise; for power knobs the speckle's change is in it
    :param doppler_rows_changed: [%] of the image rows with a detection whose strongest Doppler cell is another
    :param peak_mb: growth of the resident set [MB], see :mod:`datafactory.accuracy.clock`
    :param work: counted multiply-adds; :param paths: mean over the frames, after pruning
    :param reference: what the errors are held against
    :param approximation: whether the setting is one; False where it adds an effect that the plan leaves out
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
    power_l1_db: float | None
    power_l1_range_weighted_db: float | None
    power_bias_db: float
    detections_changed: float
    doppler_rows_changed: float
    peak_mb: float
    paths: float
    work: float
    reference: str
    approximation: bool


@dataclass(frozen=True)
class _Step:
    """A row to be measured.

    :param value: as it is shown
    """

    label: str
    value: str
    settings: KnobSettings
    default: bool
    knob: Knob | None = None

    @property
    def approximation(self) -> bool:
        return self.knob is None or self.knob.name not in NAMES or self.value == _shown(False)


def sweep(
    samples: Sequence[SampleFrame],
    signal: Sequence[Knob],
    power: Sequence[Knob],
    effort: Effort,
    radar: Radar,
    advance: Advance = lambda done, total, label: None,
    usual: KnobSettings = DEFAULT,
) -> list[Row]:
    """Measure every setting of every knob on the samples, on one core; the defaults together come first.

    :param advance: takes settings done, settings in all, and what is being measured
    :param usual: how the run makes its frames
    """
    default = replace(usual, rays=effort.rays)
    converged = replace(default, prune_db=CONVERGED.prune_db, truth_terms=CONVERGED.truth_terms)
    steps = _steps(signal, default, converged, "all")
    powers = _steps(power, default, default, "all, power")
    rows: list[Row] = []
    total = len(steps) + len(powers)
    with threadpool_limits(limits=1):
        advance(0, total, "reference")
        _warm_up(samples[0], default, radar)
        clock = Clock(effort.repeats)
        frames = [clock("trace", partial(traced, sample, default, radar)) for sample in samples]
        reference = reference_of(frames, converged, radar)
        fixed = {"trace": clock.seconds()["trace"]}
        kept: dict[Any, Any] = {}
        run(frames, converged, radar, Clock(effort.repeats, kept, keep=True), reference.cells, effort.batch)
        fixed["write"] = write_seconds(reference.frames[0], radar, max(3, effort.repeats))
        for step in steps:
            advance(len(rows), total, f"{step.label} {step.value}")
            rows.append(_signal_row(step, frames, reference, fixed, effort, radar, kept))
        del reference, kept
        realisations: Kept = {}
        as_made = run(frames[:1], default, radar, Clock(), batch=1)
        for step in powers:
            advance(len(rows), total, f"{step.label} {step.value}")
            rows.append(_power_row(step, default, samples, as_made, fixed, effort, radar, realisations))
    advance(total, total, "done")
    return rows


def _steps(knobs: Sequence[Knob], default: KnobSettings, base: KnobSettings, everything: str) -> list[_Step]:
    """The defaults together, then every value of every knob away from ``base``.

    Whatever rays the sweep itself is made with, the pipeline's default is marked.
    """
    pipeline = replace(default, rays=DEFAULT.rays)
    return [
        _Step(DEFAULTS, everything, default, True),
        *(
            _Step(knob.label, _shown(value), knob.at(base, value), knob.at(pipeline, value) == pipeline, knob)
            for knob in knobs
            for value in knob.values
        ),
    ]


def _shown(value: Any) -> str:
    return str(value) if not isinstance(value, bool) else "on" if value else "off"


def power_reference(knob: Knob | None, settings: KnobSettings, default: KnobSettings, effort: Effort) -> KnobSettings:
    """What a power setting is held against.

    Number and lattice of the rays against the densest fan of the same depth; depth against the deepest, effects and
    surfaces against the default, both with the same rays; the defaults against the densest and deepest.
    """
    if knob is None:
        return replace(default, rays=effort.reference_rays, depth=REFERENCE_DEPTH)
    if not knob.paired:
        return replace(settings, rays=effort.reference_rays, lattice="fan")
    return replace(default, depth=REFERENCE_DEPTH) if knob.name == "depth" else default


def _signal_row(
    step: _Step,
    frames: Sequence[TracedFrame],
    reference: Outcome,
    fixed: dict[str, float],
    effort: Effort,
    radar: Radar,
    kept: dict[Any, Any],
) -> Row:
    clock = Clock(effort.repeats, kept)
    outcome = run(frames, step.settings, radar, clock, reference.cells, effort.batch)
    stages = {**fixed, **clock.seconds()}
    pairs = list(zip(outcome.images, reference.images, strict=True))
    expected = replace(outcome, images=reference.images).detections(radar)
    paths = float(np.mean(outcome.paths))
    return Row(
        knob=step.label,
        setting=step.value,
        default=step.default,
        kind="signal",
        seconds=sum(stages.values()),
        stage_seconds={name: stages[name] for name in STAGES},
        cube_error_db=_worst([relative_l2(a, b) for a, b in zip(outcome.cubes, reference.cubes, strict=True)]),
        image_error_db=_worst([peak_error(a, b) for a, b in pairs]),
        image_l2_db=_worst([relative_l2(a, b) for a, b in pairs]),
        power_l1_db=None,
        power_l1_range_weighted_db=None,
        power_bias_db=_widest([float((a**2).sum() / (b**2).sum()) if b.any() else 1.0 for a, b in pairs]),
        detections_changed=_changed(outcome.detections(radar), expected),
        doppler_rows_changed=_moved(outcome.cells, reference.cells, expected),
        peak_mb=clock.peak_mb(),
        paths=paths,
        work=counted_work(step.settings, paths, radar),
        reference=SAME_PATHS,
        approximation=step.approximation,
    )


def _power_row(
    step: _Step,
    default: KnobSettings,
    samples: Sequence[SampleFrame],
    usual: Outcome,
    fixed: dict[str, float],
    effort: Effort,
    radar: Radar,
    kept: Kept,
) -> Row:
    settings = step.settings
    against = power_reference(step.knob, settings, default, effort)
    paired = step.knob is not None and step.knob.paired
    errors = [power_error(sample, settings, against, effort, radar, kept, paired) for sample in samples]
    clock = Clock(effort.repeats)
    frame = clock("trace", lambda: traced(samples[0], settings, radar))
    outcome = run([frame], settings, radar, clock, batch=effort.batch)
    stages = {**fixed, **clock.seconds()}
    paths = float(outcome.paths[0])
    return Row(
        knob=step.label,
        setting=step.value,
        default=step.default,
        kind="power",
        seconds=sum(stages.values()),
        stage_seconds={name: stages[name] for name in STAGES},
        cube_error_db=_worst([error.l2 for error in errors]),
        image_error_db=_worst([error.peak for error in errors]),
        image_l2_db=_worst([error.l2 for error in errors]),
        power_l1_db=0.5 * _worst([error.l1 for error in errors]),
        power_l1_range_weighted_db=0.5 * _worst([error.l1_range_weighted for error in errors]),
        power_bias_db=_widest([error.total for error in errors]),
        detections_changed=_changed(outcome.detections(radar), usual.detections(radar)),
        doppler_rows_changed=_moved(outcome.cells, usual.cells, usual.detections(radar)),
        peak_mb=clock.peak_mb(),
        paths=paths,
        work=counted_work(settings, paths, radar),
        reference=_reference_text(against, effort, paired),
        approximation=step.approximation,
    )


def _reference_text(against: KnobSettings, effort: Effort, paired: bool) -> str:
    realisations = f"{effort.realisations} realisations" + ("" if paired else " or more")
    if paired:
        return f"same {against.rays} rays, depth {against.depth}, effects as planned: cell power, {realisations}"
    return (
        f"fan of {against.rays} rays, depth {against.depth}, mean of {effort.reference_realisations}: cell power, "
        f"{realisations}"
    )


def _warm_up(sample: SampleFrame, settings: KnobSettings, radar: Radar) -> None:
    """Everything is compiled once before it is timed."""
    few = replace(settings, rays=1000, prune_db=0.0)
    frame = traced(sample, few, radar)
    for tolerance in (1e-6, 1e-9):
        run([frame], replace(few, tolerance=tolerance), radar, Clock(), batch=1)


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
