"""A small share of ``make soak``: kills at random points of render and trace, and their resumes."""

from __future__ import annotations

from pathlib import Path

import pytest
from soak.soak import soak


@pytest.mark.slow
def test_killed_runs_resume_to_the_same_shards(tmp_path: Path) -> None:
    (tally,) = soak(3, ["render"], tmp_path, seed=7).values()
    assert sum(tally.kills.values()) == 3
    assert tally.clean
