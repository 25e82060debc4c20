"""A procedural city as USD: plan, ground, blocks, roadside, in this order, from one generator. Nothing in it moves.

The same options give the same file on every machine: all draws come from one NumPy generator, all coordinates are
rounded to the millimetre before they are written, and nothing depends on a library's last digit.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from datafactory.scenes.city import dwellings, furniture, motorway, paving, roadside, vehicles, works
from datafactory.scenes.city.plan import Block, draw_plan
from datafactory.scenes.city.rules import MOST_BLOCKS, RULES, Rules, Style
from datafactory.scenes.city.shapes import Surface
from datafactory.scenes.city.site import Placement, Site
from datafactory.scenes.city.usd import check_output, write_usd
from shared.physics.errors import InputError
from shared.processes.defaults import LARGEST_SEED

VERSION = 3
"""Of the generator: the same options, version and kind of file give the same bytes."""


class CityOptions(BaseModel):
    """The options of a procedural city.

    :param seed: of the NumPy generator that all choices are drawn from
    :param style: which kinds of streets and buildings
    :param blocks: house blocks along the main street, with a cross street between neighbours
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    seed: Annotated[int, Field(ge=0, le=LARGEST_SEED)] = 0
    style: Style = Style.OLD_TOWN
    blocks: Annotated[int, Field(ge=1, le=MOST_BLOCKS)] = 2

    @staticmethod
    def checked(**values: Any) -> CityOptions:
        """The options, if they are valid.

        :raises InputError: the first that is not, with its value and what would be right
        """
        try:
            return CityOptions(**values)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            name = str(first["loc"][0])
            right = first["msg"][0].lower() + first["msg"][1:]
            raise InputError(f"city {name}", f"{name} = {first['input']!r}", right) from None

    def metadata(self) -> dict[str, Any]:
        """For the file's metadata."""
        return {"style": self.style.value, "seed": self.seed, "blocks": self.blocks, "version": VERSION}


FILLERS: dict[str, Callable[[Site, Block, Rules], None]] = {
    "houses": dwellings.houses, "gardens": dwellings.gardens, "square": dwellings.square, "park": dwellings.park,
    "works": works.works, "depot": works.depot, "parking": works.parking, "verge": works.verge,
}  # fmt: skip
"""What builds on a block, by its use."""


def models(rng: np.random.Generator, rules: Rules, gantry_m: float = 10.0) -> dict[str, Surface]:
    """The shapes that a city's things share, by name; of trees there are several, drawn.

    :param gantry_m: from the middle of the main street to the posts of a gantry
    """
    shared = {name: vehicles.car(shape) for name, shape in vehicles.CAR_SHAPES.items()}
    shared |= {"Lorry": vehicles.lorry(), "Bus": vehicles.bus()}
    shared |= {f"Tree_{i}": furniture.street_tree(rng, rng.uniform(1.0, 1.4)) for i in range(3)}
    shared |= {f"Conifer_{i}": furniture.conifer(rng) for i in range(2)}
    shared |= {f"Sign_{kind}": furniture.sign(kind) for kind in ("round", "triangle", "panel")}
    shared |= {"Lamp": furniture.lamp_post(rules.lamp_height_m), "Signal": furniture.traffic_light()}
    shared |= {"Bollard": furniture.bollard(), "Bin": furniture.litter_bin(), "Bench": furniture.bench()}
    shared |= {"Shelter": furniture.bus_shelter(), "Manhole": furniture.manhole_cover()}
    shared |= {"PedestrianRail": furniture.pedestrian_rail(3.0), "Fence": furniture.fence(works.FENCE_M)}
    shared |= {"Container": furniture.container(), "Barrier": furniture.barrier(motorway.PIECE_M)}
    shared |= {"GuardRail": furniture.guard_rail(motorway.PIECE_M, 4.0)}
    shared |= {"Gantry": furniture.gantry(gantry_m)}
    height = round(rng.uniform(3.0, 5.0), 1)
    shared |= {f"NoiseWall_{i}": furniture.noise_wall(4.0, height, key) for i, key in enumerate(("concrete", "wood"))}
    return shared


def city(options: CityOptions) -> tuple[Placement, ...]:
    """Everything in a city, ground first."""
    rng, rules = np.random.default_rng(options.seed), RULES[options.style]
    plan = draw_plan(rng, rules, options.blocks)
    site = Site(rng, models(rng, rules, plan.main.kind.kerb + 1.4))
    islands = [island for block in plan.blocks if block.use == "parking" for island in works.islands(block)]
    site.placements += paving.ground(plan, rules.kerb_m, islands)
    if rules.bridges:
        motorway.equip(site, plan)
    for block in plan.blocks:
        FILLERS[block.use](site, block, rules)
    roadside.furnish(site, plan, rules)
    return tuple(site.placements)


def write_city(path: Path, seed: int = 0, blocks: int = 2, style: Style = Style.OLD_TOWN) -> None:
    """Write a procedural city as USD: metres, z up; the same options give the same bytes.

    :param path: ``.usda``, ``.usdc`` or ``.usd``
    :param seed: 0 or more
    :param blocks: house blocks along the main street, at least 1, with a cross street between neighbours
    :param style: what the city is like
    :raises InputError: a bad argument, or a place that cannot be written
    """
    path = check_output(path)
    options = CityOptions.checked(seed=seed, blocks=blocks, style=style)
    name = f"Procedural city: {options.style.value}, seed {seed}, blocks {blocks}. Metres, z up."
    write_usd(path, city(options), name, options.metadata())
