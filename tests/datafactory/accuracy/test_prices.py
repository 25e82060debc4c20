"""The choice among measured prices: the cheapest that keeps the budget, and the front that these make."""

from __future__ import annotations

from datafactory.accuracy.front import EVERYTHING, SAME_PATHS, fronts
from datafactory.accuracy.knobs import DEFAULT
from datafactory.accuracy.power import Effort
from datafactory.accuracy.prices import Menu, Price, Prices, choose


def price_list(menu: Menu) -> Prices:
    """Errors that fall as the settings get dearer, as a sweep would find them."""
    entries = []
    for knob in ("tolerance", "prune_db", "truth_terms", "rays", "depth"):
        for place, value in enumerate(getattr(menu, knob)):
            error = 0.1 * 0.2**place
            entries.append(
                Price(
                    knob=knob,
                    value=value,
                    cube=(error if knob in ("tolerance", "prune_db") else 0.0,),
                    image=(error if knob in ("truth_terms", "prune_db") else 0.0,),
                    power=(error if knob in ("rays", "depth") else 0.0,),
                    paths=0.9 if knob == "prune_db" else float(value) * 1000.0,
                    fixed_work=1e8 * (place + 1),
                    path_work=1e4 * (place + 1),
                )
            )
    return Prices(frame_ids=(0,), prices=tuple(entries))


def test_the_front_buys_accuracy_with_work(radar):
    prices = price_list(Menu()).prices
    found = list(fronts(prices, DEFAULT, Effort(1000), radar))
    for name in (EVERYTHING, SAME_PATHS):
        levels, choices = zip(*((level, choice) for label, level, choice in found if label == name), strict=True)
        assert list(levels) == sorted(levels, reverse=True)
        assert [choice.work for choice in choices] == sorted(choice.work for choice in choices)
        assert all(choice.predicted.worst_db <= level for level, choice in zip(levels, choices, strict=True))
        assert len({choice.settings for choice in choices}) == len(choices)
    assert {choice.settings.rays for label, _, choice in found if label == SAME_PATHS} == {DEFAULT.rays}
    assert not list(fronts([price for price in prices if price.knob != "depth"], DEFAULT, Effort(1000), radar))


def test_the_cheapest_choice_that_keeps_the_budget(radar):
    menu = Menu()
    found = [choose([price_list(menu)], menu, level, radar) for level in (-18.0, -25.0, -32.0, -40.0)]
    work = [choice.work for choice in found]
    assert work == sorted(work)
    assert work[0] < work[-1]
    for level, choice in zip((-18.0, -25.0, -32.0, -40.0), found, strict=True):
        assert choice.keeps_budget
        assert choice.predicted.worst_db <= level
    hopeless = choose([price_list(menu)], menu, -119.0, radar)
    assert not hopeless.keeps_budget
    assert hopeless.settings.depth == menu.depth[-1]
    # What cannot be kept is as good as the menu has it, and the rest is kept and no better.
    beyond = price_list(menu).model_copy(
        update={"prices": tuple(p.model_copy(update={"power": (0.3,)}) for p in price_list(menu).prices)}
    )
    rest = choose([beyond], menu, -32.0, radar)
    assert not rest.keeps_budget
    kept = [level for name, level in rest.predicted.measured().items() if name != "power_db"]
    assert rest.predicted.power_db > -32.0 >= max(kept)
    assert len(kept) == 2
    assert rest.settings.tolerance > menu.tolerance[-1]
    # Two scenes: the choice answers for the worse one.
    worse = price_list(menu).model_copy(
        update={
            "prices": tuple(
                p.model_copy(update={"power": tuple(3 * e for e in p.power)}) for p in price_list(menu).prices
            )
        }
    )
    assert choose([price_list(menu), worse], menu, -25.0, radar).settings.rays >= found[1].settings.rays
