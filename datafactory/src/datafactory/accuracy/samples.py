"""The frames that accuracy is measured on: frames of the run itself, with its poses, effects and random streams."""

from __future__ import annotations

from dataclasses import dataclass, replace

from datafactory.accuracy.knobs import KnobSettings
from datafactory.effects.catalogue import ALL
from datafactory.frame.chain import ChainSettings, SceneSource, narrowed
from datafactory.frame.deal import DealtFrame
from datafactory.frame.prepared import PreparedScene
from datafactory.paths.storage import TracedFrame
from datafactory.paths.table import PathTable
from datafactory.run.order import Order
from shared.dataset import STORES
from shared.radar import Radar


@dataclass(frozen=True)
class Sample:
    """A frame of a run, to be made under other settings of the knobs, without noise and whatever is to be stored."""

    frame: DealtFrame
    scene: PreparedScene
    order: Order

    @property
    def frame_id(self) -> int:
        """Its index in the run."""
        return self.frame.frame_id

    @property
    def radar(self) -> Radar:
        return self.order.radar

    def settings(self, knobs: KnobSettings) -> ChainSettings:
        """How the frame is made with these knobs: the rest is the run's."""
        chain = replace(self.order, settings=knobs.on(self.order.settings)).of_scenes
        return replace(chain, processing=replace(chain.processing, noise=False, store=STORES[0]))

    def complete(self) -> Sample:
        """The same with every effect that the run may have, whatever the frame decides to leave out."""
        return replace(self, order=replace(self.order, effects=self.order.effects or ALL))

    def traced(self, knobs: KnobSettings, realisation: int = 0) -> TracedFrame:
        """One realisation of the paths; number 0 has the rays of the run itself."""
        return SceneSource(self.frame.with_rays(realisation), self.scene, self.settings(knobs)).traced(self.radar)

    def lit_paths(self, knobs: KnobSettings, realisation: int = 0) -> PathTable:
        """Illuminated paths of one realisation."""
        _, paths = narrowed(self.traced(knobs, realisation), self.settings(knobs), self.radar)
        return paths
