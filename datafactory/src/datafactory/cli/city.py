"""``datafactory city``: a procedural city with traffic, in USD."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from datafactory.scenes.city.style import MOST_BLOCKS, Style
from shared.processes.defaults import LARGEST_SEED


def city(
    out: Annotated[Path, typer.Option("--out", help="File to write: .usda or .usdc.", show_default=False)],
    seed: Annotated[int, typer.Option(min=0, max=LARGEST_SEED, help="Same seed, same bytes.")] = 0,
    blocks: Annotated[int, typer.Option(min=1, max=MOST_BLOCKS, help="House blocks along the street.")] = 2,
    style: Annotated[Style, typer.Option(help="What the city is like.")] = Style.OLD_TOWN,
) -> None:
    """Write a procedural city with traffic."""
    from datafactory.scenes.city.city import write_city

    write_city(out, seed, blocks, style)
    typer.echo(f"wrote {out}")
