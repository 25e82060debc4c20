"""One row of the sweep at a time: a frame made as the row says, timed, and held against what it is to be."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from datafactory.accuracy.clock import STAGES, Clock, in_turn
from datafactory.accuracy.errors import peak_error, relative_l2
from datafactory.accuracy.front import EVERYTHING, KNOBS, described
from datafactory.accuracy.knobs import DEFAULT, REFERENCE_DEPTH, Knob, KnobSettings
from datafactory.accuracy.looking import Outcome, run
from datafactory.accuracy.power import Effort, Kept, power_error
from datafactory.accuracy.prices import Choice
from datafactory.accuracy.row import SAME_PATHS, Row, changed, moved, widest, worst
from datafactory.accuracy.samples import SampleFrame, traced
from datafactory.accuracy.work import Work, frame_work, trace_work
from datafactory.paths.storage import TracedFrame
from shared.radar import Radar


@dataclass(frozen=True)
class Step:
    """A row to be measured.

    :param value: as it is shown
    """

    label: str
    value: str
    settings: KnobSettings
    default: bool
    knob: Knob | None = None

    @property
    def is_a_change(self) -> bool:
        """Whether it does something else, instead of the same better or worse."""
        return self.knob is not None and self.knob.name not in KNOBS


def shown(value: Any) -> str:
    """A knob's value as text."""
    return str(value) if not isinstance(value, bool) else "on" if value else "off"


@dataclass(frozen=True)
class Bench:
    """What all rows are measured on.

    :param frames: the samples, traced as by default
    :param reference: made of these, converged
    :param fixed: seconds of tracing them, and of writing
    :param default: how the run makes its frames, with the rays of the sweep
    :param base: converged; what settings of the signal are varied around
    """

    samples: Sequence[SampleFrame]
    frames: Sequence[TracedFrame]
    reference: Outcome
    fixed: dict[str, float]
    default: KnobSettings
    base: KnobSettings
    effort: Effort
    radar: Radar

    def made(self, settings: KnobSettings, clock: Clock) -> Outcome:
        """All frames, from the paths that they have."""
        return run(self.frames, settings, self.radar, clock, self.reference.cells, self.effort.batch)

    def made_from_rays(self, settings: KnobSettings, clock: Clock) -> Outcome:
        """The first frame, its trace included."""
        frame = clock("trace", partial(traced, self.samples[0], settings, self.radar))
        return run([frame], settings, self.radar, clock, batch=self.effort.batch)

    def by_stage(self, clock: Clock) -> dict[str, float]:
        """Seconds of all stages; what the clock did not see is fixed."""
        seconds = self.fixed | clock.seconds()
        return {name: seconds[name] for name in STAGES}

    def against_reference(self, outcome: Outcome) -> dict[str, Any]:
        """The errors of cubes and images made from the reference's paths."""
        reference = self.reference
        cubes = list(zip(outcome.cubes, reference.cubes, strict=True))
        images = list(zip(outcome.images, reference.images, strict=True))
        expected = replace(outcome, images=reference.images).detections(self.radar)
        return {
            "cube_error_db": worst([relative_l2(a, b) for a, b in cubes]),
            "image_error_db": worst([peak_error(a, b) for a, b in images]),
            "image_l2_db": worst([relative_l2(a, b) for a, b in images]),
            "detections_changed": changed(outcome.detections(self.radar), expected),
            "doppler_rows_changed": moved(outcome.cells, reference.cells, expected),
        }

    def work(self, settings: KnobSettings, outcome: Outcome) -> float:
        """Counted multiply-adds of one frame, mean over those made."""
        signal = sum((*outcome.cube_work, *outcome.truth_work), Work())
        return trace_work(settings) + frame_work(settings, self.radar) + signal.total / len(outcome.paths)


def signal_row(bench: Bench, step: Step, kept: dict[Any, Any]) -> tuple[Row, Outcome]:
    """A setting that changes the signal of the same paths.

    :param kept: stages that it may share with the frames around which it is varied
    """
    outcome, seconds = _timed(bench, step, bench.base, bench.made, kept)
    pairs = zip(outcome.images, bench.reference.images, strict=True)
    row = Row(
        knob=step.label,
        setting=step.value,
        default=step.default,
        kind="signal",
        **seconds,
        **bench.against_reference(outcome),
        power_error_db=None,
        power_l1_db=None,
        power_l1_range_weighted_db=None,
        power_bias_db=widest([float((a**2).sum() / (b**2).sum()) if b.any() else 1.0 for a, b in pairs]),
        paths=float(np.mean(outcome.paths)),
        work=bench.work(step.settings, outcome),
        reference=SAME_PATHS,
    )
    return row, outcome


def power_row(bench: Bench, step: Step, usual: Outcome, realisations: Kept) -> tuple[Row, list[float]]:
    """A setting that changes the paths.

    :param usual: the first frame by default
    :param realisations: traced before; those traced here are added
    """
    default, effort, radar = bench.default, bench.effort, bench.radar
    against = power_reference(step.knob, step.settings, default, effort)
    paired = step.knob is not None and step.knob.paired
    errors = [
        power_error(sample, step.settings, against, effort, radar, realisations, paired) for sample in bench.samples
    ]
    outcome, seconds = _timed(bench, step, default, bench.made_from_rays)
    row = Row(
        knob=step.label,
        setting=step.value,
        default=step.default,
        kind="power",
        **seconds,
        cube_error_db=worst([error.l2 for error in errors]),
        image_error_db=worst([error.peak for error in errors]),
        image_l2_db=worst([error.l2 for error in errors]),
        power_error_db=worst([error.peak for error in errors]),
        power_l1_db=0.5 * worst([error.l1 for error in errors]),
        power_l1_range_weighted_db=0.5 * worst([error.l1_range_weighted for error in errors]),
        power_bias_db=widest([error.total for error in errors]),
        detections_changed=changed(outcome.detections(radar), usual.detections(radar)),
        doppler_rows_changed=moved(outcome.cells, usual.cells, usual.detections(radar)),
        paths=float(outcome.paths[0]),
        work=bench.work(step.settings, outcome),
        reference=_reference_text(against, effort, paired),
    )
    return row, [error.peak for error in errors]


def front_row(bench: Bench, name: str, level_db: float, choice: Choice) -> Row:
    """A point of a front: its errors of cube and image on the frames traced as by default, all settings at once; that
    of the power as its rays and depth have it alone; its time with its own rays."""
    default, chosen = bench.default, choice.settings
    signal = replace(default, prune_db=chosen.prune_db, tolerance=chosen.tolerance, truth_terms=chosen.truth_terms)
    settings = replace(signal, rays=chosen.rays, depth=chosen.depth)
    traced(bench.samples[0], settings, bench.radar)  # the solver compiles for every number of rays and of bounces
    clock = Clock(bench.effort.repeats)
    timed = bench.made_from_rays(settings, clock)
    outcome = bench.made(signal, Clock())
    return Row(
        knob=name,
        setting=f"{level_db:g} dB: {described(settings)}",
        default=settings == replace(default, rays=DEFAULT.rays),
        kind="front",
        **_seconds(bench, clock, None),
        **bench.against_reference(outcome),
        power_error_db=choice.predicted.power_db if name == EVERYTHING else None,
        power_l1_db=None,
        power_l1_range_weighted_db=None,
        power_bias_db=0.0,
        paths=float(timed.paths[0]),
        work=bench.work(settings, timed),
        reference=f"{SAME_PATHS}; power as in the rows of rays and depth",
    )


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


def _timed(
    bench: Bench,
    step: Step,
    without: KnobSettings,
    made: Callable[[KnobSettings, Clock], Outcome],
    kept: dict[Any, Any] | None = None,
) -> tuple[Outcome, dict[str, Any]]:
    """What a step's settings make, and the row's fields of time and memory.

    :param without: settings of the frame that a change is timed in turn with
    """
    if not step.is_a_change:
        clock = Clock(bench.effort.repeats, kept)
        return made(step.settings, clock), _seconds(bench, clock, None)
    outcome, clock, beside = in_turn(bench.effort.in_turn, partial(made, step.settings), partial(made, without))
    return outcome, _seconds(bench, clock, beside)


def _seconds(bench: Bench, clock: Clock, beside: Clock | None) -> dict[str, Any]:
    stages = bench.by_stage(clock)
    return {
        "seconds": sum(stages.values()),
        "stage_seconds": stages,
        "seconds_beside": None if beside is None else sum(bench.by_stage(beside).values()),
        "peak_mb": clock.peak_mb(),
    }


def _reference_text(against: KnobSettings, effort: Effort, paired: bool) -> str:
    realisations = f"{effort.realisations} realisations" + ("" if paired else " or more")
    if paired:
        return (
            f"same {against.rays} rays, depth {against.depth}, effects as the frames decide: cell power, {realisations}"
        )
    return (
        f"fan of {against.rays} rays, depth {against.depth}, mean of {effort.reference_realisations}: cell power, "
        f"{realisations}"
    )
