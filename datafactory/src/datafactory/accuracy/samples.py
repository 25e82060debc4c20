"""The frames that accuracy is measured on: frames of the run itself, with its poses, effects and random streams."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from datafactory.accuracy.knobs import DEFAULT, POWER_EFFECTS, KnobSettings
from datafactory.accuracy.variants import FAN, LATTICES, SPHERE, ahead_alone
from datafactory.effects.catalogue import NAMES, PATH_EFFECTS, EffectSet
from datafactory.effects.evidence import FLOOR_DB
from datafactory.effects.plan import EffectPlan
from datafactory.frame.chain import SceneSource, illuminated
from datafactory.frame.deal import DealtFrame
from datafactory.frame.prepared import PreparedScene
from datafactory.paths.rays import RayFan
from datafactory.paths.storage import TracedFrame
from datafactory.paths.table import PathTable
from datafactory.run.order import Order
from datafactory.run.preparation import Prepared
from shared.radar import Radar


@dataclass(frozen=True)
class SampleFrame:
    """A frame of a run, to measure on."""

    frame: DealtFrame
    scene: PreparedScene

    @property
    def frame_id(self) -> int:
        """Its index in the run."""
        return self.frame.frame_id


@dataclass(frozen=True)
class PlannedScene:
    """A scene of a run, with what the run simulates of it.

    :param plan: what is simulated of it
    :param absent: effects that the scene or the radar has nothing for
    """

    number: int
    scene: PreparedScene
    plan: EffectPlan
    absent: frozenset[str]

    @property
    def effects(self) -> EffectSet:
        """What the frames that were looked at for the plan call for, all together."""
        return self.plan.effects

    def effects_of(self, frame: DealtFrame) -> EffectSet:
        """What one of its frames is made with: its own effects on paths, on the signal those of the plan."""
        at = self.plan.effects_at(frame.pose)
        return EffectSet.of({name for name in NAMES if getattr(at if name in PATH_EFFECTS else self.effects, name)})

    @property
    def changes_db(self) -> dict[str, float]:
        """What each effect changes in the frames that were looked at [dB of the peak]; none where nothing was."""
        if self.plan.by_frame is None:
            return {}
        return {item.effect: item.loss_db for item in self.plan.decisions}

    @property
    def complete(self) -> EffectSet:
        """The planned effects and whatever the plan leaves out of the paths although the scene has it."""
        effects = self.effects
        for name in POWER_EFFECTS:
            if name not in self.absent:
                effects = effects.with_also(name)
        return effects


def planned_scenes(order: Order, prepared: Prepared) -> list[PlannedScene]:
    """The scenes of a run.

    Where the user chose the effects, nothing else is looked at: all others count as absent.
    """
    scenes = []
    for number, (scene, plan) in enumerate(zip(prepared.scenes, prepared.plans, strict=True)):
        absent = {item.effect for item in plan.decisions if item.loss_db <= FLOOR_DB}
        if order.effects is not None:
            absent = {item.effect for item in plan.decisions if not item.on}
        scenes.append(PlannedScene(number, scene, plan, frozenset(absent)))
    return scenes


def made_with(order: Order, effects: EffectSet) -> KnobSettings:
    """What the frames of a run are made with, whatever is chosen for accuracy: effects, truth window, video phase."""
    return replace(
        DEFAULT,
        effects=effects,
        truth_window=order.settings.processing.truth_window,
        video_phase=order.radar.waveform.residual_video_phase,
        device=order.settings.device,
    )


def traced(sample: SampleFrame, settings: KnobSettings, radar: Radar, realisation: int = 0) -> TracedFrame:
    """One realisation of a frame's paths; number 0 has the rays of the run itself."""

    def at(step: str, function: Callable[..., Any], *arguments: Any) -> Any:
        if step != "trace" or settings.lattice == FAN:
            return function(*arguments)
        swapped = [
            LATTICES[settings.lattice](item.count, offset=item.offset) if isinstance(item, RayFan) else item
            for item in arguments
        ]
        return function(*swapped)

    frame = SceneSource(sample.frame.with_rays(realisation), sample.scene, settings.chain()).traced(radar, at)
    return replace(frame, table=ahead_alone(frame.table)) if settings.lattice == SPHERE else frame


def lit_paths(sample: SampleFrame, settings: KnobSettings, radar: Radar, realisation: int = 0) -> PathTable:
    """Illuminated paths of one realisation."""
    return illuminated(traced(sample, settings, radar, realisation), settings.chain(), radar)
