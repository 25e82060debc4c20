"""Which engine makes the frames, and what is refused of a cluster before any work; no Ray is started here."""

from __future__ import annotations

import errno
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from datafactory import render
from datafactory.run.cluster import engine as cluster_engine
from datafactory.run.cluster.driver import Look, Outcome
from datafactory.run.cluster.engine import RayPool
from datafactory.run.shards import Portion, ShardPlan
from shared.physics.errors import InputError
from shared.processes.pool import LOSSES

PORTION = Portion(ShardPlan("train", 0, (0, 1, 2)), (0, 1))


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.mark.parametrize(
    ("engine", "address", "said"),
    [
        ("rays", None, r"^--engine: 'rays'; expected one of local, ray; did you mean 'ray'\?$"),
        ("local", "here:1", r"^--address: 'here:1' with --engine local; expected --engine ray$"),
        ("ray", "6379", r"^--address: '6379'; expected HOST:PORT of a cluster"),
        ("ray", "127.0.0.1:99999", r"^--address: '127.0.0.1:99999': .*; expected HOST:PORT of a cluster"),
        ("ray", "ray://none.invalid:10001", r"^--address: 'ray://none.invalid:10001': .*; expected HOST:PORT"),
        ("ray", "127.0.0.1:{free}", r"^--address: '127.0.0.1:\d+': Connection refused; expected HOST:PORT"),
    ],
)
def test_what_cannot_be_is_refused_at_once(engine: str, address: str | None, said: str, tmp_path: Path) -> None:
    where = address and address.format(free=free_port())
    with pytest.raises(InputError, match=said):
        render(None, tmp_path / "data", frames=0, points=1, engine=engine, address=where)
    assert not (tmp_path / "data").exists()


def test_a_missing_ray_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_engine, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"^--engine: ray is not installed; expected pip install '.*\[ray\]'$"):
        render(None, tmp_path / "data", frames=0, points=1, engine="ray")


def test_something_that_is_no_ray_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes connections and says nothing: Ray would try again for ever."""
    monkeypatch.setattr(cluster_engine, "CONNECT_S", 2.0)
    monkeypatch.setattr(cluster_engine, "END_S", 0.1)
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(InputError, match=rf"^--address: '{address}' does not answer within 2 s"):
            render(None, tmp_path / "data", frames=0, points=1, engine="ray", address=address)


class Cluster:
    """A driver that says what it is told to.

    :param looks: one list of outcomes each
    """

    def __init__(self, *looks: list[Outcome], places: int = 2) -> None:
        self._looks, self._places = list(looks), places
        self.asked: list[Any] = []

    def send(self, message: object) -> None:
        self.asked.append(message)

    def looks(self, timeout_s: float) -> Iterator[Look]:
        if self._looks:
            yield Look(tuple(self._looks.pop(0)), places=self._places)


def pool_on(driver: Cluster, lines: list[str], workers: int = 0) -> RayPool:
    return RayPool(None, 5e8, workers, driver, lines.append)  # type: ignore[arg-type]


def test_a_portion_of_a_lost_node_is_asked_for_again() -> None:
    driver = Cluster(*[[Outcome(PORTION, lost=True)]] * LOSSES)
    pool = pool_on(driver, [])
    pool.submit(PORTION)
    for number in range(1, LOSSES):
        assert list(pool.finished(0.0)) == []
        assert driver.asked == [PORTION] * (number + 1)
        assert pool.busy
    (failed,) = pool.finished(0.0)
    assert failed.result is None
    assert not pool.busy


def test_what_a_task_raised_is_raised() -> None:
    pool = pool_on(Cluster([Outcome(PORTION, error=OSError(28, "No space left on device"))]), [])
    pool.submit(PORTION)
    with pytest.raises(OSError, match="No space left"):
        list(pool.finished(0.0))


@pytest.mark.parametrize(("places", "workers", "most"), [(3, 0, 6), (0, 0, 2), (3, 1, 1)])
def test_as_many_portions_are_asked_for_as_keep_the_nodes_busy(places: int, workers: int, most: int) -> None:
    lines = list[str]()
    pool = pool_on(Cluster([], [], places=places), lines, workers)
    assert list(pool.finished(0.0)) == list(pool.finished(0.0)) == []
    while pool.has_room:
        pool.submit(PORTION)
    assert pool._running == most
    waiting = "no node of the cluster has a core and 0.5 GB of memory for tasks: waiting"
    assert lines == ([waiting] if places == 0 else [])


def test_a_full_disk_is_said_as_such() -> None:
    """By the driver, which writes the rows."""
    driver = cluster_engine._Driver.__new__(cluster_engine._Driver)
    driver._pipe, theirs = cluster_engine.Pipe()
    theirs.send(OSError(errno.ENOSPC, "No space left on device", "part-00000.parquet"))
    with pytest.raises(OSError, match="No space left on device") as caught:
        list(driver.looks(0.0))
    assert caught.value.filename == "part-00000.parquet"
    theirs.close()
    driver._pipe.close()
