"""Datasets written to object storage are those written to a disk, byte for byte, through kills and a store that fails.

Every run is a process of its own, with credentials in its environment; the store is moto's S3 server.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from s3_server import KEY, SECRET, Server, s3_server, set_credentials

SCENES = Path(__file__).parents[2] / "scenes"
RADAR = """
[waveform]
chirps = 8
samples = 128
range_bins = 100
bandwidth_hz = 400e6
[grid]
bins = 24
"""
POINTS = ("points", "--frames", 30, "--seed", 3, "--workers", 1)
"""Three full shards and three others."""


@pytest.fixture(scope="module")
def server():
    with s3_server() as running:
        yield running


@pytest.fixture(autouse=True)
def surroundings(server: Server, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    set_credentials(monkeypatch)
    (tmp_path / "tmp").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    yield
    server.mend()


@pytest.fixture(scope="module")
def radar_file(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("radar") / "small.toml"
    path.write_text(RADAR, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def reference(radar_file: Path, tmp_path_factory) -> dict[str, bytes]:
    """What the run leaves on a disk."""
    out = tmp_path_factory.mktemp("local") / "set"
    done = command(*POINTS, "--radar", radar_file, "--out", out)
    assert done.returncode == 0, done.stderr
    return but_made({path.relative_to(out).as_posix(): path.read_bytes() for path in out.rglob("*") if path.is_file()})


def started(*arguments: object) -> subprocess.Popen[str]:
    line = [sys.executable, "-m", *map(str, ("datafactory", *arguments))]
    return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def command(*arguments: object) -> subprocess.CompletedProcess[str]:
    """A command to its end; nothing it says shows the secret."""
    process = started(*arguments)
    out, err = process.communicate(timeout=300)
    assert SECRET not in out + err
    assert "Traceback" not in err
    return subprocess.CompletedProcess([], process.returncode, out, err)


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


@pytest.mark.parametrize("workers", [1, 2])
def test_the_objects_are_the_files_of_a_local_run(workers, server, radar_file, reference, tmp_path):
    name = f"whole{workers}"
    done = command(*POINTS, "--workers", workers, "--radar", radar_file, "--out", server.uri(name))
    assert done.returncode == 0, done.stderr
    assert but_made(stored(server, name)) == reference
    assert [path for path in (tmp_path / "tmp").rglob("*") if path.is_file()] == []
    require_no_secret(server, tmp_path)
    verified = command("inspect", server.uri(name), "--verify", "--frames", 0)
    assert verified.returncode == 0, verified.stderr
    assert "6 shards are as they were written" in verified.stdout


def test_a_folder_is_kept_as_a_local_one_is(server, radar_file, reference):
    out = server.uri("kept")
    assert command(*POINTS, "--radar", radar_file, "--out", out).returncode == 0
    again = command(*POINTS, "--radar", radar_file, "--out", out)
    assert (again.returncode, again.stderr.strip()) == (
        2,
        "datafactory: --out: s3://bucket/kept is not empty; expected an empty or new folder, or --resume",
    )
    assert "is already complete" in command(*POINTS, "--radar", radar_file, "--out", out, "--resume").stdout
    other = command(*POINTS[:-2], "--seed", 4, "--radar", radar_file, "--out", out, "--resume")
    assert other.returncode == 2
    assert "--resume: seed is 4, but the run in s3://bucket/kept had 3" in other.stderr
    assert but_made(stored(server, "kept")) == reference


def killed_after_two_shards(server: Server, name: str, radar_file: Path, workers: int) -> None:
    """A run that was killed, with all its workers, when it had noted two shards."""
    process = started(*POINTS, "--workers", workers, "--radar", radar_file, "--out", server.uri(name))
    while sum("part-" in key for key in server.keys(f"{name}/.progress/")) < 2:
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.communicate()


@pytest.mark.parametrize("workers", [1, 2])
def test_a_killed_run_ends_in_the_same_bytes(workers, server, radar_file, reference, tmp_path):
    name = f"killed{workers}"
    server.fail(method="PUT", path="test/part-00000", status=500)  # so that it cannot end before it is killed
    os.environ["AWS_MAX_ATTEMPTS"] = "11"
    killed_after_two_shards(server, name, radar_file, workers)
    server.mend()
    require_no_secret(server, tmp_path)
    assert "manifest.json" not in stored(server, name)
    finished = [key for key in server.keys(f"{name}/") if key.endswith(".parquet")]
    server.fail(method="GET", path=finished[0].removeprefix(f"{name}/"), status=500)  # it is not fetched to be checked
    resumed = command(*POINTS, "--workers", workers, "--radar", radar_file, "--out", server.uri(name), "--resume")
    assert resumed.returncode == 0, resumed.stderr
    assert "shards kept from before" in resumed.stdout
    server.mend()
    assert but_made(stored(server, name)) == reference
    assert [path for path in (tmp_path / "tmp").rglob("*") if path.is_file()] == []


def test_a_shard_that_changed_meanwhile_is_made_again(server, radar_file, reference):
    server.fail(method="PUT", path="test/part-00000", status=500)
    assert command(*POINTS, "--radar", radar_file, "--out", server.uri("changed")).returncode == 1
    server.mend()
    server.request("PUT", "/bucket/changed/train/part-00000.parquet", b"?" * len(reference["train/part-00000.parquet"]))
    resumed = command(*POINTS, "--radar", radar_file, "--out", server.uri("changed"), "--resume")
    assert resumed.returncode == 0, resumed.stderr
    assert "train/part-00000.parquet is not as it was recorded and is made again" in resumed.stdout
    assert but_made(stored(server, "changed")) == reference


@pytest.mark.parametrize(("status", "said"), [(500, "InternalError"), (403, "AccessDenied")])
@pytest.mark.parametrize("workers", [1, 2])
def test_a_store_that_fails_in_mid_run_is_one_line_and_resumed(workers, status, said, server, radar_file, reference):
    name = f"failed{status}{workers}"
    server.fail(method="PUT", path="train/part-00002", status=status)
    failed = command(*POINTS, "--workers", workers, "--radar", radar_file, "--out", server.uri(name))
    assert failed.returncode == 1
    (line,) = failed.stderr.strip().splitlines()
    assert line.startswith(f"datafactory: s3://bucket/{name}/train/part-00002.parquet: the store answers {said}")
    assert f"{name}/.progress/lock" not in server.keys(name)
    server.mend()
    resumed = command(*POINTS, "--workers", workers, "--radar", radar_file, "--out", server.uri(name), "--resume")
    assert resumed.returncode == 0, resumed.stderr
    assert but_made(stored(server, name)) == reference


def test_a_store_that_cannot_be_written_is_bad_input(server, radar_file):
    nowhere = command(*POINTS, "--radar", radar_file, "--out", server.uri("set", bucket="nowhere"))
    assert nowhere.returncode == 2
    assert "--out: s3://nowhere/set/.progress/lock: the store answers NoSuchBucket" in nowhere.stderr
    server.fail(method="", path="", status=403)
    denied = command(*POINTS, "--radar", radar_file, "--out", server.uri("denied"))
    server.mend()
    assert denied.returncode == 2
    assert "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY" in denied.stderr
    away = command(*POINTS, "--radar", radar_file, "--out", "s3://b/set?scheme=http&endpoint_override=127.0.0.1:9")
    assert away.returncode == 2
    assert "the store does not answer" in away.stderr
    assert server.keys("denied") == []


def test_traced_paths_lie_in_the_store_as_well(server, radar_file, tmp_path):
    asked = ("--radar", radar_file, "--frames", 2, "--workers", 1)
    traced = ("trace", SCENES / "tiny.usda", "--rays", 500, "--effects", "diffuse,noise", *asked)
    for paths, data in ((str(tmp_path / "paths"), str(tmp_path / "data")), (server.uri("paths"), server.uri("data"))):
        done = command(*traced, "--out", paths)
        assert done.returncode == 0, done.stderr
        done = command("render", "--paths", paths, *asked, "--out", data)
        assert done.returncode == 0, done.stderr
    for name in ("paths", "data"):
        local = tmp_path / name
        files = {path.relative_to(local).as_posix(): path.read_bytes() for path in local.rglob("*.*")}
        assert but_made(stored(server, name)) == but_made({key: value for key, value in files.items() if value})
    done = command("view", "--paths", server.uri("paths"), "--radar", radar_file, "--out", tmp_path / "page.html")
    assert done.returncode == 0, done.stderr
