"""``datafactory`` run in this process by tests, and the bytes of what it wrote."""

from pathlib import Path
from typing import Any

import command_line
from typer.testing import CliRunner

from datafactory.cli.app import app
from shared.dataset import Frame
from shared.dataset.folder import open_dataset, read_manifest


def run(*arguments: object) -> str:
    """What the command prints; its errors propagate as they would into ``datafactory.cli.app.main``."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def refused(*arguments: object) -> str:
    return command_line.refused("datafactory", *arguments)


def frames_of(folder: Path) -> dict[int, tuple[str, Frame]]:
    """The frames of a dataset and their splits, split by split."""
    dataset = open_dataset(folder)
    return {frame.frame_id: (split, frame) for split in dataset.splits for frame in dataset.frames(split)}


def but_made(folder: Path) -> dict[str, Any]:
    """The manifest but for what may differ between two equal runs."""
    return {name: value for name, value in read_manifest(folder).items() if name != "made"}


def shards(folder: Path) -> dict[str, bytes]:
    """Bytes of every shard of a dataset by its name."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.glob("*/*.parquet"))}
