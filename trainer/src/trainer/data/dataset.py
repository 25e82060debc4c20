"""Shards to tensors: the frames of one split as a map-style PyTorch dataset, and as examples for a network; and the
order in which they are seen, a function of the seed alone, so that a run can be taken up at any batch."""

from __future__ import annotations

import operator
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from numpy.typing import NDArray
from torch.utils.data import Dataset as TorchDataset
from torch.utils.data import Sampler

from shared.dataset import COMPLEX_ARRAYS, LATER
from shared.dataset.folder import Dataset, open_dataset
from shared.dataset.locations import Location, locate
from shared.dataset.manifest import MANIFEST
from shared.dataset.reading import box_of, open_shard, radar_of, read_row, require_finite
from shared.physics.errors import InputError
from trainer.data.arrays import choose_array


class BatchOrder(Sampler[list[int]]):
    """Batches of indices into several datasets laid end to end.

    An epoch has as many frames as all datasets together; with weights, each dataset gets its share of them, frames of
    a small one coming more often. A batch may reach into the next epoch, so that all have the same size.

    :param sizes: frames of each dataset
    :param weights: share of each dataset, any positive numbers; by default in proportion to the sizes
    :param batch: frames of a batch on all processes together
    :param seed: of the order; None for that in which the frames lie
    :param batches: batches of the whole run
    :param first: batches to leave out, those that an earlier run has seen
    :param rank, world: the process and how many there are: each gets its part of every batch
    """

    def __init__(
        self,
        sizes: Sequence[int],
        weights: Sequence[float] | None,
        batch: int,
        seed: int | None,
        batches: int,
        first: int = 0,
        rank: int = 0,
        world: int = 1,
    ) -> None:
        self.sizes = tuple(sizes)
        self.shares = np.array(weights if weights is not None else sizes, dtype=np.float64)
        self.batch, self.seed, self.batches, self.first = batch, seed, batches, first
        self.part = slice(rank * batch // world, (rank + 1) * batch // world)

    def __len__(self) -> int:
        """Batches of the whole run, seen ones included: what a progress bar and a step count go by."""
        return self.batches

    def __iter__(self) -> Iterator[list[int]]:
        frames = sum(self.sizes)
        epoch, frames_of_epoch = -1, np.empty(0, dtype=np.int64)
        for index in range(self.first, self.batches):
            chosen: list[int] = []
            for place in range(index * self.batch, (index + 1) * self.batch):
                if place // frames != epoch:
                    epoch = place // frames
                    frames_of_epoch = self._epoch(epoch)
                chosen.append(int(frames_of_epoch[place % frames]))
            yield chosen[self.part]

    def _epoch(self, epoch: int) -> NDArray[np.int64]:
        """[frames] order of one epoch."""
        frames = sum(self.sizes)
        if self.seed is None:
            return np.arange(frames)
        generator = np.random.default_rng([self.seed, epoch])
        edges = np.round(np.cumsum(self.shares) / self.shares.sum() * frames).astype(int)
        counts = np.diff(edges, prepend=0)
        starts = np.cumsum((0, *self.sizes[:-1]))
        drawn = []
        for start, size, count in zip(starts, self.sizes, counts, strict=True):
            rounds = [generator.permutation(size) for _ in range(-(-int(count) // size))]
            drawn.append(start + np.concatenate([np.empty(0, np.int64), *rounds])[:count])
        return generator.permutation(np.concatenate(drawn))


SCALARS = {
    "image_peak": torch.float64, "noise_power": torch.float64, "frame_id": torch.int64,
    "sensor_velocity": torch.float64, "sensor_orientation": torch.float64,
}  # fmt: skip
"""Scalars and short lists that every frame comes with, and their types."""

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
    :param columns: array columns to read: range_channel, velocity, image, range_doppler, cube
    :param facts: columns of :data:`FACTS`, and :data:`BOXES`, to read as well, for :meth:`frame`
    :param first: take the frames whose ``frame_id`` is below it; 0 for all
    :raises InputError: a dataset that is missing, damaged or newer, a split without frames, none among the first, a
        column that is not stored
    """

    def __init__(
        self,
        directory: Location | str,
        split: str,
        columns: Sequence[str] = ("range_channel", "image"),
        facts: Sequence[str] = (),
        first: int = 0,
    ) -> None:
        dataset = open_dataset(directory)
        self.columns, self.facts = tuple(columns), tuple(facts)
        self.description = dataset.description()
        if missing := [name for name in columns if name not in self.description["shapes"]]:
            raise InputError(directory, f"{missing[0]!r} is not stored", f"some of {list(self.description['shapes'])}")
        self._rows = _first_rows(dataset, split, first) if first else dataset.rows(split)
        self._open: dict[Location, pq.ParquetFile] = {}
        self._kept: dict[int, pa.RecordBatch] = {}
        self._room = CACHE_BYTES

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, index: int) -> dict[str, torch.Tensor]:
        """Frame ``index`` of the split.

        :returns: the columns asked for, e.g. ``range_channel`` complex64 [D, R, C] [sqrt(W)], ``image`` float32 [R, U]
            relative to its peak, and the scalars ``image_peak`` [sqrt(W)] and ``noise_power`` [W], both float64, and
            ``frame_id``, int64
        :raises InputError: a shard that cannot be read, by its path; a number that is not finite, by its frame too
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
        batch = read_row(path, self._shard(path), row, [*SCALARS, *self.facts, *self.columns])
        require_finite(path, batch)
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


VECTORS = ("sensor_position", "sensor_velocity", "sensor_orientation")
"""Facts that are given as tensors, so that a batch of them is one."""


class Example(NamedTuple):
    """One frame: D Doppler peaks, R range bins, C channels, U bins of u = sin(azimuth).

    :param input: [D, R, C] complex64: the channels at the D strongest Doppler peaks of every range bin, with the
        receiver's noise [sqrt(W)]; the first peak is the strongest, and stands again where there are fewer
    :param image: [R, U] float32: the truth, noise free, relative to its peak; times ``metadata["image_peak"]`` it is
        in sqrt(W). Of a range bin it shows what is in its first Doppler peak. Range and u rise; a target on the left
        has u > 0.
    :param metadata: ``frame_id``; ``kind``, "scene" or "points"; ``scene``; ``seed``; ``image_peak`` [sqrt(W)];
        ``noise_power`` of one channel in one range-Doppler cell [W]; ``velocity``, [D, R] float32, of the Doppler
        peaks [m/s], positive is receding; ``sensor_position`` [3] [m], ``sensor_velocity`` [3] [m/s] and
        ``sensor_orientation`` [4], the quaternion w x y z, float64 in the scene's world frame; ``time`` of the scene
        [s], NaN where an older dataset does not say it; ``sequence``, the number of its track, -1 for none;
        where asked for ``boxes``, a list of :class:`shared.dataset.Box`
    """

    input: torch.Tensor
    image: torch.Tensor
    metadata: dict[str, Any]

    def __str__(self) -> str:
        facts = self.metadata
        return (
            f"frame {facts['frame_id']}: {facts['kind']}, {facts['scene']}\n"
            f"input {list(self.input.shape)} (peak, range, channel), image {list(self.image.shape)} (range, u)"
        )

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"


class RadarDataset(TorchDataset[Example]):
    """The frames of one split of a dataset, for :class:`torch.utils.data.DataLoader` and any PyTorch model.

    >>> data = RadarDataset("build/dataset", "train", array="sparse6")  # doctest: +SKIP
    >>> data[0].input.shape, data[0].image.shape  # doctest: +SKIP
    (torch.Size([3, 630, 18]), torch.Size([630, 450]))

    ``DataLoader(data, batch_size=4, num_workers=2)`` works with PyTorch's own collation: strings become lists, numbers
    tensors. Frames are read one at a time and the first of them are kept in memory
    (:class:`ShardDataset`).

    :param directory: the dataset's folder; local, ``s3://`` or ``gs://``
    :param split: "train", "validation" or "test"
    :param array: "full", "sparse6", "sparse4" or a TOML file with ``rx = [...]``: the channels that ``input`` holds
    :param boxes: give ``metadata["boxes"]`` as well. Frames have different numbers of them, which PyTorch's own
        collation refuses: a loader then needs a ``collate_fn``.
    :raises InputError: a dataset that is missing, damaged or newer, a split without frames, an array that the radar
        does not have; on access a shard that cannot be read
    """

    def __init__(
        self, directory: Location | str, split: str = "train", array: str | Path = "full", boxes: bool = False
    ) -> None:
        facts = (*FACTS, BOXES) if boxes else FACTS
        self._frames = ShardDataset(directory, split, ("range_channel", "image", "velocity"), facts=facts)
        self.radar = radar_of(self._frames.description, locate(directory) / MANIFEST)
        """The radar that the frames are of: waveform, array, front end, grid."""
        self.array = choose_array(array, self.radar, "array")
        """The RX elements in use."""
        self.channels: NDArray[np.intp] = self.array.channels(self.radar)
        """[C] of the radar's virtual channels, those in ``input``."""
        self._all = len(self.channels) == self.radar.array.channels
        self._chosen = torch.from_numpy(self.channels)

    @property
    def range_m(self) -> NDArray[np.float64]:
        """[R] range of every row [m]."""
        return self.radar.waveform.ranges_m

    @property
    def u(self) -> NDArray[np.float64]:
        """[U] sin(azimuth) of every column."""
        return self.radar.grid.u

    def __len__(self) -> int:
        return len(self._frames)

    def __iter__(self) -> Iterator[Example]:
        """All frames of the split, in the order of the dataset."""
        return (self[index] for index in range(len(self)))

    def __getitem__(self, index: int) -> Example:
        """Frame ``index`` of the split, in the order of the dataset.

        :raises InputError: a shard that cannot be read, by its path; an index that is no whole number
        :raises IndexError: beyond the last frame
        """
        try:
            place = operator.index(index)
        except TypeError:
            expected = "a whole number; several frames are torch.utils.data.Subset(data, range(2))"
            raise InputError("index", repr(index), expected) from None
        tensors, facts = self._frames.frame(place)
        metadata: dict[str, Any] = {
            name: torch.tensor(value, dtype=torch.float64) if name in VECTORS else value
            for name, value in facts.items()
        }
        for name in ("frame_id", "image_peak", "noise_power"):
            metadata[name] = tensors[name].item()
        metadata["velocity"] = tensors["velocity"]
        if BOXES in metadata:
            metadata[BOXES] = [box_of(values) for values in facts[BOXES]]
        measured = tensors["range_channel"]
        return Example(measured if self._all else measured[..., self._chosen], tensors["image"], metadata)
