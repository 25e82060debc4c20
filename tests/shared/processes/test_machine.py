"""What of the machine a run may use: limits of control groups, as Docker, Kubernetes and Slurm set them."""

from __future__ import annotations

from pathlib import Path

import psutil
import pytest

from shared.processes import machine
from shared.processes.machine import group_limits, usable_cores, usable_memory

UNLIMITED_V1 = "9223372036854771712"


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"{text}\n", encoding="ascii")


def test_a_job_of_slurm_is_held_by_its_own_group_or_by_one_above(tmp_path: Path) -> None:
    """Version 2: the step has no limit of its own, the job above it has."""
    group = "system.slice/slurmstepd.scope/job_7/step_batch/user/task_0"
    write(tmp_path / group / "memory.max", "max")
    write(tmp_path / "system.slice/slurmstepd.scope/job_7/memory.max", "4294967296")
    write(tmp_path / "system.slice/memory.max", "9000000000")
    assert sorted(group_limits(f"0::/{group}\n", tmp_path)) == [4294967296, 9000000000]


def test_a_container_sees_its_own_group_in_place_of_the_root(tmp_path: Path) -> None:
    write(tmp_path / "memory.max", "2000000000")
    assert group_limits("0::/docker/0123abcd\n", tmp_path) == [2000000000]
    assert group_limits("0::/\n", tmp_path) == [2000000000]


def test_version_1_has_a_hierarchy_for_memory(tmp_path: Path) -> None:
    write(tmp_path / "memory/slurm/uid_1/job_7/memory.limit_in_bytes", "3000000000")
    write(tmp_path / "memory/memory.limit_in_bytes", UNLIMITED_V1)
    groups = "9:name=systemd:/\n7:cpu,cpuacct:/slurm\n4:memory:/slurm/uid_1/job_7\n0::/\n"
    assert sorted(group_limits(groups, tmp_path)) == [3000000000, int(UNLIMITED_V1)]


@pytest.mark.parametrize("groups", ["", "0::/\n", "4:memory:/a/b\n"])
def test_without_groups_there_is_no_limit(groups: str, tmp_path: Path) -> None:
    assert group_limits(groups, tmp_path) == []


def test_the_smallest_limit_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "MOUNTED", tmp_path)
    monkeypatch.setattr(machine, "GROUPS_OF_THIS", tmp_path / "cgroup")
    assert usable_memory() == psutil.virtual_memory().total
    write(tmp_path / "cgroup", "0::/job")
    write(tmp_path / "job/memory.max", "1000000")
    assert usable_memory() == 1000000
    assert usable_cores() >= 1
