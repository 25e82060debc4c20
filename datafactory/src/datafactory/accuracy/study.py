"""What accuracy costs in time: every setting of every knob away from what is converged, its error and its seconds; then
the settings that an error budget would choose, for one error after the other, made and timed as a whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from threadpoolctl import threadpool_limits

from datafactory.accuracy.knobs import (
    DEFAULT,
    KNOBS,
    POWER_KNOBS,
    QUICK,
    SIGNAL_KNOBS,
    STUDY,
    KnobSettings,
    Menu,
    Sample,
)
from datafactory.accuracy.looking import STAGES, Clock, made, write_seconds
from datafactory.accuracy.power import Errors, Kept, level_db, worst_db
from datafactory.accuracy.prices import Bench, Price, Prices, front, power_price, predicted, work
from datafactory.frame.chain import ChainSettings
from datafactory.paths.solver import TraceSettings
from datafactory.run.memory import Load, amount, rays_that_fit
from shared.physics.errors import InputError
from shared.processes.machine import usable_memory
from shared.processes.telling import Announce, Progress
from shared.radar import Radar

DEFAULTS, FRONT = "defaults", "front"
"""What rows of all knobs together are called."""
Levels = tuple[float | None, float | None, float | None, float | None]
"""Errors of cube, image and power, and the bias [dB]."""
LEAST_REPEATS = 3
"""Of writing a file, which takes little and waits for the disk."""


@dataclass(frozen=True)
class Row:
    """One setting of one knob, or of all of them, measured; errors are the largest over the frames, None where there
    can be none.

    :param default: whether the pipeline has it by default
    :param seconds: a frame on one core; :param stage_seconds: the same by stage
    :param cube_error_db: relative L2; :param image_error_db: largest difference over the peak
    :param power_error_db: of the amplitudes in cells, over their peak, mean over realisations
    :param power_bias_db: total power over the reference's [dB]
    :param paths: after pruning; :param work: seconds by fixed rates, see :mod:`datafactory.accuracy.prices`
    """

    knob: str
    setting: str
    default: bool
    seconds: float
    stage_seconds: dict[str, float]
    cube_error_db: float | None
    image_error_db: float | None
    power_error_db: float | None
    power_bias_db: float | None
    paths: float
    work: float

    @property
    def worst_db(self) -> float:
        """The worst of its errors."""
        errors = (self.cube_error_db, self.image_error_db, self.power_error_db)
        return max(error for error in errors if error is not None)


def menu_of_study(quick: bool, rays: int | None, most_rays: int | None, radar: Radar) -> Menu:
    """What is measured.

    :param rays: of all rows that do not vary them; :param most_rays: to be tried
    :raises InputError: most rays that are tried anyway, or that there is no memory for
    """
    menu = QUICK if quick else STUDY
    if most_rays is not None:
        if most_rays <= menu.rays[-1]:
            raise InputError("--most-rays", f"{most_rays}, which are tried without it", f"more than {menu.rays[-1]}")
        _require_memory("--most-rays", most_rays, menu, radar)
        menu = menu.with_more_rays(most_rays)
    if rays is None:
        return menu
    _require_memory("--rays", rays, menu, radar)
    return replace(menu.with_rays(rays), usual_rays=rays)


def _require_memory(option: str, rays: int, menu: Menu, radar: Radar) -> None:
    """Refuse more rays than the reference, which has twice as many, has memory for."""
    of_reference = TraceSettings(rays=2 * rays, depth=menu.usual.depth)
    load, limit = Load(radar, ChainSettings(trace=of_reference), traced=True), usable_memory()
    fitting = rays_that_fit(load, limit) // 2
    if fitting < rays:
        needed = f"a reference of {2 * rays} rays takes {amount(load.worker_bytes)} of memory"
        raise InputError(option, f"{needed}, {amount(limit)} may be used", f"at most {max(fitting, 0)}")


def study(samples: Sequence[Sample], menu: Menu, repeats: int, batch: int, advance: Progress) -> list[Row]:
    """Measure a whole menu on frames of a run, on one core; the defaults together come first.

    :param repeats: of each timed step and frame
    :param batch: frames whose images share their time
    """
    with threadpool_limits(limits=1):
        return _Study(samples, menu, repeats, batch, advance).rows()


class _Study:
    """Frames that are measured on, with what is found on them."""

    def __init__(self, samples: Sequence[Sample], menu: Menu, repeats: int, batch: int, advance: Progress) -> None:
        self.samples, self.menu, self.repeats, self.batch = samples, menu, repeats, batch
        self.sample, self.radar, self.usual = samples[0], samples[0].order.radar, menu.usual
        self.prices: list[Price] = []
        total = len(list(menu.settings()))
        self.begin: Announce = lambda label: advance(label, len(self.prices), total)
        self.begin("reference")
        self._compile()
        self.bench = Bench(samples, self.usual, repeats, batch)
        writing = write_seconds(self.bench.reference.frames[0], self.radar, max(LEAST_REPEATS, repeats))
        self.fixed = {**self.bench.tracing.seconds(), "write": writing}

    def rows(self) -> list[Row]:
        signal = [self._signal_row(knob, value) for knob, value in self.menu.settings(*SIGNAL_KNOBS)]
        self.bench.kept.clear()  # many rays need the room
        kept = Kept()
        power = [self._power_row(knob, value, kept) for knob, value in self.menu.settings(*POWER_KNOBS)]
        prices = Prices(prices=tuple(self.prices))
        defaults = self._row_together(DEFAULTS, "all", self.usual, predicted(prices, self.usual))
        points = [
            self._row_together(FRONT, f"{level:g} dB: {choice.settings}", choice.settings, choice.predicted)
            for level, choice in front(prices, self.menu, self.radar)
        ]
        return [defaults, *signal, *power, *points]

    def _compile(self) -> None:
        """Compile what is compiled for the first frame, for a tolerance and for a number of terms: nothing is timed."""
        frame = self.sample.traced(self.usual)
        for knob, value in self.menu.settings("tolerance", "truth_terms"):
            knobs = self.usual.converged().at(knob, value)  # a pruned frame would not reach every kernel
            made([frame], self.sample.settings(knobs), self.radar)

    def _signal_row(self, knob: str, value: float) -> Row:
        self.begin(f"{knob} {value}")
        price, clock = self.bench.price(knob, value)
        self.prices.append(price)
        knobs = self.usual.converged().at(knob, value)
        return self._row(knob, str(value), knobs, clock, price.paths, _levels(price))

    def _power_row(self, knob: str, value: float, kept: Kept) -> Row:
        """Its errors are those of all frames, its time and paths the first frame's."""
        self.begin(f"{knob} {value}")
        price = power_price(self.samples, self.menu, knob, value, kept)
        self.prices.append(price)
        knobs = self.usual.at(knob, value)
        return self._row(knob, str(value), knobs, *self._from_rays(knobs), _levels(price))

    def _row_together(self, name: str, setting: str, knobs: KnobSettings, expected: Errors) -> Row:
        """All knobs together: errors of cube and image on the frames traced as usual; that of the power as rays and
        depth have it alone; time with its own rays."""
        self.begin(f"{name} {setting}")
        self.sample.traced(knobs)  # the solver compiles for every number of rays and of bounces
        cube, image = self.bench.errors(self.bench.made(knobs, Clock()))
        levels = (worst_db(cube), worst_db(image), expected.power_db, None)
        return self._row(name, setting, knobs, *self._from_rays(knobs), levels)

    def _from_rays(self, knobs: KnobSettings) -> tuple[Clock, float]:
        """Times and paths of the first frame, its trace included."""
        sample, clock = self.sample, Clock(self.repeats)
        frame = clock("trace", partial(sample.traced, knobs))
        outcome = made([frame], sample.settings(knobs), self.radar, clock, batch=self.batch)
        return clock, float(outcome.paths[0])

    def _row(self, knob: str, setting: str, knobs: KnobSettings, clock: Clock, paths: float, levels: Levels) -> Row:
        """What the clock did not see takes what it took for all."""
        cube, image, power, bias = levels
        seconds = self.fixed | clock.seconds()
        default = knob in KNOBS and getattr(knobs, knob) == getattr(DEFAULT, knob)
        if knob == DEFAULTS:
            default = knobs == DEFAULT
        return Row(
            knob=knob,
            setting=setting,
            default=default,
            seconds=sum(seconds.values()),
            stage_seconds={stage: seconds[stage] for stage in STAGES},
            cube_error_db=cube,
            image_error_db=image,
            power_error_db=power,
            power_bias_db=bias,
            paths=paths,
            work=work(knobs, paths, self.radar),
        )


def _levels(price: Price) -> Levels:
    bias_db = max((0.5 * level_db(ratio) for ratio in price.bias), key=abs)
    return worst_db(price.cube), worst_db(price.image), worst_db(price.power), bias_db
