"""Runs elsewhere, on object storage or by Ray, are those on this disk, byte for byte, through kills and failures."""

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import pytest
import ray_work
from command_line import ended
from factory_command import shards
from prepared_scenes import TINY
from processes import wait_for
from ray_cluster import add_node, kill_node, ray_cluster
from s3_server import KEY, SECRET, Server

from datafactory import RunFailed, render
from datafactory.run import pipeline, preparation
from shared.physics.errors import InputError

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
    done = Ended(*ended("datafactory", *arguments))
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
        ("cluster", ("--workers", 2, "--engine", "ray")),
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
        wait_for(lambda: sum("part-" in key for key in server.keys("killed/.progress/")) >= 2, process=process)
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
    traced = ("trace", TINY, "--frames", 2, "--rays", 500, "--effects", "diffuse,noise", *asked)
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


FRAMES = 40
DEADLY = "test/part-00000.parquet"
"""Has the frame that :class:`ray_work.DeadlyJob` dies of."""
ENDS_S = 60.0
"""Within this what was killed has ended."""

WAITING = r"no node of the cluster has a core and 0\.\d GB of memory for tasks: waiting"


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    with ray_cluster(2) as found:
        yield found


def made(out: Path, radar_file: Path, **more: Any) -> pipeline.Report:
    """40 frames of close targets in seven shards."""
    return render(None, out, radar=radar_file, frames=0, points=FRAMES, split="2:1:1", **more)


@pytest.fixture(scope="module")
def on_disk(tmp_path_factory: pytest.TempPathFactory, radar_file: Path) -> dict[str, bytes]:
    out = tmp_path_factory.mktemp("on_disk") / "data"
    made(out, radar_file)
    return shards(out)


def tasks() -> list[psutil.Process]:
    """Processes of this machine that make frames for a cluster."""
    found = []
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            if "make_portion" in " ".join(process.cmdline()):
                found.append(process)
    return found


def test_all_nodes_are_lost_and_replaced(
    cluster: Any, radar_file: Path, on_disk: dict[str, bytes], tmp_path: Path
) -> None:
    done_frames, lines = list[int](), list[str]()

    def progress(stage: str, done: int, total: int) -> None:
        assert (stage, total) == ("frames", FRAMES)
        done_frames.append(done)
        if done > 0 and not killed:
            for node in list(cluster.worker_nodes):
                killed.append(node)
                kill_node(cluster, node)

    def announce(line: str) -> None:
        lines.append(line)
        if "waiting" in line:
            add_node(cluster)
            add_node(cluster)

    killed = list[Any]()
    out = tmp_path / "data"
    report = made(out, radar_file, engine="ray", address=cluster.address, announce=announce, progress=progress)
    assert len(killed) == 2
    assert lines[0] == "Ray: 2 nodes to work on"
    assert [line for line in lines[1:] if not re.fullmatch(WAITING, line)] == []
    assert len(lines) == 2
    assert shards(out) == on_disk
    assert (report.shards_made, report.shards_kept) == (len(on_disk), 0)
    assert done_frames[-1] == FRAMES


def test_a_deadly_portion_is_named_and_the_rest_unharmed(
    cluster: Any,
    radar_file: Path,
    on_disk: dict[str, bytes],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Begun on Ray, finished on this machine."""
    out, lines = tmp_path / "data", list[str]()
    with monkeypatch.context() as patch:
        patch.setattr(preparation, "Job", ray_work.DeadlyJob)
        died = rf"^{DEADLY}, frames 3 to 31: three worker processes died of it, its process ended, .*--resume"
        with pytest.raises(RunFailed, match=died):
            made(out, radar_file, engine="ray", address=cluster.address, keep_going=True)
    rest = {path: content for path, content in on_disk.items() if path != DEADLY}
    assert shards(out) == rest
    report = made(out, radar_file, resume=True, announce=lines.append)
    assert (report.shards_made, report.shards_kept) == (1, len(rest))
    assert shards(out) == on_disk
    assert lines == []
    assert capfd.readouterr() == ("", "")  # Ray says at length that a process died


def test_nothing_outlives_a_command_that_is_killed(
    cluster: Any, radar_file: Path, on_disk: dict[str, bytes], tmp_path: Path
) -> None:
    """Begun in a command on Ray, killed, finished there."""
    out = tmp_path / "data"
    command = [sys.executable, "-m", "datafactory", "points", "--frames", str(FRAMES), "--split", "2:1:1"]
    command += ["--radar", str(radar_file), "--out", str(out), "--engine", "ray", "--address", cluster.address]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    at_work = wait_for(tasks, process=process)
    family = [*psutil.Process(process.pid).children(recursive=True), *at_work]
    process.send_signal(signal.SIGKILL)
    assert process.communicate()[1] == ""
    assert not psutil.wait_procs(family, timeout=ENDS_S)[1]
    assert not (out / "manifest.json").exists()
    made(out, radar_file, engine="ray", address=cluster.address, workers=1, resume=True)
    assert shards(out) == on_disk


def test_a_ray_of_the_runs_own_is_lost(radar_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without an address, and no cluster on this machine: it is started, and ends with the run."""
    with tempfile.TemporaryDirectory(prefix="ray-", dir="/tmp") as folder:
        monkeypatch.setenv("RAY_TMPDIR", folder)
        monkeypatch.setenv("RAY_worker_niceness", "0")
        own = list[psutil.Process]()

        def progress(stage: str, done: int, total: int) -> None:
            if done > 0 and not own:
                (raylet,) = (
                    item
                    for item in psutil.Process().children(recursive=True)
                    if folder in " ".join(item.cmdline()) and item.name() == "raylet"
                )
                own.extend([raylet, *raylet.children()])
                raylet.kill()

        with pytest.raises(RunFailed, match=r"^--engine ray: the connection to the cluster is lost: .*--resume"):
            made(tmp_path / "data", radar_file, engine="ray", progress=progress)
        assert len(own) > 2
        assert not psutil.wait_procs(own, timeout=ENDS_S)[1]


def test_a_node_of_another_version_is_refused(cluster: Any, radar_file: Path, tmp_path: Path) -> None:
    other = tmp_path / "numpy-1.0.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: numpy\nVersion: 1.0\n", encoding="utf-8")
    path = os.pathsep.join([str(tmp_path), os.environ["PYTHONPATH"]])
    node = add_node(cluster, env_vars={"PYTHONPATH": path})
    try:
        with pytest.raises(InputError, match=r"^--engine: node .*: numpy is 1\.0 there, .* here; expected the same"):
            made(tmp_path / "data", radar_file, engine="ray", address=cluster.address)
    finally:
        kill_node(cluster, node)
    assert not (tmp_path / "data").exists()
