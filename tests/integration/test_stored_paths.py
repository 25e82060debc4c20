"""Traced now and rendered later is rendered at once, byte for byte: for any number of scenes, poses, splits, points.

What a frame leaves out when it is rendered at once was never traced; later it is left out of what was. No two scenes of
a run are alike, so that a frame that got another's would show.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from factory_command import run, shards
from prepared_scenes import SCENES

from shared.dataset.folder import open_dataset

MADE_OF = ("brick", "glass", "wood", "plasterboard", "marble")
"""What stands for the bricks of each scene, by its number; some let waves through."""


@pytest.fixture
def scenes(tmp_path: Path) -> list[Path]:
    """Five scenes: a file each, all of one shape."""
    text = (SCENES / "tiny.usda").read_text(encoding="utf-8")
    paths = [tmp_path / f"scene{number}.usda" for number in range(len(MADE_OF))]
    for path, material in zip(paths, MADE_OF, strict=True):
        path.write_text(text.replace("brick", material), encoding="utf-8")
    return paths


@pytest.mark.parametrize(
    ("count", "more"),
    [
        (2, ("--frames", 10, "--seed", 3)),  # the turn begins one scene later from frame 8 on
        (5, ("--frames", 6, "--split", "2:1:1")),
        pytest.param(3, ("--poses",), marks=pytest.mark.slow),
    ],
)
def test_traced_now_and_rendered_later_is_rendered_at_once(
    count: int, more: tuple[object, ...], scenes: list[Path], radar_file: Path, tmp_path: Path
) -> None:
    if more == ("--poses",):
        poses = [{"position": [-10.0 + 0.5 * number, 0.2 * number, 0.5]} for number in range(7)]
        (tmp_path / "poses.json").write_text(json.dumps(poses), encoding="utf-8")
        more = ("--poses", tmp_path / "poses.json")
    given = [item for path in scenes[:count] for item in ("--scene", path)]
    common = ("--radar", radar_file, "--rays", 500, *more, "--workers", 1)
    run("render", *given, *common, "--points", 2, "--out", tmp_path / "once")
    run("trace", *given, *common, "--out", tmp_path / "traced")
    run("render", "--paths", tmp_path / "traced", "--radar", radar_file, *more[2:], "--points", 2, "--workers", 1,
        "--out", tmp_path / "later")  # fmt: skip
    once = shards(tmp_path / "once")
    assert shards(tmp_path / "later") == once
    frames = [frame for split in open_dataset(tmp_path / "once").splits for frame in
              open_dataset(tmp_path / "once").frames(split)]  # fmt: skip
    assert len({frame.scene for frame in frames if frame.kind == "scene"}) == count
