"""Several datasets as one stream of training batches, and their validation frames."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Sequence
from functools import partial
from typing import Any

from lightning.pytorch import LightningDataModule
from torch.utils.data import ConcatDataset, DataLoader

from shared.dataset.folder import Dataset, open_dataset, verify
from shared.dataset.locations import Location, locate
from shared.dataset.reading import radar_of
from shared.physics.errors import InputError
from shared.processes.defaults import ANGLE_WINDOWS
from shared.processes.pool import end_with_parent
from trainer.data.dataset import ShardDataset
from trainer.run.configuration import FitConfig
from trainer.run.folder import Fingerprint, same_radar, scene_records
from trainer.training.task import ImagingTask

COLUMNS = ("range_channel", "velocity", "image")
LARGEST_WEIGHT = 1e9
"""Shares are sums of such numbers over their sum."""


class ImagingData(LightningDataModule):
    """Training and validation frames of datasets of one radar.

    :param directories: of the datasets, local paths or URIs
    :param weights: share of each in the training batches; by default in proportion to their frames
    :param config: batch size, steps, seed, and how many frames of each dataset are looked at
    :param check: hash every shard first
    :raises InputError: a damaged shard by its path, datasets of different radars or truths, no training or
        validation frames
    """

    def __init__(
        self,
        directories: Sequence[Location | str],
        weights: Sequence[float] | None,
        config: FitConfig,
        workers: int = 0,
        check: bool = True,
    ) -> None:
        super().__init__()
        if weights and len(weights) != len(directories):
            raise InputError("--weight", f"{len(weights)} weights for {len(directories)} datasets", "one for each")
        for weight in weights or ():
            if not 0 < weight < LARGEST_WEIGHT:
                raise InputError("--weight", f"{weight}", f"numbers above 0, below {LARGEST_WEIGHT:g}")
        self.config, self.weights, self.workers = config, weights or None, workers
        folders = [locate(directory) for directory in directories]
        opened = [_checked(folder, check) for folder in folders]
        self.training = [ShardDataset(folder, "train", COLUMNS, first=config.frames) for folder in folders]
        self.radar = radar_of(self.training[0].description, folders[0])
        for folder, dataset in zip(folders[1:], self.training[1:], strict=True):
            same_radar(self.radar, str(folders[0]), radar_of(dataset.description, folder), str(folder))
        self.truth_window = _truth_window(self.training, folders)
        validation = [_validation(dataset, config.frames) for dataset in opened]
        if not any(validation):
            among = f" among the first {config.frames} frames" if config.frames else ""
            raise InputError(
                folders[0], f"no frames in split 'validation'{among}", "a dataset with frames to train and to validate"
            )
        self.validation: ConcatDataset[dict[str, Any]] = ConcatDataset(frames for frames in validation if frames)
        self.fingerprints = tuple(
            _fingerprint(dataset, len(training), len(validating or ()), config.frames)
            for dataset, training, validating in zip(opened, self.training, validation, strict=True)
        )
        _require_different(self.fingerprints, folders)

    def train_dataloader(self) -> DataLoader:
        order = task_of(self).unseen_batches([len(dataset) for dataset in self.training], self.weights)
        return self._loader(ConcatDataset(self.training), batch_sampler=order)

    def val_dataloader(self) -> DataLoader:
        """Every process validates all frames: few, and the same numbers however many processes there are."""
        return self._loader(self.validation, batch_size=1)

    def _loader(self, dataset: ConcatDataset, **arguments: Any) -> DataLoader:
        # Spawned processes: the threads of Arrow and torch do not survive a fork.
        context = multiprocessing.get_context("spawn") if self.workers else None
        return DataLoader(
            dataset,
            num_workers=self.workers,
            multiprocessing_context=context,
            persistent_workers=self.workers > 0,
            worker_init_fn=partial(_begin_reading, os.getpid()),
            **arguments,
        )


def task_of(data: LightningDataModule) -> ImagingTask:
    """What is trained on the data."""
    assert data.trainer is not None
    assert isinstance(data.trainer.lightning_module, ImagingTask)
    return data.trainer.lightning_module


def _begin_reading(parent: int, _worker: int) -> None:
    """A reading process ends with the one that trains."""
    end_with_parent(parent)


def _truth_window(datasets: Sequence[ShardDataset], folders: Sequence[Location]) -> str:
    """The window over the virtual sensor's elements; "none" where a dataset does not name one."""
    windows = [dataset.description.get("truth", {}).get("window", "none") for dataset in datasets]
    for window, folder in zip(windows, folders, strict=True):
        if window != windows[0]:
            raise InputError(folder, f"truth.window = {window!r}", f"{windows[0]!r}, as {folders[0]} has it")
    if windows[0] not in ANGLE_WINDOWS:
        raise InputError(folders[0], f"truth.window = {windows[0]!r}", f"one of {list(ANGLE_WINDOWS)}")
    return windows[0]


def _checked(directory: Location, check: bool) -> Dataset:
    """The dataset, opened; with ``check`` every shard is hashed."""
    dataset = open_dataset(directory)
    if check and (faults := verify(dataset)):
        more = f" (and {len(faults) - 1} more faults)" if len(faults) > 1 else ""
        raise InputError(directory, f"{faults[0]}{more}", "a dataset as it was written")
    return dataset


def _validation(dataset: Dataset, first: int) -> ShardDataset | None:
    """Its frames to validate with; None without any."""
    if "validation" not in dataset.splits:
        return None
    if first and all(frame.frame_id >= first for frame in dataset.frames("validation", ())):
        return None
    return ShardDataset(dataset.path, "validation", COLUMNS, first=first)


def _require_different(fingerprints: Sequence[Fingerprint], folders: Sequence[Location]) -> None:
    """Frames that stand twice would be judged twice."""
    first: dict[str, Location] = {}
    for one, folder in zip(fingerprints, folders, strict=True):
        if one.sha256 in first:
            expected = "each dataset once; --weight gives one a larger share"
            raise InputError(folder, f"the same shards as {first[one.sha256]}", expected)
        first[one.sha256] = folder


def _fingerprint(dataset: Dataset, training: int, validating: int, first: int) -> Fingerprint:
    """What a run notes of a dataset: with the scenes of the frames that train and validate, which may be some of it.

    :param training, validating: frames
    :param first: those below this index are looked at; 0 for all
    """
    test = sum(record.rows for record in dataset.records if record.path.startswith("test/"))
    scenes = scene_records(dataset.manifest)
    if scenes:
        seen = {
            frame.scene
            for split in ("train", "validation")
            if split in dataset.splits
            for frame in dataset.frames(split, ())
            if not first or frame.frame_id < first
        }
        scenes = tuple(scene for scene in scenes if scene.name in seen)
    frames = {"train": training, "validation": validating, "test": test}
    return Fingerprint.of(dataset.path, dataset.records, frames, scenes)
