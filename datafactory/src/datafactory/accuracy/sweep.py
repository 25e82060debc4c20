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
from threadpoolctl import threadpool_limits

from datafactory.accuracy.clock import STAGES, Advance, Clock, in_turn
from datafactory.accuracy.errors import peak_error, relative_l2
from datafactory.accuracy.front import EVERYTHING, KNOBS, LEVELS_DB, described, fronts
from datafactory.accuracy.knobs import DEFAULT, REFERENCE_DEPTH, Knob, KnobSettings, converged
from datafactory.accuracy.looking import Outcome, reference_of, run, write_seconds
from datafactory.accuracy.power import Effort, Kept, power_error
from datafactory.accuracy.prices import Choice, Price, power_price, signal_price
from datafactory.accuracy.row import DEFAULTS, SAME_PATHS, Row, changed, moved, widest, worst
from datafactory.accuracy.samples import SampleFrame, traced
from datafactory.accuracy.work import Work, frame_work, trace_work
from datafactory.effects.catalogue import NAMES
from datafactory.paths.storage import TracedFrame
from shared.radar import Radar


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

    @property
    def is_a_change(self) -> bool:
        """Whether it does something else, instead of the same better or worse."""
        return self.knob is not None and self.knob.name not in KNOBS


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
    base = converged(default)
    steps = _steps(signal, default, base, "all")
    powers = _steps(power, default, default, "all, power")
    rows, prices = list[Row](), list[Price]()
    total = len(steps) + len(powers) + 2 * len(LEVELS_DB)
    with threadpool_limits(limits=1):
        advance(0, total, "reference")
        frame = _warm_up(samples[0], default, radar)
        for settings in dict.fromkeys(replace(step.settings, prune_db=0.0) for step in steps):
            run([frame], settings, radar, Clock(), batch=1)  # so does every kernel
        clock = Clock(effort.repeats)
        frames = [clock("trace", partial(traced, sample, default, radar)) for sample in samples]
        reference = reference_of(frames, base, radar)
        fixed = {"trace": clock.seconds()["trace"]}
        kept: dict[Any, Any] = {}
        run(frames, base, radar, Clock(effort.repeats, kept, keep=True), reference.cells, effort.batch)
        fixed["write"] = write_seconds(reference.frames[0], radar, max(3, effort.repeats))
        for step in steps:
            advance(len(rows), total, f"{step.label} {step.value}")
            row, outcome = _signal_row(step, base, frames, reference, fixed, effort, radar, kept)
            rows.append(row)
            if step.knob is not None and step.knob.name in KNOBS:
                prices.append(signal_price(step.knob.name, float(step.value), outcome, reference))
        del kept
        realisations: Kept = {}
        as_made = run(frames[:1], default, radar, Clock(), batch=1)
        for step in powers:
            advance(len(rows), total, f"{step.label} {step.value}")
            row, errors = _power_row(step, default, samples, as_made, fixed, effort, radar, realisations)
            rows.append(row)
            if step.knob is not None and step.label in KNOBS:
                prices.append(power_price(step.label, float(step.value), errors, row.paths))
        for name, level, choice in fronts(prices, default, effort, radar):
            advance(len(rows), total, f"{name} {level:g} dB")
            rows.append(_front_row(name, level, choice, default, samples, frames, reference, fixed, effort, radar))
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
    base: KnobSettings,
    frames: Sequence[TracedFrame],
    reference: Outcome,
    fixed: dict[str, float],
    effort: Effort,
    radar: Radar,
    kept: dict[Any, Any],
) -> tuple[Row, Outcome]:
    def made(settings: KnobSettings, by: Clock) -> Outcome:
        return run(frames, settings, radar, by, reference.cells, effort.batch)

    outcome, stages, beside, peak_mb = _timed(step, base, made, fixed, effort, kept)
    pairs = zip(outcome.images, reference.images, strict=True)
    row = Row(
        knob=step.label,
        setting=step.value,
        default=step.default,
        kind="signal",
        seconds=sum(stages.values()),
        stage_seconds=stages,
        seconds_beside=beside,
        **_against(outcome, reference, radar),
        power_error_db=None,
        power_l1_db=None,
        power_l1_range_weighted_db=None,
        power_bias_db=widest([float((a**2).sum() / (b**2).sum()) if b.any() else 1.0 for a, b in pairs]),
        peak_mb=peak_mb,
        paths=float(np.mean(outcome.paths)),
        work=_work(step.settings, outcome, radar),
        reference=SAME_PATHS,
        approximation=step.approximation,
    )
    return row, outcome


def _power_row(
    step: _Step,
    default: KnobSettings,
    samples: Sequence[SampleFrame],
    usual: Outcome,
    fixed: dict[str, float],
    effort: Effort,
    radar: Radar,
    kept: Kept,
) -> tuple[Row, list[float]]:
    settings = step.settings
    against = power_reference(step.knob, settings, default, effort)
    paired = step.knob is not None and step.knob.paired
    errors = [power_error(sample, settings, against, effort, radar, kept, paired) for sample in samples]
    made = partial(_from_rays, samples[0], radar, effort)
    outcome, stages, beside, peak_mb = _timed(step, default, made, fixed, effort)
    row = Row(
        knob=step.label,
        setting=step.value,
        default=step.default,
        kind="power",
        seconds=sum(stages.values()),
        stage_seconds=stages,
        seconds_beside=beside,
        cube_error_db=worst([error.l2 for error in errors]),
        image_error_db=worst([error.peak for error in errors]),
        image_l2_db=worst([error.l2 for error in errors]),
        power_error_db=worst([error.peak for error in errors]),
        power_l1_db=0.5 * worst([error.l1 for error in errors]),
        power_l1_range_weighted_db=0.5 * worst([error.l1_range_weighted for error in errors]),
        power_bias_db=widest([error.total for error in errors]),
        detections_changed=changed(outcome.detections(radar), usual.detections(radar)),
        doppler_rows_changed=moved(outcome.cells, usual.cells, usual.detections(radar)),
        peak_mb=peak_mb,
        paths=float(outcome.paths[0]),
        work=_work(settings, outcome, radar),
        reference=_reference_text(against, effort, paired),
        approximation=step.approximation,
    )
    return row, [error.peak for error in errors]


def _front_row(
    name: str,
    level_db: float,
    choice: Choice,
    default: KnobSettings,
    samples: Sequence[SampleFrame],
    frames: Sequence[TracedFrame],
    reference: Outcome,
    fixed: dict[str, float],
    effort: Effort,
    radar: Radar,
) -> Row:
    """A point of the front: its errors of cube and image on the frames traced as by default, all settings at once; that
    of the power as its rays and depth have it alone; its time with its own rays."""
    chosen = choice.settings
    signal = replace(default, prune_db=chosen.prune_db, tolerance=chosen.tolerance, truth_terms=chosen.truth_terms)
    settings = replace(signal, rays=chosen.rays, depth=chosen.depth)
    _warm_up(samples[0], settings, radar)
    clock = Clock(effort.repeats)
    timed = _from_rays(samples[0], radar, effort, settings, clock)
    stages = _by_stage(fixed, clock)
    outcome = run(frames, signal, radar, Clock(), reference.cells, effort.batch)
    return Row(
        knob=name,
        setting=f"{level_db:g} dB: {described(settings)}",
        default=settings == replace(default, rays=DEFAULT.rays),
        kind="front",
        seconds=sum(stages.values()),
        stage_seconds=stages,
        seconds_beside=None,
        **_against(outcome, reference, radar),
        power_error_db=choice.predicted.power_db if name == EVERYTHING else None,
        power_l1_db=None,
        power_l1_range_weighted_db=None,
        power_bias_db=0.0,
        peak_mb=clock.peak_mb(),
        paths=float(timed.paths[0]),
        work=_work(settings, timed, radar),
        reference=f"{SAME_PATHS}; power as in the rows of rays and depth",
        approximation=True,
    )


def _against(outcome: Outcome, reference: Outcome, radar: Radar) -> dict[str, float]:
    """The errors of cubes and images made from the reference's paths."""
    cubes = list(zip(outcome.cubes, reference.cubes, strict=True))
    images = list(zip(outcome.images, reference.images, strict=True))
    expected = replace(outcome, images=reference.images).detections(radar)
    return {
        "cube_error_db": worst([relative_l2(a, b) for a, b in cubes]),
        "image_error_db": worst([peak_error(a, b) for a, b in images]),
        "image_l2_db": worst([relative_l2(a, b) for a, b in images]),
        "detections_changed": changed(outcome.detections(radar), expected),
        "doppler_rows_changed": moved(outcome.cells, reference.cells, expected),
    }


def _from_rays(sample: SampleFrame, radar: Radar, effort: Effort, settings: KnobSettings, clock: Clock) -> Outcome:
    """A frame, its trace included."""
    return run([clock("trace", partial(traced, sample, settings, radar))], settings, radar, clock, batch=effort.batch)


def _timed(
    step: _Step,
    without: KnobSettings,
    made: Callable[[KnobSettings, Clock], Outcome],
    fixed: dict[str, float],
    effort: Effort,
    kept: dict[Any, Any] | None = None,
) -> tuple[Outcome, dict[str, float], float | None, float]:
    """What a step's settings make, its seconds by stage, those of the frame beside it, and its memory [MB].

    :param without: settings of the frame that a change is timed in turn with
    :param kept: stages that other steps share with the frame around which they are varied
    """
    if not step.is_a_change:
        clock = Clock(effort.repeats, kept)
        return made(step.settings, clock), _by_stage(fixed, clock), None, clock.peak_mb()
    outcome, clock, beside = in_turn(effort.in_turn, partial(made, step.settings), partial(made, without))
    return outcome, _by_stage(fixed, clock), sum(_by_stage(fixed, beside).values()), clock.peak_mb()


def _by_stage(fixed: dict[str, float], clock: Clock) -> dict[str, float]:
    seconds = fixed | clock.seconds()
    return {name: seconds[name] for name in STAGES}


def _work(settings: KnobSettings, outcome: Outcome, radar: Radar) -> float:
    """Counted multiply-adds of one frame, mean over those made."""
    signal = sum((*outcome.cube_work, *outcome.truth_work), Work())
    return trace_work(settings) + frame_work(settings, radar) + signal.total / len(outcome.paths)


def _reference_text(against: KnobSettings, effort: Effort, paired: bool) -> str:
    realisations = f"{effort.realisations} realisations" + ("" if paired else " or more")
    if paired:
        return f"same {against.rays} rays, depth {against.depth}, effects as planned: cell power, {realisations}"
    return (
        f"fan of {against.rays} rays, depth {against.depth}, mean of {effort.reference_realisations}: cell power, "
        f"{realisations}"
    )


def _warm_up(sample: SampleFrame, settings: KnobSettings, radar: Radar) -> TracedFrame:
    """The frame, traced before it is timed: the solver compiles for every number of rays and of bounces."""
    return traced(sample, settings, radar)
