"""One bit flips in what a command left for a later one: the later one stops with one line, or reads the same values."""

import hashlib
import json
import os
import pickle
import shutil
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from factory_command import run
from fuzzing import flipped
from prepared_scenes import TINY
from pydantic import BaseModel

sys.path.append(str(Path(__file__).resolve().parents[1] / "trainer"))
from small_evaluation import FULL, make_run
from tiny_radar import RADAR as TINY_RADAR

from datafactory.accuracy.cache import cached
from datafactory.accuracy.prices import Price, Prices
from datafactory.inspection.dataset import summarise
from datafactory.paths.storage import read_paths
from datafactory.run.preparation import stored_paths
from datafactory.run.progress import FinishedShard, begin, claimed, completed, record_finished
from datafactory.run.shards import ShardPlan
from shared.dataset.documents import DIGEST, MADE
from shared.dataset.folder import open_dataset, verify
from shared.dataset.locations import sha256_of
from shared.dataset.manifest import ShardRecord
from shared.dataset.reading import read_frame
from shared.physics.errors import InputError
from shared.radar import load_radar
from trainer.data.measurements import open_measurements
from trainer.evaluation.evaluate import open_bench
from trainer.evaluation.experiments.frames import COLUMNS
from trainer.evaluation.options import EvaluationConfig
from trainer.evaluation.store import CellStore, cell_name
from trainer.run.configuration import FitConfig
from trainer.run.folder import RUN_FILE, load_imager, read_run
from trainer.training.callbacks import require_checkpoint
from trainer.training.datamodule import ImagingData

RADAR = """
[waveform]
chirps = 4
samples = 32
range_bins = 24
bandwidth_hz = 400e6
[array]
tx_m = [[0.0, 0.0, 0.0]]
rx_m = [[0.0, 0.0, 0.0], [0.0, 0.002, 0.0], [0.0, 0.008, 0.0]]
[grid]
bins = 20
"""
FLIPS = {"frames": 240, "paths": 160}
"""Bits flipped in a dataset of frames and in one of traced paths, a fifth of them in the manifest."""
NOTICED = "noticed"
LEAST = {
    ("frames", "fit --no-check"): 0.6, ("frames", "evaluate"): 0.6, ("paths", "inspect"): 0.1,
    ("paths", "inspect --verify"): 0.9, ("paths", "render --paths"): 0.9,
}  # fmt: skip
"""Share of the flips that a command must find, where that is not all: these do not open all shards."""


def plain(value: Any) -> Any:
    """The value as what pickle writes the same bytes of where it is the same."""
    if isinstance(value, BaseModel):
        return plain(value.model_dump())
    if is_dataclass(value) and not isinstance(value, type):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__}
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, torch.Tensor):
        return plain(value.resolve_conj().numpy())
    if isinstance(value, Mapping):
        return sorted((str(name), plain(item)) for name, item in value.items())
    if isinstance(value, (list, tuple, Iterator)):
        return [plain(item) for item in value]
    return str(value)


def inspected(folder: Path) -> Any:
    """The tables, and the frames that are drawn."""
    dataset = open_dataset(folder)
    rows = [place for split in dataset.splits for place in dataset.rows(split)]
    return summarise(dataset), [read_frame(*place, columns=("range_channel", "image", "targets")) for place in rows]


def fitted(check: bool, folder: Path) -> Any:
    data = ImagingData([folder], None, FitConfig(), check=check)
    items = [dataset[index] for dataset in (data.training[0], data.validation) for index in range(len(dataset))]
    return data.radar, data.fingerprints, data.truth_window, items


def predicted(folder: Path) -> Any:
    return open_measurements(folder, None, "all")


def evaluated(folder: Path) -> Any:
    bench, left_out = open_bench(folder, EvaluationConfig(methods=("das",), arrays=("full",)))
    frames = [read_frame(ref.path, ref.row, COLUMNS) for ref in bench.frames]
    return bench.radar, bench.data_sha256, bench.frames, sorted(bench.training_scenes), left_out, frames


def rendered(folder: Path) -> Any:
    stored, rows = stored_paths(folder, load_radar(str(folder.parent / "radar.toml")), None, None)
    shards = list(dict.fromkeys(row.shard for row in rows))
    return stored, [frame for shard in shards for frame in read_paths(shard)]


def verified(folder: Path) -> Any:
    faults = verify(open_dataset(folder, check_sizes=False))
    if faults:
        raise InputError(folder, faults[0])
    return faults


Read = Callable[[Path], Any]
READS: dict[str, dict[str, Read]] = {
    "frames": {
        "inspect": inspected, "inspect --verify": verified, "fit": partial(fitted, True),
        "fit --no-check": partial(fitted, False), "predict": predicted, "evaluate": evaluated,
    },
    "paths": {
        "inspect": lambda folder: summarise(open_dataset(folder)), "inspect --verify": verified,
        "render --paths": rendered,
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders ``frames`` and ``paths``, and the radar of both."""
    folder = tmp_path_factory.mktemp("flips")
    (folder / "radar.toml").write_text(RADAR, encoding="utf-8")
    radar = ("--radar", folder / "radar.toml", "--workers", 1)
    run("points", "--frames", 8, *radar, "--out", folder / "frames")
    effects = ("--effects", "specular,diffuse")
    run("trace", "--scene", TINY, "--frames", 2, "--rays", 100, *effects, *radar, "--out",
        folder / "paths")  # fmt: skip
    return folder


def outcome(read: Read, folder: Path) -> str:
    try:
        return hashlib.sha256(pickle.dumps(plain(read(folder)))).hexdigest()
    except InputError as error:
        return NOTICED if "\n" not in str(error) else str(error)


def data_of(content: bytes) -> Any:
    """What a manifest says of the data, whatever machine made them; any other file is all data."""
    try:
        return {key: value for key, value in json.loads(content).items() if key != MADE}
    except (ValueError, AttributeError):
        return content


@pytest.mark.parametrize("kind", READS)
def test_no_flipped_bit_is_read_silently(kind: str, made: Path, generator: np.random.Generator) -> None:
    folder, copy = made / kind, made / "copy"
    shutil.copytree(folder, copy)
    whole = {name: outcome(read, copy) for name, read in READS[kind].items()}
    shutil.rmtree(copy)
    assert NOTICED not in whole.values()
    shards = sorted(folder.glob("*/*.parquet"))
    noticed = Counter[str]()
    for number in range(FLIPS[kind]):
        path = folder / "manifest.json" if number % 5 == 0 else shards[generator.integers(len(shards))]
        content = damaged = path.read_bytes()
        while data_of(damaged) == data_of(content):
            damaged, where = flipped(content, generator)
        shutil.copytree(folder, copy, copy_function=os.link)
        (copy / path.relative_to(folder)).unlink()
        (copy / path.relative_to(folder)).write_bytes(damaged)
        for name, read in READS[kind].items():
            found = outcome(read, copy)
            assert found in (NOTICED, whole[name]), f"{name}: {where} of {path.relative_to(folder)}"
            noticed[name] += found == NOTICED
        shutil.rmtree(copy)
    for name in READS[kind]:
        assert noticed[name] >= LEAST.get((kind, name), 1.0) * FLIPS[kind], noticed


FLIPS_OF_A_FILE = 200


class Noticed(Exception):
    """The reader does without the file and says so."""


@dataclass(frozen=True)
class Kept:
    """A file, and what a later command reads of it."""

    path: Path
    read: Callable[[], Any]


def run_file(name: str, folder: Path) -> Iterator[Kept]:
    run = make_run(folder / "run", FULL, TINY_RADAR)

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
        for _ in range(FLIPS_OF_A_FILE):
            damaged, where = flipped(content, generator)
            kept.path.write_bytes(damaged)
            try:
                assert kept.read() == whole, where
            except (InputError, Noticed):
                noticed += 1
        assert noticed > 0.5 * FLIPS_OF_A_FILE


def test_a_run_of_an_earlier_release_has_no_checksum_and_is_read(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run", FULL, TINY_RADAR)
    whole = read_run(run)
    document = json.loads((run / RUN_FILE).read_text())
    assert document.pop(DIGEST)
    (run / RUN_FILE).write_text(json.dumps(document))
    assert read_run(run) == whole
