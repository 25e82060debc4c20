"""``datafactory city``: a city with traffic, in USD; procedural, or on a real road network."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from datafactory.scenes.city.style import MOST_BLOCKS, Style
from shared.physics.errors import InputError
from shared.processes.defaults import LARGEST_SEED


def city(
    out: Annotated[Path, typer.Option("--out", help="File to write: .usda or .usdc.", show_default=False)],
    seed: Annotated[int, typer.Option(min=0, max=LARGEST_SEED, help="Same seed, same bytes.")] = 0,
    blocks: Annotated[
        int | None,
        typer.Option(min=1, max=MOST_BLOCKS, help="House blocks along the street; 2 without.", show_default=False),
    ] = None,
    style: Annotated[Style, typer.Option(help="What the city is like.")] = Style.OLD_TOWN,
    traffic: Annotated[
        bool, typer.Option(help="With what moves; without, the streets are free for --populate.")
    ] = True,
    opendrive: Annotated[
        Path | None, typer.Option(help="Roads, lanes and traffic from an OpenDRIVE file (.xodr).", show_default=False)
    ] = None,
    osm: Annotated[
        Path | None, typer.Option(help="The same from an OpenStreetMap extract (.osm).", show_default=False)
    ] = None,
    centre: Annotated[
        str | None,
        typer.Option(help="x,y of the window's middle in the network [m]; its own without.", show_default=False),
    ] = None,
    extent: Annotated[
        float | None, typer.Option(help="Side of the window [m]; 300 without.", show_default=False)
    ] = None,
) -> None:
    """Write a city with traffic: a procedural one, or one on the roads of a real network."""
    if opendrive is not None and osm is not None:
        raise InputError("city", "--opendrive and --osm are both given", "one of the two")
    source = opendrive if opendrive is not None else osm
    if source is None:
        if centre is not None or extent is not None:
            raise InputError(
                "city", "--centre and --extent without a network", "--opendrive FILE or --osm FILE beside them"
            )
        from datafactory.scenes.city.city import write_city

        write_city(out, seed, 2 if blocks is None else blocks, style, traffic)
        typer.echo(f"wrote {out}")
        return
    if not traffic:
        raise InputError(
            "city", "--no-traffic beside a network", "--no-traffic of a procedural city, or the network's traffic"
        )
    if blocks is not None:
        raise InputError("city", "--blocks beside a network", "--extent, which says how much of it")
    from datafactory.scenes.network.town import write_town

    form, window = "opendrive" if opendrive is not None else "osm", {} if extent is None else {"extent": extent}
    moving = write_town(out, source, form, seed, style, None if centre is None else _place(centre), **window)
    typer.echo(f"wrote {out}: {moving} vehicles drive")


def _place(text: str) -> tuple[float, float]:
    """``"x,y"`` in metres."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError("city --centre", repr(text), "two numbers with a comma between them, x,y in metres")
    return x, y
