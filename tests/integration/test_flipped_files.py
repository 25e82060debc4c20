"""One bit that flips in a file that a command left for a later one: the later one notices, or reads the same values.

Shards and manifests have their own tests (``test_flipped_bits.py``). What a user writes (poses, targets, radars) has no
checksum.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from fuzzing import flipped

sys.path.append(str(Path(__file__).resolve().parents[1] / "trainer"))
from small_evaluation import FULL, make_run
from tiny_radar import RADAR

from datafactory.accuracy.cache import cached
from datafactory.accuracy.prices import Price, Prices
from datafactory.run.progress import FinishedShard, begin, claimed, completed, record_finished
from datafactory.run.shards import ShardPlan
from shared.dataset.documents import DIGEST
from shared.dataset.locations import sha256_of
from shared.dataset.manifest import ShardRecord
from shared.physics.errors import InputError
from trainer.evaluation.store import CellStore, cell_name
from trainer.run.folder import RUN_FILE, load_imager, read_run
from trainer.training.callbacks import require_checkpoint

FLIPS = 200
"""Of each file."""


class Noticed(Exception):
    """The reader does without the file and says so."""


@dataclass(frozen=True)
class Kept:
    """A file, and what a later command reads of it."""

    path: Path
    read: Callable[[], Any]


def run_file(name: str, folder: Path) -> Iterator[Kept]:
    run = make_run(folder / "run", FULL, RADAR)

    def read() -> Any:
        described, imager = load_imager(run)
        weights = [(key, value.numpy().tobytes()) for key, value in imager.network.state_dict().items()]
        return described, imager.gain, weights

    yield Kept(run / name, read)


def checkpoint(folder: Path) -> Iterator[Kept]:
    path, state = folder / "last.ckpt", {"weight": torch.arange(24.0).reshape(4, 6)}
    torch.save(
        {
            "state_dict": state, "optimizer_states": [], "lr_schedulers": [], "loops": {}, "callbacks": {"best": 0.5},
            "epoch": 0, "global_step": 4, "batches_seen": 4, "pytorch-lightning_version": "2.6",
        },
        path,
    )  # fmt: skip

    def read() -> Any:
        require_checkpoint(path)
        content = torch.load(path, weights_only=True)
        return {**content, "state_dict": content["state_dict"]["weight"].tolist()}

    yield Kept(path, read)


def cell(folder: Path) -> Iterator[Kept]:
    """Of an evaluation."""
    key = cell_name("pairs", "das", "full", "snr=20", "inputs")
    CellStore(folder).keep(key, {"levels": np.arange(3000.0), "found": np.array(3)})

    def read() -> Any:
        values = CellStore(folder).finished(key)
        return {name: (value.dtype, value.tolist()) for name, value in (values or {}).items()}

    yield Kept(folder / key, read)


def measurements(folder: Path) -> Iterator[Kept]:
    """What the plan of effects and the error budget keep in the user's cache."""
    price = Price(knob="rays", value=1.0, cube=(0.25,), image=(0.5,), power=(0.125,), bias=(1.0,), paths=7.0)
    prices = Prices(prices=(price,))
    cached(folder, {}, Prices, lambda _: prices, print)

    def measured_again(_: Path) -> Prices:
        raise Noticed

    yield Kept(next(folder.iterdir()), lambda: cached(folder, {}, Prices, measured_again, lambda _: None))


def note(folder: Path) -> Iterator[Kept]:
    """Of a shard that an unfinished run has finished."""
    plan, shard = ShardPlan("train", 0, (0, 1)), folder / "train" / "part-00000.parquet"
    shard.parent.mkdir()
    shard.write_bytes(b"whole")
    record = ShardRecord(path=plan.path, rows=2, bytes=5, sha256=sha256_of(shard))

    def read() -> Any:
        found = completed(folder, [plan], "made so")
        if found.damaged:
            raise Noticed
        return found

    with claimed(folder, resume=True):
        begin(folder, {}, resume=False)
        record_finished(folder, plan, FinishedShard(record=record, counts={"rays": 12345}, fingerprint="made so"))
        yield Kept(next((folder / ".progress").glob("train-*")), read)


@pytest.mark.parametrize(
    "keep",
    [partial(run_file, "run.json"), partial(run_file, "weights.safetensors"), checkpoint, cell, measurements, note],
)
def test_a_flipped_bit_is_noticed_or_changes_nothing(
    keep: Callable[[Path], Iterator[Kept]], tmp_path: Path, generator: np.random.Generator
) -> None:
    with contextmanager(keep)(tmp_path) as kept:
        content, whole = kept.path.read_bytes(), kept.read()
        noticed = 0
        for _ in range(FLIPS):
            damaged, where = flipped(content, generator)
            kept.path.write_bytes(damaged)
            try:
                assert kept.read() == whole, where
            except (InputError, Noticed):
                noticed += 1
        assert noticed > 0.5 * FLIPS


def test_a_run_of_an_earlier_release_has_no_checksum_and_is_read(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run", FULL, RADAR)
    whole = read_run(run)
    document = json.loads((run / RUN_FILE).read_text())
    assert document.pop(DIGEST)
    (run / RUN_FILE).write_text(json.dumps(document))
    assert read_run(run) == whole
