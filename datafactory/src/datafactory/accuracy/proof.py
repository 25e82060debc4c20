"""Whether frames keep their promise: one as it decides by itself beside the same with every effect; and what effects
cost: processor seconds of one frame, with and without them, on this machine.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from datafactory.accuracy.looking import Cells, made
from datafactory.accuracy.power import level_db, peak_error
from datafactory.effects.catalogue import ALL, NAMES, NO_CHOICE, EffectSet
from datafactory.effects.plan import FLOOR_DB, EffectPlan
from datafactory.frame.chain import ChainSettings, SceneSource, illuminated, make_frames, narrowed
from datafactory.paths.cells import UNPRUNED_DB, cell_power
from shared.physics.units import power_to_db
from shared.processes.telling import Progress
from shared.radar import Radar
from shared.signal.imaging import delay_and_sum
from shared.signal.spectrum import range_doppler, selection_at

REPEATS = 2
"""Timed frames of each kind, one beside the other in turn; the least counts."""


def frame_seconds(source: SceneSource, radar: Radar) -> float:
    """Processor seconds of this process from the scene to the image; what else runs on the machine hardly counts."""
    started = time.process_time()
    for _ in make_frames([source], radar):
        pass
    return time.process_time() - started


def costs(source: SceneSource, radar: Radar, plan: EffectPlan, advance: Progress) -> dict[str, float]:
    """Seconds that each effect takes of a frame with every effect: how much faster the frame is without it alone.

    Frames of all kinds take turns: the machine's pace changes. The first of each compiles, and is not measured. What
    the scene lacks, and what is no choice, costs nothing and is not timed.

    :param source: with every effect
    """

    def seconds(of: EffectSet) -> float:
        return frame_seconds(replace(source, settings=of.settings(replace(source.settings, budget_db=None))), radar)

    asked = [item.effect for item in plan.decisions if item.loss_db > FLOOR_DB and item.effect not in NO_CHOICE]
    kinds = {"every effect": ALL, **{name: ALL.without(name) for name in asked}}
    least = dict.fromkeys(kinds, math.inf)
    for turn in range(REPEATS + 1):
        for index, (name, effects) in enumerate(kinds.items()):
            advance(name, turn * len(kinds) + index, (REPEATS + 1) * len(kinds))
            taken = seconds(effects)
            least[name] = min(least[name], taken) if turn else math.inf
    return {name: max(least["every effect"] - least.get(name, math.inf), 0.0) for name in NAMES}


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
    expected = made([complete], _bare(everything), radar)
    got = made([alone], _bare(narrow), radar, rows=expected.cells)
    window = settings.processing.truth_window
    reference = cell_power(illuminated(complete, everything, radar), radar, window)
    inputs = [_beamformed(outcome.cubes[0], expected.cells[0], radar) for outcome in (got, expected)]
    pairs = [[frame_seconds(of, radar) for of in sources] for _ in range(REPEATS)]
    planned_seconds, all_seconds = (min(times) for times in zip(*pairs, strict=True))
    return Proof(
        power_db=float(power_to_db(peak_error(cell_power(paths, radar, window), reference), FLOOR_DB)),
        input_db=level_db(peak_error(*inputs)),
        truth_db=level_db(peak_error(got.images, expected.images)),
        planned_seconds=planned_seconds,
        all_seconds=all_seconds,
    )


def _bare(settings: ChainSettings) -> ChainSettings:
    """Without noise, and with every path that there is."""
    silent = replace(settings.processing, noise=False, store="range-channel")
    return replace(settings, processing=silent, prune_db=UNPRUNED_DB, budget_db=None)


def _beamformed(cube: NDArray, cells: Cells, radar: Radar) -> NDArray[np.float32]:
    """[R, U] magnitudes of the input in the Doppler cells [R] [sqrt(W)]."""
    rows = selection_at(range_doppler(cube, radar), cells).range_channel[0]
    magnitudes: NDArray[np.float32] = np.abs(delay_and_sum(rows, radar))
    return magnitudes
