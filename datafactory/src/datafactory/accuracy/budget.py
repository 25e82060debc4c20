"""``--error-budget``: prices from the cache or measured now, a choice, and the errors that the choice has as a whole.

What a user sees of it: docs/accuracy.md#an-error-budget. Measured are frames of the run itself, because the same scene
may be harmless from one pose and full of corner reflectors from the next. Single prices choose; then the choice is
measured whole, and where it misses the budget, because errors met that the squares did not foresee, the next choice
aims lower by as much.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from datafactory.accuracy.cache import cached, user_cache
from datafactory.accuracy.knobs import DEFAULT, POWER_KNOBS, REFERENCE_DEPTH, SIGNAL_KNOBS, KnobSettings, Menu, Sample
from datafactory.accuracy.looking import Cells, made, reference_of
from datafactory.accuracy.power import Errors, Kept, peak_error, power_error, relative_l2, worst_of
from datafactory.accuracy.prices import Choice, Prices, choose, measure_prices
from datafactory.frame.deal import Deal
from datafactory.paths.backend import select_variant, set_threads
from datafactory.run.preparation import Order, prepare
from datafactory.scenes.materials.table import MaterialTable
from shared.dataset.folder import open_dataset, read_manifest
from shared.dataset.locations import Location
from shared.dataset.manifest import write_manifest
from shared.dataset.reading import read_frame
from shared.physics.errors import InputError
from shared.processes.telling import Announce, Progress

FRAMES = 2
"""Frames of each scene that are measured, spread over the run."""
ROUNDS = 4
"""Choices tried before the last is taken as it is."""

Stored = Callable[[Sample], tuple[Cells, NDArray]]
"""Doppler cells [R] and truth image [R, U] of a frame as a run has written it."""
HONEST_DB = 3.0
"""Achieved and predicted error may differ by this much."""
CHECK_DRAW = 1
"""Of the rays for the power in cells: not those of the prediction, nor of its reference."""


@dataclass(frozen=True)
class SweptScene:
    """A scene of the order: the frames that were measured and, where the run has more, one that was not."""

    swept: tuple[Sample, ...]
    elsewhere: tuple[Sample, ...]


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


def settle(
    order: Order,
    table: MaterialTable,
    level_db: float,
    menu: Menu,
    announce: Announce,
    advance: Progress,
    folder: Path | None = None,
) -> Budget:
    """Choose the settings with the least work for an order's scene frames.

    :param folder: of the cache; the user's by default
    :raises InputError: an order without scenes to trace, or whatever is wrong with them
    """
    if not order.scenes:
        raise InputError("--error-budget", "there is no scene frame to trace", "--scene with --frames or --poses")
    select_variant(order.settings.device)
    set_threads(1)
    folder = folder or user_cache()
    with threadpool_limits(limits=1):
        job = prepare(order, table).job
        scenes = []
        for number, item in enumerate(job.scenes):
            some = first_middle_last(job.deal.frames_of(number))
            samples = tuple(Sample(job.deal.frame(frame_id), item, order) for frame_id in some)
            if samples:
                scenes.append(SweptScene(samples[:FRAMES], samples[FRAMES:]))

        def prices_of(scene: SweptScene) -> Prices:
            def sweep(path: Path) -> Prices:
                name = scene.swept[0].scene.name
                announce(f"{name}: measuring what accuracy costs, once; the result is kept as {path}")
                try:
                    return measure_prices(scene.swept, menu, advance)
                except KeyboardInterrupt:
                    announce(f"{name}: what was measured of its accuracy is not kept, and will be measured again")
                    raise

            return cached(folder, _inputs(scene, {"menu": asdict(menu)}), Prices, sweep, announce)

        def together(scene: SweptScene, chosen: KnobSettings, kept: Kept) -> Errors:
            wanted = {"settings": asdict(chosen), "menu": asdict(menu)}

            def measure(_: Path) -> Errors:
                return errors_together(scene.swept, chosen, menu, kept)

            return cached(folder, _inputs(scene, wanted), Errors, measure, announce)

        prices, traces = [prices_of(scene) for scene in scenes], [Kept() for _ in scenes]
        steps, target_db = len(list(menu.settings())), level_db
        for _ in range(ROUNDS):
            choice = choose(prices, menu, target_db, order.radar)
            advance("the choice as a whole", steps, steps)
            pairs = zip(scenes, traces, strict=True)
            found = worst_of([together(scene, choice.settings, kept) for scene, kept in pairs])
            excess_db = found.worst_db - level_db
            if excess_db <= 0.0 or not choice.keeps_budget:
                break
            target_db -= excess_db
    choice = replace(choice, predicted=found, keeps_budget=excess_db <= 0.0)
    announce(_choice_text(level_db, choice, menu))
    chosen = replace(order, settings=choice.settings.on(order.settings))
    return Budget(level_db, choice, chosen, job.deal, menu, tuple(scenes))


def first_middle_last(frame_ids: Sequence[int]) -> tuple[int, ...]:
    """At most three of these frames, spread over the run: the first, the middle one, the last."""
    if not frame_ids:
        return ()
    return tuple(dict.fromkeys((frame_ids[0], frame_ids[len(frame_ids) // 2], frame_ids[-1])))


def errors_together(
    samples: tuple[Sample, ...],
    chosen: KnobSettings,
    menu: Menu,
    kept: Kept,
    draw: int = 0,
    stored: Stored | None = None,
) -> Errors:
    """The errors of all settings at once, each against everything converged: that of the power in a cell against many
    rays, every bounce and every effect.

    :param kept: realisations traced before; those traced here are added
    :param draw: of the rays, see :func:`datafactory.accuracy.power.power_error`
    :param stored: frames that were made so; without they are made now
    """
    cube, image, power = list[float](), list[float](), list[float]()
    against = replace(chosen, rays=menu.effort.reference_rays, depth=REFERENCE_DEPTH)
    for sample in samples:
        error = power_error(sample, chosen, sample.complete(), against, menu.effort, kept, draw)
        power.append(error.peak)
        if menu.paths_only:
            continue
        radar, settings, frames = sample.order.radar, sample.settings(chosen), [sample.traced(chosen)]
        rows, picture = stored(sample) if stored else (None, None)
        reference = reference_of(frames, settings, radar, None if rows is None else [rows])
        outcome = made(frames, settings, radar, rows=reference.cells if rows is None else [rows])
        cube.append(relative_l2(outcome.cubes[0], reference.cubes[0]))
        image.append(peak_error(outcome.images[0] if picture is None else picture, reference.images[0]))
    return Errors.of(cube, image, power)


def _inputs(scene: SweptScene, wanted: dict[str, Any]) -> dict[str, Any]:
    """What a measurement follows from, beside the code."""
    first = scene.swept[0]
    prepared, frames = first.scene, [item.frame for item in scene.swept]
    return {
        "scene": prepared.content,
        "materials": prepared.materials.to_json(),
        "made_with": asdict(first.settings(DEFAULT)),
        "radar": first.order.radar.model_dump(mode="json"),
        "frames": [[dealt.frame_id, dealt.seed, dealt.shared_seed, asdict(dealt.where)] for dealt in frames],
        "wanted": wanted,
    }


def _choice_text(budget_db: float, choice: Choice, menu: Menu) -> str:
    s = choice.settings
    text = f"error budget {budget_db:g} dB: {s.rays} rays, depth {s.depth}, "
    if not menu.paths_only:
        text += f"pruning at {s.prune_db:g} dB, tolerance {s.tolerance:g}, {s.truth_terms} truth terms; "
    text += f"{choice.work:.2f} s of work a frame; predicted {choice.predicted}"
    return text if choice.keeps_budget else f"{text}. NOT KEPT: nothing on the menu was found that keeps this budget"


def check(budget: Budget, directory: Location, announce: Announce) -> None:
    """Measure the errors of the finished run on the frames swept and on one that was not; print and record them.

    The image is the dataset's own, read back, in the Doppler cells that its noise chose; of traced paths there is none.
    For the power in a cell the rays are drawn anew: the realisations are not those of the prediction.
    """
    started = time.perf_counter()
    choice, menu = budget.choice, budget.menu
    dataset = None if menu.paths_only else open_dataset(directory)

    def stored(sample: Sample) -> tuple[Cells, NDArray]:
        """The frame's row."""
        assert dataset is not None
        split, place = budget.deal.place_of(sample.frame.frame_id)
        frame = read_frame(*dataset.rows(split)[place], ("velocity", "image"))
        cells = sample.order.radar.waveform.doppler_cells(frame.velocity[0])
        return cells, frame.image * np.float32(frame.image_peak)

    def achieved_by(samples: tuple[Sample, ...]) -> Errors:
        return errors_together(samples, choice.settings, menu, Kept(), CHECK_DRAW, stored)

    with threadpool_limits(limits=1):
        achieved = worst_of([achieved_by(scene.swept) for scene in budget.scenes])
        others = [achieved_by(scene.elsewhere) for scene in budget.scenes if scene.elsewhere]
    predicted = choice.predicted.measured()
    differences = {name: round(value - predicted[name], 1) for name, value in achieved.measured().items()}
    honest = max(map(abs, differences.values())) <= HONEST_DB
    kept = worst_of([achieved, *others]).worst_db <= budget.level_db
    chosen = POWER_KNOBS if menu.paths_only else (*POWER_KNOBS, *SIGNAL_KNOBS)
    entry: dict[str, Any] = {
        "budget_db": budget.level_db,
        "keeps_budget": choice.keeps_budget and kept,
        "settings": {name: getattr(choice.settings, name) for name in chosen},
        "work_per_frame": choice.work,
        "frames": [sample.frame.frame_id for scene in budget.scenes for sample in scene.swept],
        "predicted": predicted,
        "achieved": achieved.measured(),
        "achieved_less_predicted_db": differences,
        "prediction_within_3_db": honest,
        "other_frames": [sample.frame.frame_id for scene in budget.scenes for sample in scene.elsewhere],
        "achieved_on_other_frames": worst_of(others).measured() if others else None,
    }
    manifest = read_manifest(directory)
    manifest["error_budget"] = entry
    manifest["made"]["error_budget_check_seconds"] = round(time.perf_counter() - started, 1)
    write_manifest(directory, manifest)
    announce(f"error predicted: {choice.predicted}; achieved: {achieved}")
    if others:
        announce(f"error on frames that were not swept: {worst_of(others)}")
    if not honest:
        announce(f"warning: prediction and achieved error differ by more than {HONEST_DB:.0f} dB")
    if not kept:
        announce(f"warning: the error budget of {budget.level_db:g} dB is not kept")
