"""A small share of ``make soak``: kills at random points of render and trace, and their resumes."""

from __future__ import annotations

from pathlib import Path

import pytest
import soak_commands
from soak.soak import soak


@pytest.mark.parametrize(
    ("kills", "commands", "seed"),
    [
        (1, ("render",), 5),
        pytest.param(3, ("render",), 7, marks=pytest.mark.slow),
        pytest.param(3, ("job", "merge"), 3, marks=pytest.mark.slow),
    ],
)
def test_killed_runs_resume_to_the_same_shards(
    kills: int, commands: tuple[str, ...], seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if kills == 1:
        monkeypatch.setattr(soak_commands, "FRAMES", "9")
    tallies = soak(kills, list(commands), tmp_path, seed=seed).values()
    assert sum(sum(tally.kills.values()) for tally in tallies) == kills
    assert all(tally.clean and tally.finished for tally in tallies)


@pytest.mark.slow
def test_a_run_on_a_cluster_survives_the_loss_of_a_node(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(soak_commands, "ON_RAY", 1.0)
    monkeypatch.setattr(soak_commands, "KINDS", ("node",))
    (tally,) = soak(1, ["ray"], tmp_path, seed=2).values()
    assert tally.kills["node"] == 1
    assert tally.clean
