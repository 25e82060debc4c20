"""The frames of one split as examples for a network: what the sensor measured, and what the virtual sensor sees."""

from __future__ import annotations

import operator
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import Dataset

from shared.dataset.locations import Location, locate
from shared.dataset.manifest import MANIFEST
from shared.dataset.reading import box_of, radar_of
from shared.physics.errors import InputError
from trainer.data.arrays import choose_array
from trainer.data.shards import BOXES, FACTS, ShardDataset

VECTORS = ("sensor_position", "sensor_velocity", "sensor_orientation")
"""Facts that are given as tensors, so that a batch of them is one."""


class Example(NamedTuple):
    """One frame: D Doppler peaks, R range bins, C channels, U bins of u = sin(azimuth).

    :param input: [D, R, C] complex64: the channels at the D strongest Doppler peaks of every range bin, with the
        receiver's noise [sqrt(W)]; the first peak is the strongest, and stands again where there are fewer
    :param image: [R, U] float32: the truth, noise free, relative to its peak; times ``metadata["image_peak"]`` it is
        in sqrt(W). Range and u rise; a target on the left has u > 0.
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


class RadarDataset(Dataset[Example]):
    """The frames of one split of a dataset, for :class:`torch.utils.data.DataLoader` and any PyTorch model.

    >>> data = RadarDataset("build/dataset", "train", array="sparse6")  # doctest: +SKIP
    >>> data[0].input.shape, data[0].image.shape  # doctest: +SKIP
    (torch.Size([3, 630, 18]), torch.Size([630, 450]))

    ``DataLoader(data, batch_size=4, num_workers=2)`` works with PyTorch's own collation: strings become lists, numbers
    tensors. Frames are read one at a time and the first of them are kept in memory
    (:class:`trainer.data.shards.ShardDataset`).

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
