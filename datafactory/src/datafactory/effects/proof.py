"""Whether frames keep their promise: one as it decides by itself beside the same with every effect; and what effects
cost: processor seconds of one frame, with and without them, on this machine.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datafactory.effects.catalogue import ALL, NAMES, NO_CHOICE, EffectSet
from datafactory.effects.plan import FLOOR_DB, EffectPlan
from datafactory.frame.chain import (
    ChainSettings,
    SceneSource,
    TracedSource,
    illuminated,
    make_frames,
    measured,
    narrowed,
)
from datafactory.frame.measurement import image
from datafactory.paths.cells import UNPRUNED_DB, cell_power
from shared.physics.units import amplitude_to_db, power_to_db
from shared.processes.telling import Progress
from shared.radar import Radar
from shared.signal.imaging import delay_and_sum
from shared.signal.spectrum import DopplerSelection, selection_at

REPEATS = 2
"""Timed frames of each kind, one beside the other in turn; the least counts."""


def frame_seconds(source: SceneSource, radar: Radar) -> float:
    """Processor seconds of this process from the scene to the image; what else runs on the machine hardly counts."""
    started = time.process_time()
    for _ in make_frames([source], radar):
        pass
    return time.process_time() - started


def costs(source: SceneSource, radar: Radar, plan: EffectPlan, advance: Progress) -> dict[str, float]:
    """Seconds that each effect takes of a frame with every effect.

    What the scene lacks, and what is no choice, costs nothing and is not timed.

    :param source: with every effect
    """

    def seconds(of: EffectSet) -> float:
        return frame_seconds(replace(source, settings=of.settings(replace(source.settings, budget_db=None))), radar)

    asked = [item.effect for item in plan.decisions if item.loss_db > FLOOR_DB and item.effect not in NO_CHOICE]
    advance("every effect", 0, len(asked) + 1)
    seconds(ALL)  # compiles what is to be compiled
    every = seconds(ALL)
    result = dict.fromkeys(NAMES, 0.0)
    for index, name in enumerate(asked):
        advance(name, index + 1, len(asked) + 1)
        result[name] = max(every - seconds(ALL.without(name)), 0.0)
    return result


@dataclass(frozen=True)
class Proof:
    """Differences between a frame as it decides and the frame of every effect, over the latter's peaks [dB].

    Each is traced by itself.

    :param power_db: of the power in the truth's resolution cells, as paths
    :param input_db, truth_db: of the input's beamformed image and of the truth image
    :param planned_seconds, all_seconds: processor time of the whole frame
    """

    power_db: float
    input_db: float
    truth_db: float
    planned_seconds: float
    all_seconds: float

    @property
    def worst_db(self) -> float:
        return max(self.power_db, self.input_db, self.truth_db)

    def sentence(self) -> str:
        """The proof in words."""
        return (
            f"against --effects all: power in a cell {self.power_db:.1f} dB, input image {self.input_db:.1f} dB, "
            f"truth image {self.truth_db:.1f} dB of the peak; {self.planned_seconds:.2f} s of one core a frame instead "
            f"of {self.all_seconds:.2f} s"
        )


def prove(source: SceneSource, radar: Radar) -> Proof:
    """Simulate one frame both ways, without noise: it is the same in both. Nothing is pruned but for the timing.

    Rows of both images lie in the Doppler cells that the frame of every effect chooses: where two peaks of a range bin
    are alike, the choice itself would hang on less than the budget.

    :param source: with every effect and a budget
    """
    settings, everything = source.settings, replace(source.settings, budget_db=None)
    sources = source, replace(source, settings=everything)
    alone, complete = (of.traced(radar) for of in sources)
    narrow, paths = narrowed(alone, settings, radar)
    expected = _images(TracedSource(complete, _bare(everything)), radar)
    got = _images(TracedSource(alone, _bare(narrow)), radar, expected.cells)
    window = settings.processing.truth_window
    reference = cell_power(illuminated(complete, everything, radar), radar, window)
    ratio = float(np.abs(cell_power(paths, radar, window) - reference).max() / max(reference.max(), 1e-300))
    pairs = [[frame_seconds(of, radar) for of in sources] for _ in range(REPEATS)]
    planned_seconds, all_seconds = (min(times) for times in zip(*pairs, strict=True))
    return Proof(
        power_db=float(power_to_db(ratio, FLOOR_DB)),
        input_db=_difference_db(got.beamformed, expected.beamformed),
        truth_db=_difference_db(got.truth, expected.truth),
        planned_seconds=planned_seconds,
        all_seconds=all_seconds,
    )


def _bare(settings: ChainSettings) -> ChainSettings:
    """Without noise, and with every path that there is."""
    silent = replace(settings.processing, noise=False, store="range-channel")
    return replace(settings, processing=silent, prune_db=UNPRUNED_DB, budget_db=None)


@dataclass(frozen=True, eq=False)
class _Images:
    """[R, U] magnitudes of the input beamformed and of the truth [sqrt(W)], and their Doppler cells [R]."""

    beamformed: NDArray[np.float32]
    truth: NDArray[np.float32]
    cells: NDArray[np.int64]


def _images(source: TracedSource, radar: Radar, cells: NDArray[np.int64] | None = None) -> _Images:
    """Both images of a traced frame.

    :param cells: [R] Doppler cells to use; the strongest of every range bin otherwise
    """
    chosen: list[DopplerSelection] = []

    def at(step: str, function: Callable[..., Any], *arguments: Any) -> Any:
        value = function(*arguments)
        if step != "Doppler choice":
            return value
        selection = value if cells is None else selection_at(arguments[0], cells)
        chosen.append(selection)
        return selection

    measurement = measured(source, radar, at)
    ((frame, _),) = image([measurement], radar)
    beamformed = delay_and_sum(measurement.frame.range_channel[0], radar)
    return _Images(np.abs(beamformed), frame.image * np.float32(frame.image_peak), chosen[0].cells[0])


def _difference_db(got: NDArray[np.float32], expected: NDArray[np.float32]) -> float:
    peak = float(expected.max(initial=0.0))
    return float(amplitude_to_db(np.abs(got - expected).max() / peak, FLOOR_DB)) if peak > 0.0 else FLOOR_DB
