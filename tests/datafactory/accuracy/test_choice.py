"""The choice among measured prices: the cheapest that keeps the budget, the front, and what is measured once."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from datafactory.accuracy.cache import cached, user_cache
from datafactory.accuracy.knobs import DEFAULT, KNOBS, POWER_KNOBS, QUICK, STUDY, Menu, menu_for
from datafactory.accuracy.prices import CUBE_S, Price, Prices, choose, front, trace_work, work


def price_list(menu: Menu, power: float = 1.0, power_floor: float = 0.0) -> Prices:
    """Errors that fall as the settings get dearer, as they are measured.

    :param power: factor of the errors of the power
    """
    entries = []
    for knob in KNOBS:
        for place, value in enumerate(getattr(menu, knob)):
            error = (0.1 * 0.2**place,)
            entries.append(
                Price(
                    knob=knob,
                    value=value,
                    cube=error if knob in ("tolerance", "prune_db") else (),
                    image=error if knob in ("truth_terms", "prune_db") else (),
                    power=(max(power * error[0], power_floor),) if knob in POWER_KNOBS else (),
                    bias=(1.0,),
                    paths={"prune_db": 90.0, "rays": 0.7 * value}.get(knob, 100.0),
                )
            )
    return Prices(prices=tuple(entries))


def test_the_front_buys_accuracy_with_work(radar) -> None:
    levels, choices = zip(*front(price_list(Menu()), Menu(), radar), strict=True)
    assert len(levels) > 3
    assert all(a > b for a, b in pairwise(levels))
    assert all(a.work < b.work for a, b in pairwise(choices))
    assert all(choice.predicted.worst_db <= level for level, choice in zip(levels, choices, strict=True))
    assert len({choice.settings for choice in choices}) == len(choices)


def test_the_cheapest_choice_that_keeps_the_budget(radar) -> None:
    menu, levels = Menu(), (-18.0, -25.0, -32.0, -40.0)
    prices = price_list(menu)
    found = [choose([prices], menu, level, radar) for level in levels]
    assert [choice.work for choice in found] == sorted(choice.work for choice in found)
    assert found[0].work < found[-1].work
    for level, choice in zip(levels, found, strict=True):
        assert choice.keeps_budget
        assert choice.predicted.worst_db <= level
    hopeless = choose([prices], menu, -119.0, radar)
    assert not hopeless.keeps_budget
    assert hopeless.settings.depth == menu.depth[-1]
    # What cannot be kept is as good as the menu has it, and the rest is kept and no better.
    rest = choose([price_list(menu, power_floor=0.3)], menu, -32.0, radar)
    assert not rest.keeps_budget
    kept = [level for name, level in rest.predicted.measured().items() if name != "power_db"]
    assert rest.predicted.power_db > -32.0 >= max(kept)
    assert len(kept) == 2
    assert rest.settings.tolerance > menu.tolerance[-1]
    # Two scenes: the choice answers for the worse one.
    both = choose([prices, price_list(menu, power=3.0)], menu, -25.0, radar)
    assert both.settings.rays > found[1].settings.rays
    # Of paths alone only how they are traced is chosen, by what the trace takes.
    paths = choose([price_list(menu.of_paths())], menu.of_paths(), -25.0, radar)
    assert set(paths.predicted.measured()) == {"power_db"}
    assert paths.settings == replace(DEFAULT, rays=paths.settings.rays, depth=paths.settings.depth)
    assert paths.work == trace_work(paths.settings)


def test_work_rises_with_all_that_is_bought(radar) -> None:
    for menu in (Menu(), STUDY, QUICK):
        assert set(menu.tolerance) <= set(CUBE_S)
        for knob in ("rays", "depth", "tolerance", "truth_terms"):
            found = [work(DEFAULT.at(knob, value), 1e5, radar) for value in getattr(menu, knob)]
            assert all(a < b for a, b in pairwise(found))
    assert work(DEFAULT, 1e4, radar) < work(DEFAULT, 1e5, radar)
    # Few rays are not for nothing: every pass has its price, and a single bounce has one pass of three.
    few = replace(DEFAULT, rays=1)
    assert abs(trace_work(few) / trace_work(replace(few, depth=1)) - 3.0) < 1e-3


def test_given_rays_and_depth_stay() -> None:
    menu = menu_for(3_000_000, 1)
    assert (menu.rays, menu.depth) == ((3_000_000,), (1,))
    assert menu.effort.reference_rays > 3_000_000
    assert menu.of_paths().rays == menu.rays
    assert menu.of_paths().paths_only
    assert not menu.paths_only


PRICES = Prices(prices=(Price(knob="rays", value=1.0, power=(0.1,), bias=(1.0,), paths=7.0),))


def test_a_damaged_cache_is_measured_again(tmp_path: Path) -> None:
    said: list[str] = []
    paths: list[Path] = []

    def measure(path: Path) -> Prices:
        paths.append(path)
        return PRICES

    for _ in range(2):
        assert cached(tmp_path, {"scene": "a"}, Prices, measure, said.append) == PRICES
    assert len(paths) == 1
    paths[0].write_text("{")
    assert cached(tmp_path, {"scene": "a"}, Prices, measure, said.append) == PRICES
    assert len(paths) == 2
    assert len(said) == 1
    cached(tmp_path, {"scene": "b"}, Prices, measure, said.append)
    assert paths[2] != paths[0]


def test_the_cache_follows_the_user(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert user_cache().is_relative_to(tmp_path)
