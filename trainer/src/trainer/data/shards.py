"""Shards to tensors: the frames of one split as a map-style PyTorch dataset."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import torch
from torch.utils.data import Dataset as TorchDataset

from shared.dataset import COMPLEX_ARRAYS, LATER
from shared.dataset.folder import Dataset, open_dataset
from shared.dataset.locations import Location
from shared.dataset.reading import open_shard, require_values
from shared.physics.errors import InputError

COLUMNS = ("range_channel", "velocity", "image", "range_doppler", "cube")
"""Array columns that become tensors."""

SCALARS = {"image_peak": torch.float64, "noise_power": torch.float64, "frame_id": torch.int64}
"""Scalar columns that every frame comes with, and their types."""

FACTS = ("kind", "scene", "seed", "sensor_position", "sensor_velocity", "sensor_orientation", "time", "sequence")
"""Columns that say where a frame comes from, as Python values."""

BOXES = "boxes"
"""A fact of many numbers: the objects' boxes, as the column has them."""
MISSING: dict[str, Any] = {**LATER, BOXES: []}
"""What a frame of a dataset has that was made before there was the fact."""

CACHE_BYTES = 256 << 20
"""Decoded columns that one process keeps: 140 frames of the default radar, each then ten times as fast."""

OPEN_SHARDS = 64
"""Shards that one process keeps open, each with its parsed footer."""


class ShardDataset(TorchDataset[dict[str, torch.Tensor]]):
    """The frames of one split, read one row at a time.

    Every process opens the shards that it reads and keeps the last of them open: parsing a footer costs a fifth of
    reading a frame. The first frames that fit :data:`CACHE_BYTES` stay in memory as they were decoded. They are not
    replaced, because every epoch has another random order, in which no frame comes sooner than another. A worker gets
    no open file and no kept frame. Only the columns asked for are decoded.

    :param directory: the dataset's folder, local or remote, see :func:`shared.dataset.locations.locate`
    :param split: "train", "validation" or "test"
    :param columns: array columns to read, of :data:`COLUMNS`
    :param cache_bytes: decoded columns that every process keeps
    :param facts: columns of :data:`FACTS`, and :data:`BOXES`, to read as well, for :meth:`frame`
    :param first: take the frames whose ``frame_id`` is below it; 0 for all
    :raises InputError: a dataset that is missing, damaged or newer, a split without frames, none among the first, an
        unknown column
    """

    def __init__(
        self,
        directory: Location | str,
        split: str,
        columns: Sequence[str] = ("range_channel", "image"),
        cache_bytes: int = CACHE_BYTES,
        facts: Sequence[str] = (),
        first: int = 0,
    ) -> None:
        if unknown := [name for name in columns if name not in COLUMNS]:
            raise InputError("columns", f"{unknown[0]!r}", f"some of {list(COLUMNS)}")
        dataset = open_dataset(directory)
        self.columns, self.facts = tuple(columns), tuple(facts)
        self.description = dataset.description()
        if missing := [name for name in columns if name not in self.description["shapes"]]:
            raise InputError(directory, f"{missing[0]!r} is not stored", f"some of {list(self.description['shapes'])}")
        self._rows = _first_rows(dataset, split, first) if first else dataset.rows(split)
        self._open: dict[Location, pq.ParquetFile] = {}
        self._kept: dict[int, pa.RecordBatch] = {}
        self._room = cache_bytes

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, index: int) -> dict[str, torch.Tensor]:
        """Frame ``index`` of the split.

        :returns: the columns asked for, e.g. ``range_channel`` complex64 [D, R, C] [sqrt(W)], ``image`` float32 [R, U]
            relative to its peak, and the scalars ``image_peak`` [sqrt(W)] and ``noise_power`` [W], both float64, and
            ``frame_id``, int64
        :raises InputError: a shard that cannot be read, by its path
        """
        return self.frame(index)[0]

    def frame(self, index: int) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
        """Frame ``index`` of the split: its tensors, and its ``facts`` by name."""
        batch = self._kept.get(index)
        if batch is None:
            batch = self._read(index)
            if batch.nbytes <= self._room:
                self._kept[index] = batch
                self._room -= batch.nbytes
        item = {name: self._tensor(batch, name) for name in self.columns}
        if index in self._kept:
            # A caller that changes a frame in place must not change the kept one.
            item = {name: values.clone() for name, values in item.items()}
        for name, dtype in SCALARS.items():
            item[name] = torch.tensor(batch.column(name)[0].as_py(), dtype=dtype)
        there = set(batch.schema.names)
        return item, {name: batch.column(name)[0].as_py() if name in there else MISSING[name] for name in self.facts}

    def __getstate__(self) -> dict[str, Any]:
        """What a worker gets: paths and row numbers, no open file and no frames."""
        room = self._room + sum(batch.nbytes for batch in self._kept.values())
        return self.__dict__ | {"_open": {}, "_kept": {}, "_room": room}

    def _read(self, index: int) -> pa.RecordBatch:
        path, row = self._rows[index]
        try:
            batch = _read_row(self._shard(path), row, [*SCALARS, *self.facts, *self.columns])
        except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
            raise InputError(path, f"damaged: {error}", "a shard as it was written") from error
        require_values(path, batch)
        return batch

    def _shard(self, path: Location) -> pq.ParquetFile:
        if path not in self._open:
            if len(self._open) == OPEN_SHARDS:
                self._open.pop(next(iter(self._open))).close()
            self._open[path] = open_shard(path)
        return self._open[path]

    def _tensor(self, batch: pa.RecordBatch, name: str) -> torch.Tensor:
        # The tensor uses Arrow's memory: a copy would cost a twentieth of the reading.
        values = torch.from_dlpack(batch.column(name).flatten()).reshape(self.description["shapes"][name])
        return torch.view_as_complex(values) if name in COMPLEX_ARRAYS else values


def _first_rows(dataset: Dataset, split: str, first: int) -> tuple[tuple[Location, int], ...]:
    """(shard, row) of the split's frames whose index is below ``first``."""
    frames = zip(dataset.rows(split), dataset.frames(split, ()), strict=True)
    if rows := tuple(row for row, frame in frames if frame.frame_id < first):
        return rows
    raise InputError(dataset.path, f"no frame of split {split!r} among the first {first}", "a larger number of frames")


def _read_row(file: pq.ParquetFile, row: int, columns: list[str]) -> pa.RecordBatch:
    """The columns of one row; only its row group is read."""
    group, first = 0, 0
    while row >= first + file.metadata.row_group(group).num_rows:
        first += file.metadata.row_group(group).num_rows
        group += 1
    table = file.read_row_group(group, columns=columns, use_threads=False)
    return table.slice(row - first, 1).to_batches()[0]
