"""Portions of shards, however they are cut, and the engines that make them; no Ray is started here."""

import errno
import socket
from collections.abc import Callable, Iterator, Sequence
from multiprocessing import current_process
from pathlib import Path
from typing import Any

import pytest
from factory_command import but_made, shards

from datafactory import Report, RunFailed, render
from datafactory.defaults import IMAGE_BATCH
from datafactory.frame.draws import split_of
from datafactory.run import memory, pipeline, portions
from datafactory.run.cluster import engine as cluster_engine
from datafactory.run.cluster.driver import Look, Outcome
from datafactory.run.cluster.engine import RayPool
from datafactory.run.portions import Engine, Rows
from datafactory.run.progress import FOLDER, handed_over
from datafactory.run.shards import PATHS, Portion, ShardPlan, plan_shards, portions_of
from shared.physics.errors import InputError
from shared.processes.pool import LOSSES, Finished, ThisProcess

FRAMES = 21
"""In five shards: 8, 8, 1 of training, 2 and 2."""


def made(out: Path, radar_file: Path, **more: object) -> Report:
    return render(None, out, radar=radar_file, frames=0, points=FRAMES, **more)  # type: ignore[arg-type]


def require_same(folder: Path, whole: Path) -> None:
    assert (shards(folder), but_made(folder)) == (shards(whole), but_made(whole))


def cut(monkeypatch: pytest.MonkeyPatch, by: Callable[[Sequence[Portion]], Sequence[Portion]], workers: int) -> None:
    """Have the next runs cut their shards as for so many workers, and deal the portions in another order."""
    monkeypatch.setattr(pipeline, "portions_of", lambda plans, _: by(portions_of(plans, workers)))


@pytest.mark.parametrize(
    ("frames", "workers", "most", "count"),
    [(8, 1, 3, 2 + 2), (8, 2, 2, 7), (16, 16, 1, 16), (64, 4, 8, 29), (18_500, 16, 8, 2403), (1, 64, 1, 1)],
)
def test_frames_are_shared_by_all_workers(frames: int, workers: int, most: int, count: int) -> None:
    """In portions of a shard that are as large as images share their matrices, smaller where frames are few."""
    plans = plan_shards([split_of(frame_id) for frame_id in range(frames)])
    dealt = portions_of(plans, workers)
    assert [frame for portion in dealt for frame in portion.frame_ids] == [
        frame for plan in plans for frame in plan.frame_ids
    ]
    assert max(len(portion.frame_ids) for portion in dealt) == most <= IMAGE_BATCH
    assert len(dealt) == count
    left = frames
    for portion in dealt if workers > 1 else ():
        assert len(portion.frame_ids) <= max(left // (2 * workers), 1)
        left -= len(portion.frame_ids)
    assert all(set(portion.frame_ids) <= set(portion.plan.frame_ids) for portion in dealt)
    # 4 and 4 of a shard, not 6 and 2.
    (plan,) = plan_shards([PATHS] * 8)
    sizes = [len(portion.frame_ids) for portion in portions_of([plan] * 5, 3)]
    assert sizes == [4, 4, 4, 4, 4, *[2] * 5, *[1] * 10]


def test_no_byte_depends_on_how_shards_are_cut(
    radar_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made(tmp_path / "whole", radar_file)
    for name, by, workers in (("small", list, 100), ("backwards", lambda dealt: dealt[::-1], 3)):
        with monkeypatch.context() as patch:
            cut(patch, by, workers)
            made(tmp_path / name, radar_file)
        require_same(tmp_path / name, tmp_path / "whole")


def test_rows_wait_in_files_for_the_rest_of_their_shard_alone(
    radar_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, waiting = tmp_path / "data", list[int]()
    cut(monkeypatch, list, 100)
    monkeypatch.setattr(portions, "record_finished", lambda *_: waiting.append(len(list(out.rglob("*.arrow")))))
    made(out, radar_file)
    assert waiting == [8, 8, 1, 2, 2]


def test_notes_that_a_killed_run_left_beside_its_manifest_go_with_the_next(radar_file: Path, tmp_path: Path) -> None:
    made(tmp_path, radar_file)
    (tmp_path / FOLDER).mkdir()
    (tmp_path / FOLDER / "train-part-00000.json").write_text("{}", encoding="utf-8")
    made(tmp_path, radar_file, resume=True)
    assert not (tmp_path / FOLDER).exists()


class Deadly(ThisProcess[Portion, Rows]):
    """Nobody survives frame 8."""

    def finished(self, timeout_s: float) -> Iterator[Finished[Portion, Rows]]:
        """As it is, or a failure."""
        if 8 in self._waiting[0].frame_ids:
            yield Finished(self._waiting.pop(), None, "three worker processes died of it, it ended")
        else:
            yield from super().finished(timeout_s)


@pytest.mark.parametrize("keep_going", [False, True])
def test_a_deadly_portion_is_named_and_only_its_shard_is_owed(
    keep_going: bool, radar_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "data"
    with monkeypatch.context() as patch:
        cut(patch, list, 2)
        patch.setattr(Engine, "pool", lambda self, work, count, workers: Deadly(work))
        died = r"^train/part-00000\.parquet, frames 4 to 9: three worker processes died of it, .* --resume, and fewer"
        with pytest.raises(RunFailed, match=died):
            made(out, radar_file, keep_going=keep_going)
    there = sorted(str(path.relative_to(out)) for path in out.glob("*/*.parquet"))
    assert len(there) == (4 if keep_going else 0)
    assert not list(out.rglob("*.arrow"))
    assert made(out, radar_file, resume=True).shards_kept == len(there)
    made(tmp_path / "whole", radar_file)
    require_same(out, tmp_path / "whole")


def test_a_daemonic_process_makes_frames_by_itself(
    radar_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker of ``multiprocessing.Pool`` may start no processes: loky's failed an assertion without a word."""
    monkeypatch.setitem(vars(current_process())["_config"], "daemon", True)
    monkeypatch.setattr(memory, "usable_cores", lambda: 2)
    with pytest.raises(InputError, match=r"^--workers: more than 1 in a daemonic process .*; expected 1, which 0 is"):
        made(tmp_path / "out", radar_file, workers=2)
    assert not (tmp_path / "out").exists()
    assert made(tmp_path / "out", radar_file, workers=0).frames == FRAMES


def test_rows_of_a_run_that_was_killed_are_gone(tmp_path: Path) -> None:
    left = tmp_path / FOLDER / "workers" / "train-0-4711.arrow"
    left.parent.mkdir(parents=True)
    left.write_bytes(b"ARROW1 and no more")
    with handed_over(tmp_path) as folder:
        assert folder == left.parent
        assert list(folder.iterdir()) == []
    assert not folder.exists()


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
