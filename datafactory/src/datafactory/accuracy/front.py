"""The front: for one error after the other the cheapest settings, as an error budget would choose them.

Two of them. *Everything*: rays, depth, pruning, tolerance and truth terms against the worst of the three errors. *Same
paths*: rays and depth stay as they are, and only the errors of cube and image count.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from datafactory.accuracy.knobs import KnobSettings
from datafactory.accuracy.power import Effort
from datafactory.accuracy.prices import Choice, Menu, Price, Prices, choose
from shared.radar import Radar

LEVELS_DB = tuple(float(level) for level in range(-15, -65, -5))
EVERYTHING, SAME_PATHS = "front", "front, same paths"
"""What the rows of the two are called."""
KNOBS = ("rays", "depth", "prune_db", "tolerance", "truth_terms")
"""What is chosen."""
FALLING = ("prune_db", "tolerance")
"""Knobs whose larger values are the cheaper ones."""


def menu_of(prices: Sequence[Price], effort: Effort) -> Menu | None:
    """What was measured as a menu, from cheap to dear; None where a knob was not measured."""
    values = {
        knob: tuple(sorted({price.value for price in prices if price.knob == knob}, reverse=knob in FALLING))
        for knob in KNOBS
    }
    if not all(values.values()):
        return None
    return Menu(
        rays=tuple(map(int, values["rays"])),
        depth=tuple(map(int, values["depth"])),
        prune_db=values["prune_db"],
        tolerance=values["tolerance"],
        truth_terms=tuple(map(int, values["truth_terms"])),
        effort=effort,
    )


def fronts(
    prices: Sequence[Price], default: KnobSettings, effort: Effort, radar: Radar
) -> Iterator[tuple[str, float, Choice]]:
    """Name, error and choice of every point, each choice once, errors falling.

    A front ends where nothing on the menu has the error. What was not measured with the default's rays has no front of
    the same paths.
    """
    menu = menu_of(prices, effort)
    if menu is None:
        return
    yield from _front(EVERYTHING, prices, menu, radar)
    if default.rays in menu.rays:
        depth = default.depth if default.depth in menu.depth else menu.depth[-1]
        without = [price.model_copy(update={"power": (0.0,) * len(price.power)}) for price in prices]
        yield from _front(SAME_PATHS, without, replace(menu, rays=(default.rays,), depth=(depth,)), radar)


def _front(name: str, prices: Sequence[Price], menu: Menu, radar: Radar) -> Iterator[tuple[str, float, Choice]]:
    chosen, before = Prices(frame_ids=(), prices=tuple(prices)), None
    for level_db in LEVELS_DB:
        choice = choose([chosen], menu, level_db, radar)
        if not choice.keeps_budget:
            return
        if choice.settings != before:
            yield name, level_db, choice
        before = choice.settings


def described(settings: KnobSettings) -> str:
    """The settings that a front chooses, in words."""
    return (
        f"{settings.rays} rays, depth {settings.depth}, prune {settings.prune_db:g} dB, "
        f"tolerance {settings.tolerance:g}, {settings.truth_terms} truth terms"
    )
