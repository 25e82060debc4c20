"""What each setting of each knob errs by: measured once, for a price list that is read and for a budget that chooses.

Signal knobs share the paths of one tracing, unpruned, and are held against a cube of 1e-11 and a truth whose Doppler
filter and range walk are exact. Power knobs are held against many rays, or against the deepest with the same rays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from pydantic import BaseModel, ConfigDict

from datafactory.accuracy.clock import Advance, Clock
from datafactory.accuracy.errors import peak_error, relative_l2
from datafactory.accuracy.knobs import POWER_KNOBS, REFERENCE_DEPTH, SIGNAL_KNOBS, KnobSettings, Menu
from datafactory.accuracy.looking import Outcome, made, reference_of
from datafactory.accuracy.power import Kept, paired_error, power_error
from datafactory.accuracy.samples import Sample


class Price(BaseModel):
    """One setting of one knob: its errors in every frame, empty where it can have none.

    :param cube, image, power: amplitude ratios, see :mod:`datafactory.accuracy.errors` and
        :mod:`datafactory.accuracy.power`
    :param bias: total power over the reference's; of signal knobs that of the image
    :param paths: mean number, of power knobs before pruning
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    knob: str
    value: float
    cube: tuple[float, ...] = ()
    image: tuple[float, ...] = ()
    power: tuple[float, ...] = ()
    bias: tuple[float, ...]
    paths: float


class Prices(BaseModel):
    """The prices of a scene; of paths alone those of power knobs."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    prices: tuple[Price, ...]


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
        self.reference = reference_of(self.frames, samples[0].settings(usual), samples[0].radar)
        converged = Clock(repeats, keep=True)
        self.made(usual.converged(), converged)
        self.kept = converged.kept

    def made(self, knobs: KnobSettings, clock: Clock) -> Outcome:
        """All frames from the paths that they have, in the Doppler cells of the reference."""
        first = self.samples[0]
        return made(self.frames, first.settings(knobs), first.radar, clock, self.reference.cells, self.batch)

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


def measure_prices(samples: Sequence[Sample], menu: Menu, advance: Advance) -> Prices:
    """The prices of a whole menu."""
    prices = list[Price]()
    total, traces = len(list(menu.settings())), Kept()
    advance(0, total, "reference")
    if not menu.paths_only:
        bench = Bench(samples, menu.usual)
        for knob, value in menu.settings(*SIGNAL_KNOBS):
            advance(len(prices), total, f"{knob} {value}")
            prices.append(bench.price(knob, value)[0])
        del bench  # many rays need the room
    for knob, value in menu.settings(*POWER_KNOBS):
        advance(len(prices), total, f"{knob} {value}")
        prices.append(power_price(samples, menu, knob, value, traces))
    return Prices(prices=tuple(prices))
