"""What stands on the blocks of a city, by their use: houses, gardens, works, depots, squares, parks."""

from __future__ import annotations

from collections.abc import Callable

from datafactory.scenes.city import dwellings, works
from datafactory.scenes.city.plan import Block
from datafactory.scenes.city.rules import Rules
from datafactory.scenes.city.site import Site

FILLERS: dict[str, Callable[[Site, Block, Rules], None]] = {
    "houses": dwellings.houses,
    "gardens": dwellings.gardens,
    "square": dwellings.square,
    "park": dwellings.park,
    "works": works.works,
    "depot": works.depot,
    "parking": works.parking,
    "verge": works.verge,
}


def fill(site: Site, block: Block, rules: Rules) -> None:
    """Build on one block."""
    FILLERS[block.use](site, block, rules)
