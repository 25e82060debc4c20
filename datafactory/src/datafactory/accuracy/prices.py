"""From the errors of single knobs to the cheapest settings that keep an error budget.

Errors of different knobs have no common phase, so their squares add. Three errors are bounded, each as an amplitude:
the cube's (relative L2) and the truth image's (largest difference over peak) on the same paths, and the amplitude in
a resolution cell, sqrt(mean power), over its peak. The price is counted work, so that every machine chooses alike.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from pydantic import BaseModel, ConfigDict

from datafactory.accuracy.chain import Clock, Reference, reference_of, run
from datafactory.accuracy.errors import level_db, peak_error, relative_l2
from datafactory.accuracy.knobs import CONVERGED, DEFAULT, REFERENCE_DEPTH, REFERENCE_RAYS, Settings
from datafactory.accuracy.probes import Probe, traced
from datafactory.accuracy.sweep import Advance, Effort, Means, power_error
from datafactory.accuracy.work import counted_work
from datafactory.paths.table import PathTable
from shared.radar import Radar


@dataclass(frozen=True)
class Menu:
    """What may be chosen from, each from cheap to dear; the last depth is the reference."""

    rays: tuple[int, ...] = (25_000, 50_000, 100_000, 200_000, 400_000, 800_000)
    depth: tuple[int, ...] = (1, 2, REFERENCE_DEPTH)
    prune_db: tuple[float, ...] = (-20.0, -30.0, -40.0, -50.0, -60.0)
    tolerance: tuple[float, ...] = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
    truth_terms: tuple[int, ...] = (3, 4, 5, 6)
    effort: Effort = field(default_factory=lambda: Effort(REFERENCE_RAYS))

    def steps(self) -> int:
        return len(self.rays) + len(self.depth) + len(self.prune_db) + len(self.tolerance) + len(self.truth_terms)


class Price(BaseModel):
    """One setting of one knob: its errors in every frame as amplitude ratios, and the paths that it leaves.

    :param paths: mean number; for ``prune_db`` the share kept
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    knob: str
    value: float
    cube: tuple[float, ...]
    image: tuple[float, ...]
    power: tuple[float, ...]
    paths: float


PriceList = dict[tuple[str, float], Price]


class Prices(BaseModel):
    """All prices of a scene; the frames they were measured on."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    frame_ids: tuple[int, ...]
    prices: tuple[Price, ...]

    def by_setting(self) -> PriceList:
        return {(price.knob, price.value): price for price in self.prices}


class Errors(BaseModel):
    """The three errors [dB], the largest over the frames, to 0.1 dB so that the last bits of a sum do not decide."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    cube_db: float
    image_db: float
    power_db: float

    @staticmethod
    def of(cube: float, image: float, power: float) -> Errors:
        """From amplitude ratios."""
        return Errors(
            cube_db=round(level_db(cube), 1), image_db=round(level_db(image), 1), power_db=round(level_db(power), 1)
        )

    @property
    def worst_db(self) -> float:
        return max(self.cube_db, self.image_db, self.power_db)

    def __str__(self) -> str:
        return f"cube {self.cube_db:.1f}, image {self.image_db:.1f}, power in a cell {self.power_db:.1f} dB"


@dataclass(frozen=True)
class Choice:
    """The settings chosen, their counted work a frame, what they promise, and whether that keeps the budget."""

    settings: Settings
    work: float
    predicted: Errors
    keeps_budget: bool


def measure_prices(probes: Sequence[Probe], menu: Menu, radar: Radar, advance: Advance) -> Prices:
    """Sweep the knobs of the menu, the rays of the others being its middle ones; nothing is timed."""
    base = replace(CONVERGED, video_phase=radar.waveform.residual_video_phase)
    depth = DEFAULT.depth if DEFAULT.depth in menu.depth else menu.depth[-1]
    usual = replace(DEFAULT, rays=menu.rays[len(menu.rays) // 2], depth=depth, video_phase=base.video_phase)
    total, prices = menu.steps(), list[Price]()
    advance(0, total, "reference")
    tables = [traced(probe, usual, radar) for probe in probes]
    reference, kept = reference_of(tables, base, radar), Clock(keep=True)
    run(tables, base, radar, kept, reference)
    for knob in ("tolerance", "prune_db", "truth_terms"):
        for value in getattr(menu, knob):
            advance(len(prices), total, f"{knob} {value}")
            clock = Clock(kept=kept.kept)
            prices.append(_signal_price(knob, value, replace(base, **{knob: value}), tables, reference, clock, radar))
    del reference, kept
    means: Means = {}
    none = (0.0,) * len(probes)
    for knob in ("rays", "depth"):
        for value in getattr(menu, knob):
            advance(len(prices), total, f"{knob} {value}")
            settings = replace(usual, **{knob: value})
            against = replace(settings, rays=menu.effort.reference_rays)
            if knob == "depth":
                against = replace(settings, depth=REFERENCE_DEPTH)
            errors = tuple(power_error(probe, settings, against, menu.effort, radar, means)[0] for probe in probes)
            paths = float(np.mean([means[probe.frame_id, settings][1] for probe in probes]))
            prices.append(Price(knob=knob, value=value, cube=none, image=none, power=errors, paths=paths))
    return Prices(frame_ids=tuple(probe.frame_id for probe in probes), prices=tuple(prices))


def _signal_price(
    knob: str,
    value: float,
    settings: Settings,
    tables: Sequence[PathTable],
    reference: Reference,
    clock: Clock,
    radar: Radar,
) -> Price:
    outcome = run(tables, settings, radar, clock, reference)
    traced_paths = sum(len(table) for table in tables)
    return Price(
        knob=knob,
        value=value,
        cube=tuple(relative_l2(a, b) for a, b in zip(outcome.cubes, reference.cubes, strict=True)),
        image=tuple(peak_error(a, b) for a, b in zip(outcome.images, reference.images, strict=True)),
        power=(0.0,) * len(tables),
        paths=sum(outcome.paths) / max(traced_paths, 1),
    )


def choose(scenes: Sequence[Prices], menu: Menu, budget_db: float, radar: Radar) -> Choice:
    """The least counted work of all combinations that keep the budget in every frame of every scene.

    Where none does, the one with the smallest worst error, and of those the cheapest.
    """
    choices, lists = [], [prices.by_setting() for prices in scenes]
    for rays, depth, prune, tolerance, terms in itertools.product(
        menu.rays, menu.depth, menu.prune_db, menu.tolerance, menu.truth_terms
    ):
        settings = replace(DEFAULT, rays=rays, depth=depth, prune_db=prune, tolerance=tolerance, truth_terms=terms)
        predicted = _predicted(lists, settings)
        work = counted_work(settings, _paths(lists, settings), radar)
        choices.append(Choice(settings, work, predicted, predicted.worst_db <= budget_db))
    good = [choice for choice in choices if choice.keeps_budget]
    if good:
        return min(good, key=lambda choice: choice.work)
    return min(choices, key=lambda choice: (choice.predicted.worst_db, choice.work))


def _predicted(lists: Sequence[PriceList], settings: Settings) -> Errors:
    cube, image, power = [], [], []
    for prices in lists:
        tolerance, prune = prices["tolerance", settings.tolerance], prices["prune_db", settings.prune_db]
        terms = prices["truth_terms", settings.truth_terms]
        rays, depth = prices["rays", settings.rays], prices["depth", settings.depth]
        cube.append(max(map(math.hypot, tolerance.cube, prune.cube)))
        image.append(max(map(math.hypot, terms.image, prune.image)))
        power.append(max(map(math.hypot, rays.power, depth.power)))
    return Errors.of(max(cube), max(image), max(power))


def _paths(lists: Sequence[PriceList], settings: Settings) -> float:
    """Mean paths after pruning: those of the rays, times what the depth changes, times what pruning keeps."""
    counts = []
    for prices in lists:
        depths = [value for knob, value in prices if knob == "depth"]
        priced_at = DEFAULT.depth if DEFAULT.depth in depths else depths[-1]
        deeper = prices["depth", settings.depth].paths / max(prices["depth", priced_at].paths, 1.0)
        counts.append(prices["rays", settings.rays].paths * deeper * prices["prune_db", settings.prune_db].paths)
    return sum(counts) / len(counts)
