"""Shards in processes, or in this one: hand out, watch, record."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from datafactory.paths.backend import select_variant, set_threads
from datafactory.run.freed_memory import keep_freed_memory
from datafactory.run.job import Job, WriteShard
from datafactory.run.progress import FinishedShard, record_finished
from datafactory.run.shards import ShardPlan
from shared.dataset.locations import Location
from shared.dataset.writing import remove_partial
from shared.processes.tasks import Pool, StepsDone

Advance = Callable[[int, int], None]
Seconds = dict[str, float]
ShardResult = tuple[FinishedShard, Seconds]
"""The record of a shard, and the seconds that each step took."""
POLL_S = 0.3
"""How often the frames that the workers finished are counted."""


class RunFailed(Exception):
    """A run that cannot be finished now, in one line."""


@dataclass(frozen=True)
class ShardWork:
    """What every worker is given once.

    :param write: makes one shard of the job
    :param mark: of the arguments, see :func:`datafactory.run.progress.fingerprint`
    """

    job: Job
    write: WriteShard
    directory: Location
    mark: str

    def begin(self) -> None:
        """Make this process ready."""
        keep_freed_memory()
        if self.job.scenes:
            select_variant(self.job.settings.device)
            set_threads(1)

    def __call__(self, plan: ShardPlan, report: StepsDone) -> ShardResult:
        """Write one shard."""
        return self.write(self.job, plan, self.directory, self.mark, report)


@dataclass
class Made:
    """What was made: shards, seconds by step added over the workers, and shards that three processes died of."""

    shards: dict[ShardPlan, FinishedShard] = field(default_factory=dict)
    seconds: Counter[str] = field(default_factory=Counter)
    failed: dict[ShardPlan, str] = field(default_factory=dict)


def run_shards(
    work: ShardWork,
    todo: Sequence[ShardPlan],
    processes: Pool[ShardPlan, ShardResult] | None,
    keep_going: bool,
    total: int,
    advance: Advance,
) -> Made:
    """Write the shards; each is recorded as soon as it is whole.

    :param processes: that work on them, see :mod:`datafactory.run.engines`; None for this one
    :param keep_going: finish the others where three processes died of a shard
    :param total: frames of the run; :param advance: takes frames done and frames in all
    :raises RunFailed: three processes died of a shard
    """
    made = Made()
    before = total - sum(len(plan.frame_ids) for plan in todo)
    done = before

    def tell(running: int) -> None:
        advance(done + running, total)

    def keep(plan: ShardPlan, result: ShardResult) -> None:
        nonlocal done
        record_finished(work.directory, plan, result[0])
        made.shards[plan] = result[0]
        made.seconds.update(result[1])
        done += len(plan.frame_ids)

    tell(0)
    if processes is None:
        work.begin()
        for plan in todo:
            running = 0

            def report(count: int) -> None:
                nonlocal running
                running += count
                tell(running)

            keep(plan, work(plan, report))
        return made
    waiting = deque(todo)
    try:
        with processes as pool:
            while waiting or pool.busy:
                while waiting and pool.has_room:
                    pool.submit(waiting.popleft())
                for finished in pool.finished(POLL_S):
                    if finished.result is not None:
                        keep(finished.item, finished.result)
                        continue
                    made.failed[finished.item] = finished.failure
                    if not keep_going:
                        raise RunFailed(failure_line(made.failed))
                tell(pool.running_steps())
    except BaseException:
        remove_partial(work.directory)
        raise
    return made


def failure_line(failed: dict[ShardPlan, str]) -> str:
    """What to say of shards whose processes died, see :class:`shared.processes.tasks.Attempts`."""
    (plan, how), *others = failed.items()
    more = f" (and {len(others)} other shards)" if others else ""
    return (
        f"{plan.path}, frames {plan.frame_ids[0]} to {plan.frame_ids[-1]}: {how}{more}, "
        "perhaps for lack of memory; the same command with --resume, and fewer --workers, goes on"
    )
