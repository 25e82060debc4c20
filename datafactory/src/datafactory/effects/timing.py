"""What effects cost: processor seconds of one frame, with and without them, on this machine."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

from datafactory.effects.catalogue import ALL, NAMES, NO_CHOICE, EffectSet
from datafactory.effects.losses import FLOOR_DB
from datafactory.effects.plan import EffectPlan
from datafactory.frame.chain import ChainSettings, SceneSource, make_frames
from datafactory.frame.deal import DealtFrame
from datafactory.frame.prepared import PreparedScene
from shared.radar import Radar

Advance = Callable[[int, int, str], None]


def frame_seconds(frame: DealtFrame, scene: PreparedScene, radar: Radar, settings: ChainSettings) -> float:
    """Processor seconds of this process from the scene to the image; what else runs on the machine hardly counts."""
    started = time.process_time()
    for _ in make_frames([SceneSource(frame, scene, settings)], radar):
        pass
    return time.process_time() - started


def costs(
    frame: DealtFrame,
    scene: PreparedScene,
    radar: Radar,
    settings: ChainSettings,
    plan: EffectPlan,
    advance: Advance = lambda done, total, label: None,
) -> dict[str, float]:
    """Seconds that each effect takes of a frame with every effect.

    What the scene lacks, and what is no choice, costs nothing and is not timed.

    :param settings: of the run, with every effect
    """

    def seconds(of: EffectSet) -> float:
        return frame_seconds(frame, scene, radar, of.settings(replace(settings, budget_db=None)))

    asked = [item.effect for item in plan.decisions if item.loss_db > FLOOR_DB and item.effect not in NO_CHOICE]
    advance(0, len(asked) + 1, "every effect")
    seconds(ALL)  # compiles what is to be compiled
    every = seconds(ALL)
    result = dict.fromkeys(NAMES, 0.0)
    for index, name in enumerate(asked):
        advance(index + 1, len(asked) + 1, name)
        result[name] = max(every - seconds(ALL.without(name)), 0.0)
    return result
