"""An array of jobs ends in the bytes of one run: scenes with a plan of their own, traced paths, and what is made of
them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from factory_command import run
from prepared_scenes import SCENES
from small_radar import write_small_radar

from shared.dataset.folder import read_manifest
from shared.physics.errors import InputError

TINY = SCENES / "tiny.usda"


@pytest.fixture(scope="module")
def radar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_small_radar(tmp_path_factory.mktemp("radar"))


def contents(folder: Path) -> dict[str, Any]:
    """Bytes of the shards, and the manifest but for ``made``."""
    manifest = {name: value for name, value in read_manifest(folder).items() if name != "made"}
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.glob("*/*.parquet")} | {
        "manifest": json.dumps(manifest)
    }


def test_rendered_traced_and_rendered_from_traces(radar: Path, tmp_path: Path) -> None:
    """The plan is the first job's work; the second finds it in the user's cache."""
    scene = (TINY, "--radar", radar, "--rays", 500, "--frames", 9, "--seed", 3, "--workers", 1)
    kinds = {
        "render": ("render", *scene, "--points", 3),
        "trace": ("trace", *scene, "--effects", "specular,diffuse"),
        "paths": ("render", "--paths", tmp_path / "trace-whole", "--radar", radar, "--seed", 3, "--workers", 1),
    }
    for name, arguments in kinds.items():
        run(*arguments, "--out", tmp_path / f"{name}-whole")
        for job in ("0/2", "1/2"):
            assert "datafactory merge" in run(*arguments, "--out", tmp_path / f"{name}-jobs", "--shard", job)
        run("merge", tmp_path / f"{name}-jobs", "--out", tmp_path / name)
        assert contents(tmp_path / name) == contents(tmp_path / f"{name}-whole")


def test_camera_pictures_wait_for_the_merge(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--camera: beside --shard; expected datafactory inspect --camera"):
        run("render", TINY, "--out", tmp_path / "jobs", "--shard", "0/2", "--camera")
    assert not (tmp_path / "jobs").exists()


def test_a_dry_run_tells_of_the_job_alone(radar: Path, tmp_path: Path) -> None:
    arguments = ("render", TINY, "--radar", radar, "--frames", 18, "--points", 6, "--out", tmp_path, "--dry-run")
    assert run(*arguments).startswith("24 frames (train 18, validation 3, test 3) in 5 shards")
    assert run(*arguments, "--shard", "2/3").startswith("2 frames (train 2) in 1 shards")
