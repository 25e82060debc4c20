"""``datafactory scenes``: the scenes that can be named."""

from __future__ import annotations

from datafactory.cli.tables import plain_console, table

TABLE_WIDTH = 120


def scenes() -> None:
    """List the scenes that this package and Sionna ship, by the names that --scene takes."""
    from datafactory.inspection.named_scenes import named_scenes

    rows = [(item.name, item.kind, f"{item.bytes / 1e3:.0f}", item.about) for item in named_scenes()]
    plain_console(narrowest=TABLE_WIDTH).print(table("scenes", ("--scene", "format", "[kB]", "what it is"), rows))
