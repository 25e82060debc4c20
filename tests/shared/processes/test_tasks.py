"""How often a task is tried again."""

from __future__ import annotations

from shared.processes.tasks import ATTEMPTS, LOSSES, Attempts, Finished


def test_a_task_fails_with_its_third_process() -> None:
    attempts = Attempts[str, int]()
    assert [attempts.died("a", "it ended") for _ in range(ATTEMPTS - 1)] == [None] * (ATTEMPTS - 1)
    assert attempts.died("b", "it ended") is None
    assert attempts.died("a", "it ended") == Finished("a", None, "three worker processes died of it, it ended")


def test_a_lost_machine_is_no_fault_of_its_tasks_unless_it_always_is() -> None:
    attempts = Attempts[str, int]()
    assert [attempts.lost("a") for _ in range(LOSSES - 1)] == [None] * (LOSSES - 1)
    assert attempts.died("a", "it ended") is None
    assert attempts.lost("a") == Finished("a", None, "10 machines were lost while they worked on it")
