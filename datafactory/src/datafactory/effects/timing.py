"""What effects cost: seconds of one frame, with and without them, on this machine."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from datafactory.effects.catalogue import ALL, NAMES, EffectSet
from datafactory.effects.evidence import FLOOR_DB, Evidence, Probe
from datafactory.frame import chain as frames
from datafactory.paths.prune import DEFAULT_LEVEL_DB, pruned
from datafactory.paths.rays import RayFan
from datafactory.paths.trace import trace

Advance = Callable[[int, int, str], None]


def frame_seconds(probe: Probe, effects: EffectSet, processing: frames.Processing, repeats: int = 1) -> float:
    """Seconds from the scene to the image at the probe's first pose, the least of some repeats; one core."""
    radar, waveform = probe.radar, probe.radar.waveform
    settings = effects.trace(probe.settings)
    setting = frames.Setting(0, "scene", "timing", probe.seed)

    def once() -> float:
        started = time.perf_counter()
        fan = RayFan(settings.rays)
        table = trace(probe.stage, probe.materials, probe.poses[0], waveform.mid_sweep_hz, settings, fan, 0)
        paths = table.within(radar).illuminated(effects.front_end(radar.front_end))
        paths = pruned(paths, radar, DEFAULT_LEVEL_DB)
        generator = np.random.default_rng(probe.seed)
        measured = frames.measure(setting, paths, (), radar, effects.processing(processing), generator)
        for _ in frames.image([measured], radar, processing.store):
            pass
        return time.perf_counter() - started

    return min(once() for _ in range(repeats))


@dataclass(frozen=True)
class Saving:
    """Seconds a frame as planned and with every effect, at the same pose."""

    scene: str
    planned_seconds: float
    all_seconds: float


def saving(scene: str, probe: Probe, effects: EffectSet, processing: frames.Processing) -> Saving | None:
    """What a plan saves of each frame's time; None where it leaves nothing out."""
    if effects == ALL:
        return None
    everything = frame_seconds(probe, ALL, processing)  # compiles, so that it is run once more below
    planned = frame_seconds(probe, effects, processing)
    return Saving(scene, planned, min(everything, frame_seconds(probe, ALL, processing)))


def costs(
    probe: Probe,
    effects: EffectSet,
    evidence: Mapping[str, Evidence],
    processing: frames.Processing,
    advance: Advance = lambda done, total, label: None,
) -> dict[str, float]:
    """Seconds a frame that each effect takes, or would take, beside the others of the plan.

    An effect that the scene lacks costs nothing and is not timed.
    """
    asked = [name for name in NAMES if evidence[name].change_db > FLOOR_DB]
    advance(0, len(asked) + 1, "the plan itself")
    frame_seconds(probe, ALL, processing)  # compiles what is to be compiled
    planned = frame_seconds(probe, effects, processing)
    result = dict.fromkeys(NAMES, 0.0)
    for index, name in enumerate(asked):
        advance(index + 1, len(asked) + 1, name)
        on = getattr(effects, name)
        other = frame_seconds(probe, replace(effects, **{name: not on}), processing)
        result[name] = max(planned - other if on else other - planned, 0.0)
    return result
