"""``--error-budget``: prices from the cache or a sweep, a choice, and the errors that the choice has all together.

Prices belong to a scene, its materials and effects, the radar, the poses, the menu and the code; they are measured
once. The sweep looks at frames of the run itself, because the same scene may be harmless from one pose and full of
corner reflectors from the next. Single prices choose; then the choice is measured whole, and where it misses the
budget, because errors met that the squares did not foresee, the next choice aims lower by as much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from datafactory.accuracy.cache import Announce, cached, user_cache
from datafactory.accuracy.clock import Advance, Clock
from datafactory.accuracy.errors import peak_error, relative_l2
from datafactory.accuracy.knobs import REFERENCE_DEPTH, KnobSettings
from datafactory.accuracy.looking import reference_of, run
from datafactory.accuracy.power import Kept, power_error
from datafactory.accuracy.prices import Choice, Errors, Menu, Prices, choose, measure_prices
from datafactory.accuracy.samples import SampleFrame, made_with, traced
from datafactory.frame.deal import Deal, first_middle_last
from datafactory.frame.prepared import PreparedScene
from datafactory.paths.backend import select_variant, set_threads
from datafactory.run.order import Order
from datafactory.run.preparation import prepare
from datafactory.scenes.materials.table import MaterialTable
from shared.physics.errors import InputError

FRAMES = 2
"""Frames of each scene that are swept, spread over the run."""
ROUNDS = 4
"""Choices tried before the last is taken as it is."""


@dataclass(frozen=True)
class SweptScene:
    """A scene of the order: the frames that were swept and, where the run has more, one that was not."""

    scene: PreparedScene
    swept: tuple[SampleFrame, ...]
    elsewhere: tuple[SampleFrame, ...]


@dataclass(frozen=True)
class Budget:
    """A budget and what was chosen for it.

    :param choice: its prediction was measured on the frames swept, all settings at once
    :param order: the user's, with the settings chosen
    :param deal: which frame of the run is which
    """

    level_db: float
    choice: Choice
    order: Order
    deal: Deal
    menu: Menu
    scenes: tuple[SweptScene, ...]


def menu_for(rays: int | None, depth: int | None) -> Menu:
    """The full menu, or only what the user asked for where they did."""
    menu = Menu()
    if rays is not None:
        effort = replace(menu.effort, reference_rays=max(2 * rays, menu.effort.reference_rays))
        menu = replace(menu, rays=(rays,), effort=effort)
    return menu if depth is None else replace(menu, depth=(depth,))


def settle(
    order: Order,
    table: MaterialTable,
    level_db: float,
    menu: Menu,
    announce: Announce,
    advance: Advance,
    folder: Path | None = None,
) -> Budget:
    """Choose the settings with the least counted work for an order's scene frames.

    :param folder: of the cache; the user's by default
    :raises InputError: an order without scenes to trace, or whatever is wrong with them
    """
    if not order.scenes:
        raise InputError("--error-budget", "there is no scene frame to trace", "--scene with --frames or --poses")
    select_variant(order.settings.device)
    set_threads(1)
    radar, folder = order.radar, folder or user_cache()
    scenes, prices = [], []
    with threadpool_limits(limits=1):
        prepared = prepare(order, table)
        for number, item in enumerate(prepared.scenes):
            scene = _swept(prepared.deal, number, item)
            if not scene.swept:
                continue
            scenes.append(scene)

            def sweep(path: Path, scene: SweptScene = scene) -> Prices:
                announce(f"{scene.scene.name}: measuring what accuracy costs, once; the result is kept as {path}")
                return measure_prices(scene.swept, menu, radar, made_with(order), advance)

            prices.append(cached(folder, _inputs(scene, order, asdict(menu)), Prices, sweep, announce))
        traces: list[Kept] = [{} for _ in scenes]
        target_db = level_db
        for _ in range(ROUNDS):
            choice = choose(prices, menu, target_db, radar)
            advance(menu.steps(), menu.steps(), "the choice as a whole")
            predicted = worst_of(
                [
                    _together(scene, choice.settings, menu, order, kept, folder, announce)
                    for scene, kept in zip(scenes, traces, strict=True)
                ]
            )
            excess_db = predicted.worst_db - level_db
            if excess_db <= 0.0 or not choice.keeps_budget:
                break
            target_db -= excess_db
    choice = replace(choice, predicted=predicted, keeps_budget=excess_db <= 0.0)
    announce(_choice_text(level_db, choice, menu))
    return Budget(level_db, choice, _with_choice(order, choice.settings), prepared.deal, menu, tuple(scenes))


def _with_choice(order: Order, chosen: KnobSettings) -> Order:
    """The order, its frames made as chosen."""
    before = order.settings
    return replace(
        order,
        settings=replace(
            before,
            processing=replace(before.processing, tolerance=chosen.tolerance, truth_terms=chosen.truth_terms),
            trace=replace(before.trace, rays=chosen.rays, depth=chosen.depth),
            prune_db=chosen.prune_db,
        ),
    )


def as_run(chosen: KnobSettings, order: Order) -> KnobSettings:
    """What was chosen, with what the run makes its frames with."""
    names = ("rays", "depth", "prune_db", "tolerance", "truth_terms")
    return replace(made_with(order), **{name: getattr(chosen, name) for name in names})


def errors_together(scene: SweptScene, chosen: KnobSettings, menu: Menu, order: Order, kept: Kept) -> Errors:
    """The errors of all settings at once on the frames swept, each against everything converged.

    :param kept: realisations traced before; the reference's are added
    """
    radar = order.radar
    cube, image, settings = list[float](), list[float](), as_run(chosen, order)
    for sample in () if menu.paths_only else scene.swept:
        frames = [traced(sample, settings, radar)]
        reference = reference_of(frames, settings, radar)
        outcome = run(frames, settings, radar, Clock(), reference.cells, batch=1)
        cube.append(relative_l2(outcome.cubes[0], reference.cubes[0]))
        image.append(peak_error(outcome.images[0], reference.images[0]))
    return Errors.of(cube, image, power_errors(scene.swept, chosen, menu, order, kept))


def power_errors(
    samples: Sequence[SampleFrame],
    chosen: KnobSettings,
    menu: Menu,
    order: Order,
    kept: Kept,
    draw: int = 0,
) -> list[float]:
    """Of the power in a cell, amplitude over peak, against many rays, every bounce and every effect, by frame.

    :param draw: of the rays, see :func:`datafactory.accuracy.power.power_error`
    """
    settings = as_run(chosen, order)
    against = replace(settings, budget_db=None, rays=menu.effort.reference_rays, depth=REFERENCE_DEPTH)
    return [
        power_error(sample, settings, against, menu.effort, order.radar, kept, draw=draw).peak for sample in samples
    ]


def worst_of(scenes: Sequence[Errors]) -> Errors:
    """The largest of each error."""
    every = [errors.model_dump() for errors in scenes]

    def largest(name: str) -> float | None:
        values = [errors[name] for errors in every if errors[name] is not None]
        return max(values) if values else None

    return Errors.model_validate({name: largest(name) for name in Errors.model_fields})


def _together(
    scene: SweptScene, chosen: KnobSettings, menu: Menu, order: Order, kept: Kept, folder: Path, announce: Announce
) -> Errors:
    wanted = {"settings": asdict(chosen), "menu": asdict(menu)}

    def measure(path: Path) -> Errors:
        return errors_together(scene, chosen, menu, order, kept)

    return cached(folder, _inputs(scene, order, wanted), Errors, measure, announce)


def _swept(deal: Deal, number: int, scene: PreparedScene) -> SweptScene:
    """The frames of one scene to look at; none where the run has no frame of it."""
    samples = tuple(SampleFrame(deal.frame(frame_id), scene) for frame_id in first_middle_last(deal.frames_of(number)))
    return SweptScene(scene, samples[:FRAMES], samples[FRAMES:])


def _inputs(scene: SweptScene, order: Order, wanted: dict[str, Any]) -> dict[str, Any]:
    prepared = scene.scene
    return {
        "scene": prepared.content,
        "materials": prepared.materials.to_json(),
        "made_with": asdict(made_with(order)),
        "radar": order.radar.model_dump(mode="json"),
        "frames": [[item.frame_id, item.frame.seed, asdict(item.frame.where)] for item in scene.swept],
        "wanted": wanted,
    }


def _choice_text(budget_db: float, choice: Choice, menu: Menu) -> str:
    s = choice.settings
    text = f"error budget {budget_db:g} dB: {s.rays} rays, depth {s.depth}, "
    if not menu.paths_only:
        text += f"pruning at {s.prune_db:g} dB, tolerance {s.tolerance:g}, {s.truth_terms} truth terms; "
    text += f"{choice.work:.2e} multiply-adds a frame; predicted {choice.predicted}"
    return text if choice.keeps_budget else f"{text}. NOT KEPT: nothing on the menu was found that keeps this budget"
