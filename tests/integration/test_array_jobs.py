"""An array of jobs ends in the bytes of one run: scenes with a plan of their own, traced paths, and what is made of
them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from factory_command import but_made, run, shards
from prepared_scenes import SCENES

from shared.physics.errors import InputError

TINY = SCENES / "tiny.usda"


def test_rendered_traced_and_rendered_from_traces(radar_file: Path, tmp_path: Path) -> None:
    """The plan is the first job's work; the second finds it in the user's cache."""
    scene = (TINY, "--radar", radar_file, "--rays", 500, "--frames", 9, "--seed", 3, "--workers", 1)
    kinds = {
        "render": ("render", *scene, "--points", 3),
        "trace": ("trace", *scene, "--effects", "specular,diffuse"),
        "paths": ("render", "--paths", tmp_path / "trace-whole", "--radar", radar_file, "--seed", 3, "--workers", 1),
    }
    for name, arguments in kinds.items():
        run(*arguments, "--out", tmp_path / f"{name}-whole")
        for job in ("0/2", "1/2"):
            assert "datafactory merge" in run(*arguments, "--out", tmp_path / f"{name}-jobs", "--shard", job)
        run("merge", tmp_path / f"{name}-jobs", "--out", tmp_path / name)
        merged, whole = tmp_path / name, tmp_path / f"{name}-whole"
        assert shards(merged) == shards(whole)
        assert json.dumps(but_made(merged)) == json.dumps(but_made(whole))


def test_camera_pictures_wait_for_the_merge(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--camera: beside --shard; expected datafactory inspect --camera"):
        run("render", TINY, "--out", tmp_path / "jobs", "--shard", "0/2", "--camera")
    assert not (tmp_path / "jobs").exists()


def test_a_dry_run_tells_of_the_job_alone(radar_file: Path, tmp_path: Path) -> None:
    arguments = ("render", TINY, "--radar", radar_file, "--frames", 18, "--points", 6, "--out", tmp_path, "--dry-run")
    assert run(*arguments).startswith("24 frames (train 18, validation 3, test 3) in 5 shards")
    assert run(*arguments, "--shard", "2/3").startswith("2 frames (train 2) in 1 shards")
