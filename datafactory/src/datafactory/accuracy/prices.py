"""What each setting of each knob errs by: measured once, for a price list that is read and for a budget that chooses.

What an error is, and what each is held against: docs/accuracy.md#what-an-error-is. Signal knobs share the paths of one
tracing, unpruned. The cheapest settings that keep an error budget follow from the errors of single knobs. Errors of
different knobs have no common phase, so their squares add; each is an amplitude, in a resolution cell sqrt(power)
(:mod:`datafactory.accuracy.power`).

What settings cost is not timed here but follows from fixed rates, so that every machine chooses alike.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from pydantic import BaseModel

from datafactory.accuracy.knobs import KNOBS, POWER_KNOBS, REFERENCE_DEPTH, SIGNAL_KNOBS, KnobSettings, Menu, Sample
from datafactory.accuracy.looking import Clock, Outcome, made, reference_of
from datafactory.accuracy.power import Errors, Kept, paired_error, peak_error, power_error, relative_l2
from datafactory.paths.solver import TraceSettings
from shared.processes.telling import Progress
from shared.radar import Radar
from shared.signal.imaging import walk_terms

PASS_S = 0.17
"""Of a pass of rays, whatever their number, in which the scene is built and the solver's kernels start: 3125 rays take
0.17 s in one pass in munich and 0.44 on the street, 12 500 there 0.66 in three.
"""
BOUNCE_S = 1.2e-6
"""Of a ray's bounce: 0.9 s for 2e5 rays of 4 steps on the shipped street."""
TRUTH_S = 4e-6
"""Of a path's moments in the truth of 256 elements: 0.44 s for 1e5 paths at 10 m/s."""
SPECTRUM_S = 7e-9
"""Of a sample's range-Doppler spectrum."""
IMAGE_S = 1.3e-10
"""Of a term, a range bin, an element and a direction in the truth's image."""
LEVELS_DB = tuple(float(level) for level in range(-15, -65, -5))
CUBE_S = {
    1e-2: (0.07, 1.1e-6), 1e-3: (0.07, 1.7e-6), 1e-4: (0.07, 3.0e-6), 1e-5: (0.14, 4.7e-6), 1e-6: (0.14, 8.8e-6),
    1e-7: (0.50, 2.8e-5), 1e-9: (0.60, 3.2e-5),
}  # fmt: skip
"""Of the default radar's cube by tolerance, at 10 m/s: of a frame, and of each of its paths. Measured on 1e4 and 1e5
paths of the bench's street (``tests/benchmarks/workloads.py``); the last by the terms of the exact kernel.
"""
_USUAL = Radar()
"""That the rates are for."""


class Price(BaseModel, frozen=True, extra="forbid"):
    """One setting of one knob: its errors in every frame, empty where it can have none.

    :param cube, image, power: amplitude ratios, see :mod:`datafactory.accuracy.power`
    :param bias: total power over the reference's; of signal knobs that of the image
    :param paths: mean number, of power knobs before pruning
    """

    knob: str
    value: float
    cube: tuple[float, ...] = ()
    image: tuple[float, ...] = ()
    power: tuple[float, ...] = ()
    bias: tuple[float, ...]
    paths: float


PriceList = dict[tuple[str, float], Price]
"""By knob and value."""


class Prices(BaseModel, frozen=True, extra="forbid"):
    """The prices of a scene; of paths alone those of power knobs."""

    prices: tuple[Price, ...]

    @property
    def by_setting(self) -> PriceList:
        """The prices by knob and value."""
        return {(price.knob, price.value): price for price in self.prices}


class Bench:
    """Frames of a run, traced once, whose signal is made under other settings.

    :param usual: the knobs that they are traced with
    :param repeats: runs of each timed step
    :param batch: frames whose images share their time
    """

    def __init__(self, samples: Sequence[Sample], usual: KnobSettings, repeats: int = 1, batch: int = 1) -> None:
        self.samples, self.usual, self.repeats, self.batch = samples, usual, repeats, batch
        self.tracing = Clock(repeats)
        self.frames = [self.tracing("trace", partial(sample.traced, usual)) for sample in samples]
        self.reference = reference_of(self.frames, samples[0].settings(usual), samples[0].order.radar)
        converged = Clock(repeats, keep=True)
        self.made(usual.converged(), converged)
        self.kept = converged.kept

    def made(self, knobs: KnobSettings, clock: Clock) -> Outcome:
        """All frames from the paths that they have, in the Doppler cells of the reference."""
        first = self.samples[0]
        return made(self.frames, first.settings(knobs), first.order.radar, clock, self.reference.cells, self.batch)

    def errors(self, outcome: Outcome) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Those of cubes and of images made of these paths, by frame."""
        reference = self.reference
        return (
            tuple(map(relative_l2, outcome.cubes, reference.cubes)),
            tuple(map(peak_error, outcome.images, reference.images)),
        )

    def price(self, knob: str, value: float) -> tuple[Price, Clock]:
        """One setting of a signal knob away from what is converged, and what the stages after tracing took."""
        clock = Clock(self.repeats, self.kept)
        outcome = self.made(self.usual.converged().at(knob, value), clock)
        cube, image = self.errors(outcome)
        pairs = zip(outcome.images, self.reference.images, strict=True)
        bias = tuple(float((a**2).sum() / (b**2).sum()) if b.any() else 1.0 for a, b in pairs)
        paths = float(np.mean(outcome.paths))
        return Price(knob=knob, value=value, cube=cube, image=image, bias=bias, paths=paths), clock


def power_price(samples: Sequence[Sample], menu: Menu, knob: str, value: float, kept: Kept) -> Price:
    """One setting of a power knob: rays against a reference's, depth against the deepest with the same rays.

    :param kept: realisations traced before; those traced here are added
    """
    effort, usual = menu.effort, menu.usual
    knobs = usual.at(knob, value)
    deepest, densest = replace(usual, depth=REFERENCE_DEPTH), replace(usual, rays=effort.reference_rays)
    found = [
        paired_error(sample, knobs, deepest, effort, kept)
        if knob == "depth"
        else power_error(sample, knobs, sample, densest, effort, kept)
        for sample in samples
    ]
    return Price(
        knob=knob,
        value=value,
        power=tuple(error.peak for error in found),
        bias=tuple(error.total for error in found),
        paths=float(np.mean([error.paths for error in found])),
    )


def measure_prices(samples: Sequence[Sample], menu: Menu, advance: Progress) -> Prices:
    """The prices of a whole menu."""
    prices = list[Price]()
    total, traces = len(list(menu.settings())), Kept()
    advance("reference", 0, total)
    if not menu.paths_only:
        bench = Bench(samples, menu.usual)
        for knob, value in menu.settings(*SIGNAL_KNOBS):
            advance(f"{knob} {value}", len(prices), total)
            prices.append(bench.price(knob, value)[0])
        del bench  # many rays need the room
    for knob, value in menu.settings(*POWER_KNOBS):
        advance(f"{knob} {value}", len(prices), total)
        prices.append(power_price(samples, menu, knob, value, traces))
    return Prices(prices=tuple(prices))


def work(knobs: KnobSettings, paths: float, radar: Radar) -> float:
    """Seconds of one core for a frame, by fixed rates.

    :param paths: after pruning
    """
    waveform, channels, elements = radar.waveform, radar.array.channels, radar.virtual_sensor.channels
    of_frame, of_path = CUBE_S[knobs.tolerance]
    signals = (of_frame + of_path * paths) * channels / _USUAL.array.channels
    truth = TRUTH_S * paths * elements / _USUAL.virtual_sensor.channels
    spectra = SPECTRUM_S * channels * waveform.chirps * waveform.samples
    image = IMAGE_S * walk_terms(radar, knobs.truth_terms) * waveform.range_bins * elements * radar.grid.bins
    return trace_work(knobs) + signals + truth + spectra + image


def trace_work(knobs: KnobSettings) -> float:
    """The same of its trace alone."""
    passes = 3 if knobs.depth > 1 else 1  # beside what is scattered once, mirrors and what is scattered again
    return PASS_S * passes + BOUNCE_S * knobs.rays * TraceSettings(rays=knobs.rays, depth=knobs.depth).steps


@dataclass(frozen=True)
class Choice:
    """The settings chosen, their work a frame, what they promise, and whether that keeps the budget."""

    settings: KnobSettings
    work: float
    predicted: Errors
    keeps_budget: bool


def choose(scenes: Sequence[Prices], menu: Menu, budget_db: float, radar: Radar) -> Choice:
    """The least work of all combinations that keep the budget in every frame of every scene.

    Where none does, the one that exceeds it least: by its worst error first, then by the others, so that these are
    still kept where they can be; and of equals the cheapest.
    """
    choices, usual = [], menu.usual
    lists = [prices.by_setting for prices in scenes]
    for values in itertools.product(*(getattr(menu, knob) or (getattr(usual, knob),) for knob in KNOBS)):
        settings = KnobSettings(*values)
        cost = trace_work(settings)
        if not menu.paths_only:
            cost = sum(work(settings, _paths(prices, settings, usual), radar) for prices in lists) / len(lists)
        errors = _together([_chosen(prices, settings) for prices in lists])
        choices.append(Choice(settings, cost, errors, errors.worst_db <= budget_db))
    good = [choice for choice in choices if choice.keeps_budget]
    if good:
        return min(good, key=lambda choice: choice.work)
    return min(choices, key=lambda choice: (choice.predicted.excess_db(budget_db), choice.work))


def predicted(prices: Prices, settings: KnobSettings) -> Errors:
    """What settings should err by together."""
    return _together([_chosen(prices.by_setting, settings)])


def _chosen(prices: PriceList, settings: KnobSettings) -> dict[str, Price]:
    """The price of each knob at its setting, of those that have one."""
    return {knob: price for (knob, value), price in prices.items() if getattr(settings, knob) == value}


def _paths(prices: PriceList, settings: KnobSettings, usual: KnobSettings) -> float:
    """Paths after pruning: those of the rays, times what the depth changes, times what pruning keeps."""
    own = _chosen(prices, settings)
    deeper = own["depth"].paths / max(prices["depth", usual.depth].paths, 1.0)
    kept = own["prune_db"].paths / max(own["tolerance"].paths, 1.0)  # of the same paths, which are not pruned
    return own["rays"].paths * deeper * kept


def _together(scenes: Sequence[dict[str, Price]]) -> Errors:
    """The errors of these prices in all frames of all scenes."""
    cube, image, power = list[float](), list[float](), list[float]()
    for own in scenes:
        power += map(math.hypot, own["rays"].power, own["depth"].power)
        if "tolerance" in own:
            cube += map(math.hypot, own["tolerance"].cube, own["prune_db"].cube)
            image += map(math.hypot, own["truth_terms"].image, own["prune_db"].image)
    return Errors.of(cube, image, power)


def front(prices: Prices, menu: Menu, radar: Radar) -> Iterator[tuple[float, Choice]]:
    """Error and choice of every point, each choice once, errors falling, to where nothing on the menu has the error."""
    before = None
    for level_db in LEVELS_DB:
        choice = choose([prices], menu, level_db, radar)
        if not choice.keeps_budget:
            return
        if choice.settings != before:
            yield level_db, choice
        before = choice.settings
