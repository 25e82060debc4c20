"""An array of jobs ends in the bytes of one run: scenes with a plan of their own, traced paths, and what is made of
them; through a job that is killed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from factory_command import run
from prepared_scenes import SCENES
from small_radar import write_small_radar

import datafactory
from datafactory.frame.deal import split_of
from datafactory.run import portions
from datafactory.run.merging import ranges
from datafactory.run.shards import plan_shards
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


def test_a_job_that_is_killed_owes_its_frames_until_it_is_resumed(
    radar: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In Python; every job asks to resume, as a batch script that may be queued again does."""

    def make(shard: str | None, out: Path) -> datafactory.Report:
        return datafactory.render(None, out, radar=radar, frames=0, points=40, resume=True, shard=shard)

    make(None, tmp_path / "whole")
    jobs, record, recorded = tmp_path / "jobs", portions.record_finished, list[str]()

    def killed_at_its_second(directory: Path, plan: Any, finished: Any) -> None:
        if directory.name == "job-1-of-2" and len(recorded) == 1:
            raise KeyboardInterrupt
        recorded.append(plan.path)
        record(directory, plan, finished)

    monkeypatch.setattr(portions, "record_finished", killed_at_its_second)
    with pytest.raises(KeyboardInterrupt):
        make("1/2", jobs)
    monkeypatch.undo()
    make("0/2", jobs)
    plans = plan_shards([split_of(frame_id) for frame_id in range(40)])
    owed = sorted(frame_id for plan in plans[1::2] for frame_id in plan.frame_ids)
    with pytest.raises(InputError) as caught:
        datafactory.merge(jobs, tmp_path / "merged")
    assert f"frames {ranges(owed)} are missing" in str(caught.value)
    assert f"{jobs / 'job-1-of-2'} is not finished" in str(caught.value)
    assert not (tmp_path / "merged").exists()
    assert make("1/2", jobs).shards_kept == 1
    assert datafactory.merge(jobs, tmp_path / "merged").frames == 40
    assert contents(tmp_path / "merged") == contents(tmp_path / "whole")


def test_camera_pictures_wait_for_the_merge(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--camera: beside --shard; expected datafactory inspect --camera"):
        run("render", TINY, "--out", tmp_path / "jobs", "--shard", "0/2", "--camera")
    assert not (tmp_path / "jobs").exists()


def test_a_dry_run_tells_of_the_job_alone(radar: Path, tmp_path: Path) -> None:
    arguments = ("render", TINY, "--radar", radar, "--frames", 18, "--points", 6, "--out", tmp_path, "--dry-run")
    assert run(*arguments).startswith("24 frames (train 18, validation 3, test 3) in 5 shards")
    assert run(*arguments, "--shard", "2/3").startswith("2 frames (train 2) in 1 shards")
