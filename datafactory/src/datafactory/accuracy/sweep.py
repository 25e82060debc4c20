"""The sweep: one knob at a time away from a converged reference, its price and its error.

Signal knobs share the paths of the pipeline's own tracing, unpruned, and are held against a cube of 1e-11 and a truth
whose Doppler filter and range walk are exact. Power knobs change the paths and with them the speckle; their error is
that of the power in resolution cells (:mod:`datafactory.accuracy.power`). Everything is varied around what the frames
decide by themselves; an effect's row is the difference that leaving it out makes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from threadpoolctl import threadpool_limits

from datafactory.accuracy.clock import Advance, Clock
from datafactory.accuracy.front import KNOBS, LEVELS_DB, fronts
from datafactory.accuracy.knobs import DEFAULT, Knob, KnobSettings, converged
from datafactory.accuracy.looking import reference_of, run, write_seconds
from datafactory.accuracy.measuring import Bench, Step, front_row, power_row, shown, signal_row
from datafactory.accuracy.power import Effort, Kept
from datafactory.accuracy.prices import Price, power_price, signal_price
from datafactory.accuracy.row import DEFAULTS, Row
from datafactory.accuracy.samples import SampleFrame, traced
from shared.radar import Radar


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
        bench = _bench(samples, [step.settings for step in steps], default, base, effort, radar)
        kept: dict[Any, Any] = {}
        bench.made(base, Clock(effort.repeats, kept, keep=True))
        for step in steps:
            advance(len(rows), total, f"{step.label} {step.value}")
            row, outcome = signal_row(bench, step, kept)
            rows.append(row)
            if step.knob is not None and step.knob.name in KNOBS:
                prices.append(signal_price(step.knob.name, float(step.value), outcome, bench.reference))
        del kept
        realisations: Kept = {}
        as_made = run(bench.frames[:1], default, radar, Clock(), batch=1)
        for step in powers:
            advance(len(rows), total, f"{step.label} {step.value}")
            row, errors = power_row(bench, step, as_made, realisations)
            rows.append(row)
            if step.knob is not None and step.label in KNOBS:
                prices.append(power_price(step.label, float(step.value), errors, row.paths))
        for name, level, choice in fronts(prices, default, effort, radar):
            advance(len(rows), total, f"{name} {level:g} dB")
            rows.append(front_row(bench, name, level, choice))
    advance(total, total, "done")
    return rows


def _steps(knobs: Sequence[Knob], default: KnobSettings, base: KnobSettings, everything: str) -> list[Step]:
    """The defaults together, then every value of every knob away from ``base``.

    Whatever rays the sweep itself is made with, the pipeline's default is marked.
    """
    pipeline = replace(default, rays=DEFAULT.rays)
    return [
        Step(DEFAULTS, everything, default, True),
        *(
            Step(knob.label, shown(value), knob.at(base, value), knob.at(pipeline, value) == pipeline, knob)
            for knob in knobs
            for value in knob.values
        ),
    ]


def _bench(
    samples: Sequence[SampleFrame],
    signal: Sequence[KnobSettings],
    default: KnobSettings,
    base: KnobSettings,
    effort: Effort,
    radar: Radar,
) -> Bench:
    """The frames traced as by default, their reference, and what tracing and writing take.

    :param signal: settings whose kernels are compiled before anything is timed
    """
    frame = traced(samples[0], default, radar)  # the solver compiles before it is timed
    for settings in dict.fromkeys(replace(each, prune_db=0.0) for each in signal):
        run([frame], settings, radar, Clock(), batch=1)
    clock = Clock(effort.repeats)
    frames = [clock("trace", partial(traced, sample, default, radar)) for sample in samples]
    reference = reference_of(frames, base, radar)
    fixed = {
        "trace": clock.seconds()["trace"],
        "write": write_seconds(reference.frames[0], radar, max(3, effort.repeats)),
    }
    return Bench(samples, frames, reference, fixed, default, base, effort, radar)
