"""Training of the direction-of-arrival network as the paper has it (section IV-A): online samples, no dataset.

One to three targets at random angles, one snapshot, noise at 3 to 30 dB below the weakest of them.
"""

from __future__ import annotations

import numpy as np
import torch
from lightning.pytorch import LightningDataModule
from torch.nn import functional
from torch.utils.data import DataLoader, Dataset, Subset

from shared.physics.units import db_to_amplitude, db_to_power
from shared.radar import Radar
from shared.signal.signal import manifold
from trainer.run.configuration import FitConfig
from trainer.training.datamodule import task_of
from trainer.training.task import Batch, ImagingTask

MOST_TARGETS = 3
SIGNAL_TO_NOISE_DB = (3.0, 30.0)
"""Of the weakest target, per element."""
AMPLITUDE_SPAN_DB = 20.0
"""The paper names no range of amplitudes; this is ours."""
SNAPSHOTS = 64
"""Snapshots of a sample where the configuration's ``rows`` is 0."""
VALIDATION_SAMPLES = 16


class DoaSamples(Dataset[Batch]):
    """Snapshots [1, R, C], R = ``rows``, and where their targets are [R, U]: a function of seed and index alone."""

    def __init__(self, radar: Radar, seed: int, size: int, rows: int) -> None:
        self.radar, self.seed, self.size, self.rows = radar, seed, size, rows

    def __len__(self) -> int:
        return self.size

    def __getitem__(self, index: int) -> Batch:
        generator = np.random.default_rng([self.seed, index])
        grid, channels = self.radar.grid, self.radar.array.channels
        echoes = manifold(self.radar.array.virtual[:, 1], self.radar.waveform.wavelength_m, grid.u)  # (C, U)
        shape = (self.rows, MOST_TARGETS)
        # The first bins of a permutation are distinct.
        place = np.argsort(generator.random((self.rows, grid.bins)), axis=1)[:, :MOST_TARGETS]
        present = np.arange(MOST_TARGETS) < generator.integers(1, MOST_TARGETS + 1, self.rows)[:, None]
        level_db = generator.uniform(0.0, AMPLITUDE_SPAN_DB, shape)
        amplitude = db_to_amplitude(level_db) * np.exp(2j * np.pi * generator.random(shape)) * present
        snapshot = np.einsum("rk,crk->rc", amplitude, echoes[:, place])
        weakest_db = np.where(present, level_db, np.inf).min(axis=1)
        noise_power = db_to_power(weakest_db - generator.uniform(*SIGNAL_TO_NOISE_DB, self.rows))
        noise = generator.standard_normal((self.rows, channels, 2)) @ np.array([1.0, 1.0j])
        snapshot += noise * np.sqrt(noise_power / 2.0)[:, None]
        truth = np.zeros((self.rows, grid.bins), dtype=np.float32)
        np.put_along_axis(truth, place, present.astype(np.float32), axis=1)
        return {
            "range_channel": torch.from_numpy(snapshot.astype(np.complex64)[None]),
            "truth": torch.from_numpy(truth),
            "noise_power": torch.tensor(float(noise_power.mean()), dtype=torch.float64),
            "frame_id": torch.tensor(index),
        }


class DoaData(LightningDataModule):
    """Training samples from the first that a resumed run has not seen, and others to validate on."""

    def __init__(self, config: FitConfig, radar: Radar) -> None:
        super().__init__()
        self.config, self.radar = config, radar

    def train_dataloader(self) -> DataLoader:
        samples = self._samples(0)
        return DataLoader(samples, batch_sampler=task_of(self).unseen_batches([len(samples)], shuffled=False))

    def val_dataloader(self) -> DataLoader:
        samples = self._samples(VALIDATION_SAMPLES)
        return DataLoader(Subset(samples, range(len(samples))[-VALIDATION_SAMPLES:]), batch_size=VALIDATION_SAMPLES)

    def _samples(self, more: int) -> DoaSamples:
        """Those that all processes train on, and behind them some more."""
        config, world = self.config, task_of(self).trainer.world_size
        size = config.steps * config.accumulate * config.batch * world
        return DoaSamples(self.radar, config.seed, size + more, config.rows or SNAPSHOTS)


class DoaTask(ImagingTask):
    """Multi-label cross entropy of the angles that hold a target."""

    def training_step(self, batch: Batch, batch_index: int) -> torch.Tensor:
        # Dropout depends on seed and batch alone: a resumed run then equals one that was never killed.
        place = self.batches_seen * self.trainer.world_size + self.global_rank
        torch.manual_seed(((self.config.seed << 32) + place) % 2**64)
        loss = self._loss(batch)
        self.batches_seen += 1
        self.log("train_loss", loss, prog_bar=True)
        return loss

    def validation_step(self, batch: Batch, batch_index: int) -> None:
        self.log("validation_loss", self._loss(batch), batch_size=len(batch["truth"]), sync_dist=True)

    def _loss(self, batch: Batch) -> torch.Tensor:
        features, _ = self.imager.features(batch["range_channel"][:, 0], batch["noise_power"])
        answer = self.imager.answer(features)[:, 0].float()
        losses = functional.binary_cross_entropy_with_logits(answer, batch["truth"], reduction="none")
        losses = losses.mean(dim=(-2, -1))
        self._refuse_not_finite(losses, batch["frame_id"])
        return losses.mean()
