"""``datafactory`` run in this process by tests, and the bytes of what it wrote."""

from __future__ import annotations

from pathlib import Path

from typer.testing import CliRunner

from datafactory.cli.app import app


def run(*arguments: object) -> str:
    """What the command prints; its errors propagate as they would into ``datafactory.cli.app.main``."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def shards(folder: Path) -> dict[str, bytes]:
    """Bytes of every shard of a dataset by its name."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.glob("*/*.parquet"))}
