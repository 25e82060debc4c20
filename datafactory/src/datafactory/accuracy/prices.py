"""From the errors of single knobs to the cheapest settings that keep an error budget.

Errors of different knobs have no common phase, so their squares add. Three errors are bounded, each as an amplitude:
the cube's (relative L2) and the truth image's (largest difference over peak) on the same paths, and the amplitude in
a resolution cell, sqrt(power), over its peak (:mod:`datafactory.accuracy.power`). The price is counted work, so that
every machine chooses alike.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from pydantic import BaseModel, ConfigDict

from datafactory.accuracy.clock import Advance, Clock
from datafactory.accuracy.errors import level_db, peak_error, relative_l2
from datafactory.accuracy.knobs import (
    BUDGET_REFERENCE_RAYS,
    DEFAULT,
    FAN_RAYS,
    REFERENCE_DEPTH,
    KnobSettings,
    converged,
)
from datafactory.accuracy.looking import Outcome, reference_of, run
from datafactory.accuracy.power import Effort, Kept, power_error, realisations
from datafactory.accuracy.samples import SampleFrame, traced
from datafactory.accuracy.work import frame_work, trace_work
from shared.radar import Radar


@dataclass(frozen=True)
class Menu:
    """What may be chosen from, each from cheap to dear; of knobs without values the default stays.

    :param effort: of measuring the power in cells
    """

    rays: tuple[int, ...] = FAN_RAYS
    depth: tuple[int, ...] = (1, 2, REFERENCE_DEPTH)
    prune_db: tuple[float, ...] = (-20.0, -30.0, -40.0, -50.0, -60.0)
    tolerance: tuple[float, ...] = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
    truth_terms: tuple[int, ...] = (3, 4, 5, 6)
    effort: Effort = field(default_factory=lambda: Effort(BUDGET_REFERENCE_RAYS))

    @property
    def paths_only(self) -> bool:
        """Whether nothing is chosen but how to trace."""
        return not (self.prune_db or self.tolerance or self.truth_terms)

    def of_paths(self) -> Menu:
        """What of it concerns the paths alone."""
        return replace(self, prune_db=(), tolerance=(), truth_terms=())

    def steps(self) -> int:
        return len(self.rays) + len(self.depth) + len(self.prune_db) + len(self.tolerance) + len(self.truth_terms)


class Price(BaseModel):
    """One setting of one knob: its errors in every frame as amplitude ratios, and the paths that it leaves.

    :param paths: mean number; for ``prune_db`` the share kept
    :param fixed_work, path_work: counted multiply-adds a frame whatever the paths, and a path: of the cube for
        ``tolerance``, of the truth for ``truth_terms``
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    knob: str
    value: float
    cube: tuple[float, ...]
    image: tuple[float, ...]
    power: tuple[float, ...]
    paths: float
    fixed_work: float = 0.0
    path_work: float = 0.0


PriceList = dict[tuple[str, float], Price]


class Prices(BaseModel):
    """All prices of a scene; the frames they were measured on."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    frame_ids: tuple[int, ...]
    prices: tuple[Price, ...]

    def by_setting(self) -> PriceList:
        return {(price.knob, price.value): price for price in self.prices}


class Errors(BaseModel):
    """The three errors [dB], the largest over the frames, to 0.1 dB so that the last bits of a sum do not decide.

    None of cube and image where only paths are made.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    cube_db: float | None
    image_db: float | None
    power_db: float

    @staticmethod
    def of(cube: Sequence[float], image: Sequence[float], power: Sequence[float]) -> Errors:
        """The largest of amplitude ratios; none of a cube or image that is not made."""

        def largest(ratios: Sequence[float]) -> float | None:
            return round(level_db(max(ratios)), 1) if ratios else None

        return Errors(cube_db=largest(cube), image_db=largest(image), power_db=round(level_db(max(power)), 1))

    def measured(self) -> dict[str, float]:
        """Name and level of those that there are."""
        return {name: value for name, value in self.model_dump().items() if value is not None}

    def excess_db(self, budget_db: float) -> tuple[float, ...]:
        """By how much each exceeds a budget, 0 where it does not, the largest first."""
        return tuple(sorted((max(value - budget_db, 0.0) for value in self.measured().values()), reverse=True))

    @property
    def worst_db(self) -> float:
        return max(self.measured().values())

    def __str__(self) -> str:
        names = {"cube_db": "cube", "image_db": "image", "power_db": "power in a cell"}
        return ", ".join(f"{names[name]} {value:.1f}" for name, value in self.measured().items()) + " dB"


@dataclass(frozen=True)
class Choice:
    """The settings chosen, their counted work a frame, what they promise, and whether that keeps the budget."""

    settings: KnobSettings
    work: float
    predicted: Errors
    keeps_budget: bool


def measure_prices(
    samples: Sequence[SampleFrame], menu: Menu, radar: Radar, made_with: KnobSettings, advance: Advance
) -> Prices:
    """Sweep the knobs of the menu; nothing is timed.

    Where they are not varied, rays and depth are the default's if the menu has them, else its middle and its last ones.

    :param made_with: effects, truth window and video phase of the run
    """
    depth = DEFAULT.depth if DEFAULT.depth in menu.depth else menu.depth[-1]
    rays = DEFAULT.rays if DEFAULT.rays in menu.rays else menu.rays[len(menu.rays) // 2]
    usual = replace(made_with, rays=rays, depth=depth)
    total, prices = menu.steps(), list[Price]()
    advance(0, total, "reference")
    if not menu.paths_only:
        base = converged(usual)
        frames = [traced(sample, usual, radar) for sample in samples]
        reference, kept = reference_of(frames, base, radar), Clock(keep=True)
        run(frames, base, radar, kept, reference.cells)
        for knob in ("tolerance", "prune_db", "truth_terms"):
            for value in getattr(menu, knob):
                advance(len(prices), total, f"{knob} {value}")
                clock = Clock(kept=kept.kept)
                settings = replace(base, **{knob: value})
                outcome = run(frames, settings, radar, clock, reference.cells)
                prices.append(signal_price(knob, value, outcome, reference))
        del reference, kept
    traces: Kept = {}
    for knob in ("rays", "depth"):
        for value in getattr(menu, knob):
            advance(len(prices), total, f"{knob} {value}")
            settings = replace(usual, **{knob: value})
            deep = knob == "depth"
            against = replace(usual, depth=REFERENCE_DEPTH) if deep else replace(usual, rays=menu.effort.reference_rays)
            errors = tuple(
                power_error(sample, settings, against, menu.effort, radar, traces, paired=deep).peak
                for sample in samples
            )
            count = menu.effort.realisations if deep else menu.effort.count(value)
            paths = [realisations(sample, settings, radar, 1, count, traces).paths for sample in samples]
            prices.append(power_price(knob, value, errors, float(np.mean(paths))))
    return Prices(frame_ids=tuple(sample.frame_id for sample in samples), prices=tuple(prices))


def signal_price(knob: str, value: float, outcome: Outcome, reference: Outcome) -> Price:
    """The price of one setting of a knob of the signal, from the frames made with it."""
    works = {"tolerance": outcome.cube_work, "truth_terms": outcome.truth_work}.get(knob, ())
    return Price(
        knob=knob,
        value=value,
        cube=tuple(relative_l2(a, b) for a, b in zip(outcome.cubes, reference.cubes, strict=True)),
        image=tuple(peak_error(a, b) for a, b in zip(outcome.images, reference.images, strict=True)),
        power=(0.0,) * len(outcome.paths),
        paths=sum(outcome.paths) / max(sum(outcome.reached), 1),
        fixed_work=sum(work.fixed for work in works) / max(len(works), 1),
        path_work=sum(work.by_paths for work in works) / max(sum(outcome.paths), 1),
    )


def power_price(knob: str, value: float, power: Sequence[float], paths: float) -> Price:
    """The price of one setting of a knob of the paths.

    :param power: errors of every frame; :param paths: mean number
    """
    none = (0.0,) * len(power)
    return Price(knob=knob, value=value, cube=none, image=none, power=tuple(power), paths=paths)


def choose(scenes: Sequence[Prices], menu: Menu, budget_db: float, radar: Radar) -> Choice:
    """The least counted work of all combinations that keep the budget in every frame of every scene.

    Where none does, the one that exceeds it least: by its worst error first, then by the others, so that these are
    still kept where they can be; and of equals the cheapest.
    """
    choices, lists = [], [prices.by_setting() for prices in scenes]
    for rays, depth, prune, tolerance, terms in itertools.product(
        menu.rays,
        menu.depth,
        menu.prune_db or (DEFAULT.prune_db,),
        menu.tolerance or (DEFAULT.tolerance,),
        menu.truth_terms or (DEFAULT.truth_terms,),
    ):
        settings = replace(DEFAULT, rays=rays, depth=depth, prune_db=prune, tolerance=tolerance, truth_terms=terms)
        predicted = _predicted(lists, settings, menu)
        work = trace_work(settings) if menu.paths_only else _work(lists, settings, radar)
        choices.append(Choice(settings, work, predicted, predicted.worst_db <= budget_db))
    good = [choice for choice in choices if choice.keeps_budget]
    if good:
        return min(good, key=lambda choice: choice.work)
    return min(choices, key=lambda choice: (choice.predicted.excess_db(budget_db), choice.work))


def _predicted(lists: Sequence[PriceList], settings: KnobSettings, menu: Menu) -> Errors:
    cube, image, power = list[float](), list[float](), list[float]()
    for prices in lists:
        rays, depth = prices["rays", settings.rays], prices["depth", settings.depth]
        power += map(math.hypot, rays.power, depth.power)
        if not menu.paths_only:
            tolerance, prune = prices["tolerance", settings.tolerance], prices["prune_db", settings.prune_db]
            cube += map(math.hypot, tolerance.cube, prune.cube)
            image += map(math.hypot, prices["truth_terms", settings.truth_terms].image, prune.image)
    return Errors.of(cube, image, power)


def _work(lists: Sequence[PriceList], settings: KnobSettings, radar: Radar) -> float:
    """Counted multiply-adds of one frame, mean over the scenes."""
    total = 0.0
    for prices in lists:
        cube, truth = prices["tolerance", settings.tolerance], prices["truth_terms", settings.truth_terms]
        total += cube.fixed_work + truth.fixed_work + _paths(prices, settings) * (cube.path_work + truth.path_work)
    return total / len(lists) + trace_work(settings) + frame_work(settings, radar)


def _paths(prices: PriceList, settings: KnobSettings) -> float:
    """Paths after pruning: those of the rays, times what the depth changes, times what pruning keeps."""
    depths = [value for knob, value in prices if knob == "depth"]
    priced_at = DEFAULT.depth if DEFAULT.depth in depths else depths[-1]
    deeper = prices["depth", settings.depth].paths / max(prices["depth", priced_at].paths, 1.0)
    return prices["rays", settings.rays].paths * deeper * prices["prune_db", settings.prune_db].paths
