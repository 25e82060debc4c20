"""Portions of shards: how frames are cut and put in order again, what is left of some; poses that come late."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from multiprocessing import current_process
from pathlib import Path

import pytest
from factory_command import but_made, shards

from datafactory import Report, RunFailed, render
from datafactory.frame.draws import split_of
from datafactory.run import memory, pipeline, portions
from datafactory.run.portions import Engine, Rows
from datafactory.run.progress import FOLDER, handed_over
from datafactory.run.shards import MOST_FRAMES, PATHS, Portion, plan_shards, portions_of
from shared.physics.errors import InputError
from shared.processes.pool import Finished, ThisProcess

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
    assert max(len(portion.frame_ids) for portion in dealt) == most <= MOST_FRAMES
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
