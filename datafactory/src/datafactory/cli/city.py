"""``datafactory city``: a procedural city with traffic, in USD."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from shared.processes.defaults import LARGEST_SEED


def city(
    out: Annotated[Path, typer.Option("--out", help="File to write: .usda or .usdc.", show_default=False)],
    seed: Annotated[int, typer.Option(min=0, max=LARGEST_SEED, help="Same seed, same bytes.")] = 0,
    blocks: Annotated[int, typer.Option(min=1, max=20, help="House blocks along the street.")] = 2,
) -> None:
    """Write a procedural city with traffic."""
    from datafactory.scenes.city.city import write_city

    write_city(out, seed, blocks)
    typer.echo(f"wrote {out}")
