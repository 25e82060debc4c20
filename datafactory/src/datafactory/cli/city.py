"""``datafactory city``: a city in USD; procedural, or on a real road network with traffic."""

from __future__ import annotations

import math

import typer

from datafactory.api.options import CityOptions
from datafactory.cli.options import asking
from shared.physics.errors import InputError


@asking(CityOptions)
def city(asked: CityOptions) -> None:
    """Write a city: a procedural one for --populate, or one with traffic on the roads of a real network."""
    blocks, centre, extent = asked.blocks, asked.centre, asked.extent
    if asked.opendrive is not None and asked.osm is not None:
        raise InputError("city", "--opendrive and --osm are both given", "one of the two")
    source = asked.osm if asked.opendrive is None else asked.opendrive
    if source is None:
        if centre is not None or extent is not None:
            raise InputError(
                "city", "--centre and --extent without a network", "--opendrive FILE or --osm FILE beside them"
            )
        from datafactory.scenes.city.city import write_city

        write_city(asked.out, asked.seed, 2 if blocks is None else blocks, asked.style)
        typer.echo(
            f"wrote {asked.out}: nothing moves in it; --populate of the other commands puts traffic in its streets"
        )
        return
    if blocks is not None:
        raise InputError("city", "--blocks beside a network", "--extent, which says how much of it")
    from datafactory.scenes.network.town import write_town

    form, window = "osm" if asked.opendrive is None else "opendrive", {} if extent is None else {"extent": extent}
    middle = None if centre is None else _place(centre)
    moving = write_town(asked.out, source, form, asked.seed, asked.style, middle, **window)
    typer.echo(f"wrote {asked.out}: {moving} vehicles drive")


def _place(text: str) -> tuple[float, float]:
    """``"x,y"`` in metres."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError("city --centre", repr(text), "two numbers with a comma between them, x,y in metres")
    return x, y
