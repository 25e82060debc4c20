"""The frames that accuracy is measured on: frames of the run itself, with its poses, effects and random streams."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from datafactory.accuracy.knobs import DEFAULT, KnobSettings
from datafactory.accuracy.variants import FAN, LATTICES, SPHERE, ahead_alone
from datafactory.effects.catalogue import ALL
from datafactory.frame.chain import SceneSource, narrowed
from datafactory.frame.deal import DealtFrame
from datafactory.frame.prepared import PreparedScene
from datafactory.paths.rays import RayFan
from datafactory.paths.storage import TracedFrame
from datafactory.paths.table import PathTable
from datafactory.run.order import Order
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


def made_with(order: Order) -> KnobSettings:
    """What the frames of a run are made with, whatever is chosen for accuracy: effects, truth window, video phase."""
    return replace(
        DEFAULT,
        effects=order.effects or ALL,
        budget_db=order.of_scenes.budget_db,
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
    _, paths = narrowed(traced(sample, settings, radar, realisation), settings.chain(), radar)
    return paths
