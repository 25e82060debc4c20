"""A small share of ``make soak``: kills at random points of render and trace, and their resumes; what counts as a
hang."""

import os
import signal
import subprocess
from pathlib import Path

import pytest
import soak_commands
from soak import soak as driver
from soak.soak import soak, wants_the_processor


@pytest.mark.slow
@pytest.mark.parametrize(("commands", "seed"), [(("render",), 7), (("job", "merge"), 3)])
def test_killed_runs_resume_to_the_same_shards(commands: tuple[str, ...], seed: int, tmp_path: Path) -> None:
    tallies = soak(3, list(commands), tmp_path, seed=seed).values()
    assert sum(sum(tally.kills.values()) for tally in tallies) == 3
    assert all(tally.clean and tally.finished for tally in tallies)


@pytest.mark.slow
def test_a_run_on_a_cluster_survives_the_loss_of_a_node(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(soak_commands, "ON_RAY", 1.0)
    monkeypatch.setattr(soak_commands, "KINDS", ("node",))
    (tally,) = soak(1, ["ray"], tmp_path, seed=2).values()
    assert tally.kills["node"] == 1
    assert tally.clean


@pytest.mark.parametrize(("worker", "works"), [("sleep 600", False), ("while :; do :; done", True)])
def test_only_a_command_whose_processes_all_sleep_hangs(
    worker: str, works: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver, "LOOK_S", 0.01)
    process = subprocess.Popen(["sh", "-c", f"({worker}) & wait"], start_new_session=True)
    try:
        # Both processes run for a moment as they start.
        assert any(wants_the_processor(process.pid) == works for _ in range(20))
        if works:
            assert wants_the_processor(process.pid)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
