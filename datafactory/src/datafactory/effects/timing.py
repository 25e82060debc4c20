"""What effects cost: processor seconds of one frame, with and without them, on this machine."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

from datafactory.effects.catalogue import ALL, NAMES, EffectSet
from datafactory.effects.evidence import FLOOR_DB
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
    """Seconds a frame that each effect takes, or would take, beside the others of the plan.

    An effect that the scene lacks costs nothing and is not timed.

    :param settings: of the run, with every effect
    """
    effects = plan.effects

    def seconds(of: EffectSet) -> float:
        return frame_seconds(frame, scene, radar, of.settings(settings))

    asked = [item.effect for item in plan.decisions if item.loss_db > FLOOR_DB]
    advance(0, len(asked) + 1, "the plan itself")
    seconds(ALL)  # compiles what is to be compiled
    planned = seconds(effects)
    result = dict.fromkeys(NAMES, 0.0)
    for index, name in enumerate(asked):
        advance(index + 1, len(asked) + 1, name)
        on = getattr(effects, name)
        other = seconds(replace(effects, **{name: not on}))
        result[name] = max(planned - other if on else other - planned, 0.0)
    return result
