"""Shards on a real Ray cluster of several nodes: the bytes of this machine, whatever dies meanwhile."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
import ray_work
from factory_command import shards
from ray_cluster import add_node, kill_node, ray_cluster

from datafactory import RunFailed, render
from datafactory.run import pipeline, preparation
from shared.physics.errors import InputError

FRAMES = 40
DEADLY = "test/part-00000.parquet"
"""Has the frame that :class:`ray_work.DeadlyJob` dies of."""
ENDS_S = 60.0
"""Within this what was killed has ended."""

WAITING = r"no node of the cluster has a core and 0\.\d GB of memory for tasks: waiting"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    with ray_cluster(2) as found:
        yield found


def made(out: Path, radar_file: Path, **more: Any) -> pipeline.Report:
    """40 frames of close targets in seven shards."""
    return render(None, out, radar=radar_file, frames=0, points=FRAMES, split="2:1:1", **more)


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory, radar_file: Path) -> dict[str, bytes]:
    out = tmp_path_factory.mktemp("reference") / "data"
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
    cluster: Any, radar_file: Path, reference: dict[str, bytes], tmp_path: Path
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
    assert shards(out) == reference
    assert (report.shards_made, report.shards_kept) == (len(reference), 0)
    assert done_frames[-1] == FRAMES


def test_a_deadly_portion_is_named_and_the_rest_unharmed(
    cluster: Any,
    radar_file: Path,
    reference: dict[str, bytes],
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
    rest = {path: content for path, content in reference.items() if path != DEADLY}
    assert shards(out) == rest
    report = made(out, radar_file, resume=True, announce=lines.append)
    assert (report.shards_made, report.shards_kept) == (1, len(rest))
    assert shards(out) == reference
    assert lines == []
    assert capfd.readouterr() == ("", "")  # Ray says at length that a process died


def test_nothing_outlives_a_command_that_is_killed(
    cluster: Any, radar_file: Path, reference: dict[str, bytes], tmp_path: Path
) -> None:
    """Begun in a command on Ray, killed, finished there."""
    out = tmp_path / "data"
    command = [sys.executable, "-m", "datafactory", "points", "--frames", str(FRAMES), "--split", "2:1:1"]
    command += ["--radar", str(radar_file), "--out", str(out), "--engine", "ray", "--address", cluster.address]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    while not (at_work := tasks()):
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    family = [*psutil.Process(process.pid).children(recursive=True), *at_work]
    process.send_signal(signal.SIGKILL)
    assert process.communicate()[1] == ""
    assert not psutil.wait_procs(family, timeout=ENDS_S)[1]
    assert not (out / "manifest.json").exists()
    made(out, radar_file, engine="ray", address=cluster.address, workers=1, resume=True)
    assert shards(out) == reference


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
