"""Datasets written to object storage are those written to a disk, byte for byte, through kills and a store that fails.

The store is moto's S3 server; the credentials stand in the environment.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest
from factory_command import ended
from s3_server import KEY, SECRET, Server

SCENES = Path(__file__).parents[2] / "scenes"
POINTS = ("points", "--frames", 30, "--seed", 3, "--workers", 1)
"""Five shards."""


@pytest.fixture(autouse=True)
def surroundings(server: Server, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    (tmp_path / "tmp").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    monkeypatch.setattr("tempfile.tempdir", None)  # read anew


@pytest.fixture(scope="module")
def reference(radar_file: Path, tmp_path_factory) -> dict[str, bytes]:
    """What the run leaves on a disk."""
    out = tmp_path_factory.mktemp("local") / "set"
    done = command(*POINTS, "--radar", radar_file, "--out", out)
    assert done.status == 0, done.err
    return but_made({path.relative_to(out).as_posix(): path.read_bytes() for path in out.rglob("*") if path.is_file()})


@dataclass(frozen=True)
class Ended:
    status: int
    out: str
    err: str


def command(*arguments: object) -> Ended:
    """A command as the shell runs it, in this process; nothing it says shows the secret."""
    done = Ended(*ended(*arguments))
    assert SECRET not in done.out + done.err
    return done


def but_made(files: dict[str, bytes]) -> dict[str, bytes]:
    manifest = json.loads(files["manifest.json"])
    del manifest["made"]
    return {**files, "manifest.json": json.dumps(manifest).encode()}


def stored(server: Server, name: str) -> dict[str, bytes]:
    return {key.removeprefix(f"{name}/"): content for key, content in server.objects(f"{name}/").items()}


def require_no_secret(server: Server, tmp_path: Path) -> None:
    """Neither in an object nor in a file that was left here, nor half of it there."""
    contents = [*server.objects().values(), *(path.read_bytes() for path in tmp_path.rglob("*") if path.is_file())]
    assert not any(word.encode() in content for content in contents for word in (SECRET, KEY))


@pytest.mark.parametrize(
    ("name", "how"),
    [
        ("one", ("--workers", 1)),
        ("two", ("--workers", 2)),
        # Only the command writes: the nodes need not reach the store.
        pytest.param("cluster", ("--workers", 2, "--engine", "ray"), marks=pytest.mark.slow),
    ],
)
def test_the_objects_are_the_files_of_a_local_run(name, how, server, radar_file, reference, tmp_path):
    done = command(*POINTS, *how, "--radar", radar_file, "--out", server.uri(name))
    assert done.status == 0, done.err
    assert but_made(stored(server, name)) == reference
    assert [path for path in (tmp_path / "tmp").rglob("*") if path.is_file()] == []
    require_no_secret(server, tmp_path)
    verified = command("inspect", server.uri(name), "--verify", "--frames", 0)
    assert verified.status == 0, verified.err
    assert "5 shards are as they were written" in verified.out


def test_a_folder_is_kept_as_a_local_one_is(server, radar_file, reference):
    out = server.uri("kept")
    assert command(*POINTS, "--radar", radar_file, "--out", out).status == 0
    again = command(*POINTS, "--radar", radar_file, "--out", out)
    assert (again.status, again.err.strip()) == (
        2,
        "datafactory: --out: s3://bucket/kept is not empty; expected an empty or new folder, or --resume",
    )
    assert "is already complete" in command(*POINTS, "--radar", radar_file, "--out", out, "--resume").out
    other = command(*POINTS[:-2], "--seed", 4, "--radar", radar_file, "--out", out, "--resume")
    assert other.status == 2
    assert "--resume: seed is 4, but the run in s3://bucket/kept had 3" in other.err
    assert but_made(stored(server, "kept")) == reference


def test_a_killed_run_ends_in_the_same_bytes(server, radar_file, reference, tmp_path, monkeypatch):
    server.fail(method="PUT", path="test/part-00000", status=500)  # so that it cannot end before it is killed
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "11")
    asked = (*POINTS, "--workers", 2, "--radar", radar_file, "--out", server.uri("killed"))
    with subprocess.Popen([sys.executable, "-m", "datafactory", *map(str, asked)]) as process:
        while sum("part-" in key for key in server.keys("killed/.progress/")) < 2:
            assert process.poll() is None
            time.sleep(0.02)
        process.send_signal(signal.SIGKILL)
    server.mend()
    require_no_secret(server, tmp_path)
    assert "manifest.json" not in stored(server, "killed")
    noted = server.keys("killed/.progress/train-")[0].removesuffix(".json").rpartition("/")[2]
    server.fail(method="GET", path=noted.replace("-", "/", 1), status=500)  # it is not fetched to be checked
    resumed = command(*POINTS, "--radar", radar_file, "--out", server.uri("killed"), "--resume")
    server.mend()
    assert resumed.status == 0, resumed.err
    assert "shards kept from before" in resumed.out
    assert but_made(stored(server, "killed")) == reference
    assert [path for path in (tmp_path / "tmp").rglob("*") if path.is_file()] == []


@pytest.mark.parametrize(("workers", "status", "said"), [(1, 500, "InternalError"), (2, 403, "AccessDenied")])
def test_a_store_that_fails_in_mid_run_is_one_line_and_resumed(workers, status, said, server, radar_file, reference):
    """With one worker a shard has changed meanwhile, and is made again."""
    name = f"failed{status}"
    server.fail(method="PUT", path="train/part-00002", status=status)
    failed = command(*POINTS, "--workers", workers, "--radar", radar_file, "--out", server.uri(name))
    assert failed.status == 1
    (line,) = failed.err.strip().splitlines()
    assert line.startswith(f"datafactory: s3://bucket/{name}/train/part-00002.parquet: the store answers {said}")
    assert f"{name}/.progress/lock" not in server.keys(name)
    server.mend()
    first = "train/part-00000.parquet"
    if workers == 1:
        server.request("PUT", f"/bucket/{name}/{first}", b"?" * len(reference[first]))
    resumed = command(*POINTS, "--radar", radar_file, "--out", server.uri(name), "--resume")
    assert resumed.status == 0, resumed.err
    assert (f"{first} is not as it was recorded and is made again" in resumed.out) == (workers == 1)
    assert but_made(stored(server, name)) == reference


def test_traced_paths_lie_in_the_store_as_well(server, radar_file, tmp_path):
    asked = ("--radar", radar_file, "--workers", 1)
    traced = ("trace", SCENES / "tiny.usda", "--frames", 2, "--rays", 500, "--effects", "diffuse,noise", *asked)
    for paths, data in ((str(tmp_path / "paths"), str(tmp_path / "data")), (server.uri("paths"), server.uri("data"))):
        done = command(*traced, "--out", paths)
        assert done.status == 0, done.err
        done = command("render", "--paths", paths, *asked, "--out", data)
        assert done.status == 0, done.err
    for name in ("paths", "data"):
        local = tmp_path / name
        files = {path.relative_to(local).as_posix(): path.read_bytes() for path in local.rglob("*.*")}
        assert but_made(stored(server, name)) == but_made({key: value for key, value in files.items() if value})
    done = command("view", "--paths", server.uri("paths"), "--radar", radar_file, "--out", tmp_path / "page.html")
    assert done.status == 0, done.err
