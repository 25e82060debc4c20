"""Byte for byte the run in one piece: jobs of an array, merged; traced now and rendered later."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from factory_command import but_made, frames_of, run, shards
from prepared_scenes import TINY

from datafactory.frame.draws import frame_seed
from shared.physics.errors import InputError


def test_rendered_traced_and_rendered_from_traces(radar_file: Path, tmp_path: Path) -> None:
    """The plan is the first job's work; the second finds it in the user's cache."""
    scene = (TINY, "--radar", radar_file, "--rays", 500, "--frames", 9, "--seed", 3, "--workers", 1)
    kinds = {
        "render": ("render", *scene, "--points", 3),
        "trace": ("trace", *scene, "--effects", "specular,diffuse"),
        "paths": ("render", "--paths", tmp_path / "trace-whole", "--radar", radar_file, "--workers", 1),
    }
    for name, arguments in kinds.items():
        run(*arguments, "--out", tmp_path / f"{name}-whole")
        for job in ("0/2", "1/2"):
            assert "datafactory merge" in run(*arguments, "--out", tmp_path / f"{name}-jobs", "--shard", job)
        run("merge", tmp_path / f"{name}-jobs", "--out", tmp_path / name)
        merged, whole = tmp_path / name, tmp_path / f"{name}-whole"
        assert shards(merged) == shards(whole)
        assert json.dumps(but_made(merged)) == json.dumps(but_made(whole))


def test_another_seed_draws_other_noise_of_the_same_paths(radar_file: Path, tmp_path: Path) -> None:
    run("trace", TINY, "--radar", radar_file, "--rays", 500, "--frames", 2, "--seed", 3, "--out", tmp_path / "traced")
    stored = ("render", "--paths", tmp_path / "traced", "--radar", radar_file)
    run(*stored, "--out", tmp_path / "its-own")
    run(*stored, "--seed", 4, "--out", tmp_path / "another")
    others = frames_of(tmp_path / "another")
    for number, (_, one) in frames_of(tmp_path / "its-own").items():
        _, other = others[number]
        assert (one.seed, other.seed) == (frame_seed(3, one.frame_id), frame_seed(4, one.frame_id))
        assert one.sensor_position == other.sensor_position
        assert not np.array_equal(one.range_channel, other.range_channel)
        strong = np.array_equal(one.velocity[0], other.velocity[0])  # rows in other Doppler cells show other echoes
        assert not strong or np.array_equal(one.image, other.image)


def test_camera_pictures_wait_for_the_merge(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--camera: beside --shard; expected datafactory inspect --camera"):
        run("render", TINY, "--out", tmp_path / "jobs", "--shard", "0/2", "--camera")
    assert not (tmp_path / "jobs").exists()


def test_a_dry_run_tells_of_the_job_alone(radar_file: Path, tmp_path: Path) -> None:
    arguments = ("render", TINY, "--radar", radar_file, "--frames", 18, "--points", 6, "--out", tmp_path, "--dry-run")
    assert run(*arguments).startswith("24 frames (train 18, validation 3, test 3) in 5 shards")
    assert run(*arguments, "--shard", "2/3").startswith("2 frames (train 2) in 1 shards")


MADE_OF = ("brick", "glass", "wood", "plasterboard", "marble")
"""What stands for the bricks of each scene, by its number; some let waves through."""


@pytest.fixture
def scenes(tmp_path: Path) -> list[Path]:
    """Five scenes: a file each, all of one shape."""
    text = TINY.read_text(encoding="utf-8")
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
    frames = frames_of(tmp_path / "once").values()
    assert len({frame.scene for _, frame in frames if frame.kind == "scene"}) == count
