"""Shards to tensors: the frames of one split as a map-style PyTorch dataset."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch.utils.data import Dataset as TorchDataset

from shared.dataset_folder import open_dataset
from shared.dataset_reading import read_frame
from shared.errors import InputError

COLUMNS = ("range_channel", "velocity", "image", "range_doppler", "cube")
"""Array columns that become tensors."""


class ShardDataset(TorchDataset[dict[str, torch.Tensor]]):
    """The frames of one split, read one row at a time.

    It holds paths and row numbers alone. A shard is opened for each frame, which is 0.1 ms of the 2 ms that a frame of
    the default radar takes, so that nothing open is ever pickled or forked into a worker.

    :param directory: the dataset's folder
    :param split: "train", "validation" or "test"
    :param columns: array columns to read, of :data:`COLUMNS`
    :raises InputError: a dataset that is missing, damaged or newer, a split without frames, an unknown column
    """

    def __init__(self, directory: Path | str, split: str, columns: Sequence[str] = ("range_channel", "image")) -> None:
        if unknown := [name for name in columns if name not in COLUMNS]:
            raise InputError("columns", f"{unknown[0]!r}", f"some of {list(COLUMNS)}")
        dataset = open_dataset(directory)
        self.columns = tuple(columns)
        self.description = dataset.description()
        if missing := [name for name in columns if name not in self.description["shapes"]]:
            raise InputError(directory, f"{missing[0]!r} is not stored", f"some of {list(self.description['shapes'])}")
        self._rows = dataset.rows(split)

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, index: int) -> dict[str, torch.Tensor]:
        """Frame ``index`` of the split.

        :returns: the columns asked for, e.g. ``range_channel`` complex64 [D, R, C] [sqrt(W)], ``image`` float32 [R, U]
            relative to its peak, and the scalars ``image_peak`` [sqrt(W)] and ``noise_power`` [W], both float64, and
            ``frame_id``, int64
        """
        path, row = self._rows[index]
        frame = read_frame(path, row, self.columns)
        # Copied: Arrow's memory is read-only, a tensor's is not.
        item = {name: torch.from_numpy(np.array(getattr(frame, name))) for name in self.columns}
        item["image_peak"] = torch.tensor(frame.image_peak, dtype=torch.float64)
        item["noise_power"] = torch.tensor(frame.noise_power, dtype=torch.float64)
        item["frame_id"] = torch.tensor(frame.frame_id)
        return item
