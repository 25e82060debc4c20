"""The knobs between a scene and a frame: what is chosen, and what there is to choose from.

Two kinds. The settings of a *signal* knob see the same traced paths, so that cubes and images can be subtracted. A
*power* knob changes the paths themselves and with them the speckle: subtracting images would compare two
realisations. What converges there is the power in a resolution cell (:mod:`datafactory.accuracy.power`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from datafactory.effects.catalogue import ALL
from datafactory.frame.chain import ChainSettings, SceneSource, narrowed
from datafactory.frame.deal import DealtFrame, PreparedScene
from datafactory.paths.cells import UNPRUNED_DB
from datafactory.paths.storage import TracedFrame
from datafactory.paths.table import PathTable
from datafactory.run.preparation import Order
from shared.dataset import STORES

KNOBS = ("rays", "depth", "prune_db", "tolerance", "truth_terms")
POWER_KNOBS, SIGNAL_KNOBS = KNOBS[:2], KNOBS[2:]
REFERENCE_DEPTH = 3
MOST_REALISATIONS = 16
"""Where single rays rule a frame (50 000 of them, few surfaces, error -10 dB), two draws of 4 differed by 3.5 dB, and
two of 16 by 1 dB.
"""


@dataclass(frozen=True)
class KnobSettings:
    """A setting of every knob, in their order.

    :param rays, depth: see :class:`datafactory.paths.solver.TraceSettings`
    :param prune_db: see :func:`datafactory.paths.cells.pruned`
    :param tolerance: of the cube, relative L2
    :param truth_terms: polynomial terms of the range walk
    """

    rays: int
    depth: int
    prune_db: float
    tolerance: float
    truth_terms: int

    @staticmethod
    def of(chain: ChainSettings) -> KnobSettings:
        """Those of the chain."""
        trace, processing = chain.trace, chain.processing
        return KnobSettings(trace.rays, trace.depth, chain.prune_db, processing.tolerance, processing.truth_terms)

    def on(self, chain: ChainSettings) -> ChainSettings:
        """The chain with these."""
        return replace(
            chain,
            trace=replace(chain.trace, rays=self.rays, depth=self.depth),
            prune_db=self.prune_db,
            processing=replace(chain.processing, tolerance=self.tolerance, truth_terms=self.truth_terms),
        )

    def at(self, knob: str, value: Any) -> KnobSettings:
        """These with another setting of one knob."""
        return replace(self, **{knob: value})

    def converged(self) -> KnobSettings:
        """What signal knobs are varied around: nothing pruned, the cube at -120 dB, the truth at its best."""
        return replace(self, prune_db=UNPRUNED_DB, tolerance=1e-6, truth_terms=6)

    def reference(self) -> KnobSettings:
        """What signal knobs are held against: two orders below the finest tolerance of a menu, which makes the cube
        complex128, and the range walk developed to -120 dB."""
        return replace(self, prune_db=UNPRUNED_DB, tolerance=1e-11, truth_terms=8)

    def __str__(self) -> str:
        return (
            f"{self.rays} rays, depth {self.depth}, prune {self.prune_db:g} dB, tolerance {self.tolerance:g}, "
            f"{self.truth_terms} truth terms"
        )


DEFAULT = KnobSettings.of(ChainSettings())


@dataclass(frozen=True)
class Effort:
    """How well the power in cells is measured.

    :param reference_rays: rays of the converged tracing
    :param realisations: of the rays, of every setting; of few rays there are more, see :meth:`count`
    :param reference_realisations: of the reference
    """

    reference_rays: int
    realisations: int = 4
    reference_realisations: int = 4

    def count(self, rays: int) -> int:
        """Realisations of this many rays: few rays scatter most, and more of them cost little."""
        return min(max(self.realisations, self.realisations * self.reference_rays // (4 * rays)), MOST_REALISATIONS)


@dataclass(frozen=True)
class Menu:
    """What may be chosen from, each from cheap to dear; the default is an error budget's.

    Fewer rays save nothing: a pass of rays has a price whatever their number
    (:data:`datafactory.accuracy.prices.PASS_S`). A budget's reference has as many as the menu's most in each
    realisation; its mean over four errs half as much, and what is left of it is subtracted.

    :param prune_db, tolerance, truth_terms: none where only paths are made; the default stays then
    :param usual_rays: of everything but the rays' own settings
    """

    rays: tuple[int, ...] = (3_125, 6_250, 12_500, 25_000, 50_000, 100_000, 200_000, 400_000, 800_000)
    depth: tuple[int, ...] = (1, 2, REFERENCE_DEPTH)
    prune_db: tuple[float, ...] = (-20.0, -30.0, -40.0, -50.0, -60.0)
    tolerance: tuple[float, ...] = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
    truth_terms: tuple[int, ...] = (3, 4, 5, 6)
    effort: Effort = field(default_factory=lambda: Effort(800_000))
    usual_rays: int = DEFAULT.rays

    @property
    def paths_only(self) -> bool:
        """Whether nothing is chosen but how to trace."""
        return not (self.prune_db or self.tolerance or self.truth_terms)

    def of_paths(self) -> Menu:
        """What of it concerns the paths alone."""
        return replace(self, prune_db=(), tolerance=(), truth_terms=())

    @property
    def usual(self) -> KnobSettings:
        """What knobs are while another one is varied: the default where the menu has it, else its middle number of rays
        and its last depth."""
        rays = self.usual_rays if self.usual_rays in self.rays else self.rays[len(self.rays) // 2]
        depth = DEFAULT.depth if DEFAULT.depth in self.depth else self.depth[-1]
        return replace(DEFAULT, rays=rays, depth=depth)

    def settings(self, *knobs: str) -> Iterator[tuple[str, Any]]:
        """Knob and value of all that is measured."""
        for knob in knobs or (*SIGNAL_KNOBS, *POWER_KNOBS):
            for value in getattr(self, knob):
                yield knob, value

    def with_rays(self, rays: int) -> Menu:
        """With this number of rays, and a reference of at least twice as many."""
        reference_rays = max(self.effort.reference_rays, 2 * rays)
        return replace(
            self, rays=tuple(sorted({*self.rays, rays})), effort=replace(self.effort, reference_rays=reference_rays)
        )

    def with_more_rays(self, most: int) -> Menu:
        """The rays going on in doublings to ``most``, which is the last."""
        menu, rays = self, 2 * self.rays[-1]
        while rays < most:
            menu, rays = menu.with_rays(rays), 2 * rays
        return menu.with_rays(most)


def menu_for(rays: int | None, depth: int | None) -> Menu:
    """The full menu, or only what the user asked for where they did."""
    menu = Menu() if rays is None else replace(Menu().with_rays(rays), rays=(rays,))
    return menu if depth is None else replace(menu, depth=(depth,))


STUDY = replace(
    Menu(), prune_db=(*Menu.prune_db, UNPRUNED_DB), tolerance=(*Menu.tolerance, 1e-9), effort=Effort(1_600_000)
)
"""What ``datafactory accuracy`` measures: the exact kernel and unpruned cubes as well."""
QUICK = Menu(
    rays=tuple(rays for rays in Menu.rays if rays <= DEFAULT.rays), tolerance=(1e-2, 1e-3, 1e-4, 1e-6),
    effort=Effort(400_000, realisations=2, reference_realisations=3), usual_rays=50_000,
)  # fmt: skip
"""What ``--quick`` measures of it, with a quarter of the rays."""


@dataclass(frozen=True)
class Sample:
    """A frame of a run, to be made under other settings of the knobs, without noise and whatever is to be stored."""

    frame: DealtFrame
    scene: PreparedScene
    order: Order

    def settings(self, knobs: KnobSettings) -> ChainSettings:
        """How the frame is made with these knobs: the rest is the run's."""
        chain = replace(self.order, settings=knobs.on(self.order.settings)).of_scenes
        return replace(chain, processing=replace(chain.processing, noise=False, store=STORES[0]))

    def complete(self) -> Sample:
        """The same with every effect that the run may have, whatever the frame decides to leave out."""
        return replace(self, order=replace(self.order, effects=self.order.effects or ALL))

    def traced(self, knobs: KnobSettings, realisation: int = 0) -> TracedFrame:
        """One realisation of the paths; number 0 has the rays of the run itself."""
        return SceneSource(self.frame.with_rays(realisation), self.scene, self.settings(knobs)).traced(self.order.radar)

    def lit_paths(self, knobs: KnobSettings, realisation: int = 0) -> PathTable:
        """Illuminated paths of one realisation."""
        _, paths = narrowed(self.traced(knobs, realisation), self.settings(knobs), self.order.radar)
        return paths
