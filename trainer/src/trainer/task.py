"""One optimiser step and one validation, as Lightning wants them told."""

from __future__ import annotations

import math
from typing import Any

import torch
from lightning.pytorch import LightningModule

from shared.radar import Radar
from trainer.arrays import ArrayChoice
from trainer.augmentation import AngularAugmentation, draw
from trainer.configuration import FitConfig
from trainer.errors import TrainingStopped
from trainer.imager import Imager
from trainer.losses import frame_losses
from trainer.targets import decode, encode

WARM_UP = 0.05
"""Share of the steps in which the learning rate rises."""
FINAL_RATE = 0.01
"""Learning rate at the end, relative to its peak."""

Batch = dict[str, torch.Tensor]


class ImagingTask(LightningModule):
    """Trains an :class:`Imager`. All randomness follows from (seed, batch index), see :mod:`trainer.augmentation`."""

    def __init__(self, config: FitConfig, radar: Radar, array: ArrayChoice) -> None:
        super().__init__()
        self.config = config
        torch.manual_seed(config.seed)
        self.imager = Imager(config, radar, array)
        self.imager.network.to(memory_format=torch.channels_last)
        self._augment = AngularAugmentation(radar)
        self.batches_seen = 0

    def training_step(self, batch: Batch, batch_index: int) -> torch.Tensor:
        range_channel, image, known = self._training_frames(batch)
        features, scale = self.imager.features(range_channel, batch["noise_power"])
        target = encode(self.config, image, batch["image_peak"], scale)
        losses = frame_losses(self.config, self.imager.answer(features), target, known)
        self._refuse_not_finite(losses, batch["frame_id"])
        self.batches_seen += 1
        loss = losses.mean()
        self.log("train_loss", loss, prog_bar=True)
        return loss

    def validation_step(self, batch: Batch, batch_index: int) -> None:
        """Loss, and the normalised mean squared error of the linear image beside that of the best-scaled DaS."""
        range_channel, image = batch["range_channel"][:, 0], batch["image"]
        features, scale = self.imager.features(range_channel, batch["noise_power"])
        answer = self.imager.answer(features)
        target = encode(self.config, image, batch["image_peak"], scale)
        losses = frame_losses(self.config, answer, target)
        self._refuse_not_finite(losses, batch["frame_id"])
        self.log("validation_loss", losses.mean(), batch_size=len(image), prog_bar=True, sync_dist=True)
        shown = image.amax(dim=(-2, -1)) > 0  # an empty truth has no normalised error
        if self.config.target == "class" or not shown.any():
            return
        estimate = decode(self.config, answer, scale)[shown]
        if self.config.target == "row":
            estimate = estimate / batch["image_peak"].float()[shown, None, None]
        das = best_scaled(self.imager.das(range_channel)[shown], image[shown])
        for name, candidate in (("validation_nmse", estimate), ("das_nmse", das)):
            error = normalised_error(candidate, image[shown]).mean()
            self.log(name, error, batch_size=int(shown.sum()), sync_dist=True)

    def configure_optimizers(self) -> dict[str, Any]:
        config = self.config
        optimizer = torch.optim.AdamW(
            self.imager.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay
        )
        warm_up = max(1, round(WARM_UP * config.steps))

        def factor(step: int) -> float:
            if step < warm_up:
                return (step + 1) / warm_up
            part = min(1.0, (step - warm_up) / max(1, config.steps - warm_up))
            return FINAL_RATE + (1.0 - FINAL_RATE) * 0.5 * (1.0 + math.cos(math.pi * part))

        schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, factor)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        checkpoint["batches_seen"] = self.batches_seen

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        self.batches_seen = checkpoint["batches_seen"]

    def _training_frames(self, batch: Batch) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Cropped and augmented ([B, R', C], [B, R', U], [B, 1, U] or None) of the strongest Doppler peak."""
        config, count = self.config, len(batch["frame_id"])
        largest = self._augment.largest_shift if config.augment else 0
        world, rank = self.trainer.world_size, self.trainer.global_rank
        drawn = draw(config.seed, self.batches_seen, count * world, count * rank, count, largest)
        range_channel, image = batch["range_channel"][:, 0], batch["image"]
        if 0 < config.rows < image.shape[1]:
            first = int(drawn.crop * (image.shape[1] - config.rows + 1))
            range_channel = range_channel[:, first : first + config.rows]
            image = image[:, first : first + config.rows]
        if not config.augment:
            return range_channel, image, None
        return self._augment(range_channel, image, drawn)

    def _refuse_not_finite(self, losses: torch.Tensor, frame_id: torch.Tensor) -> None:
        finite = torch.isfinite(losses.detach())
        if not finite.all():
            frames = frame_id[~finite].tolist()
            raise TrainingStopped(
                f"loss is not finite for frame {frames} at batch {self.batches_seen}; the weights are unchanged: look "
                "at that frame, or lower the learning rate"
            )


def best_scaled(estimate: torch.Tensor, image: torch.Tensor) -> torch.Tensor:
    """``estimate`` [B, R, U] times the factor that brings each frame nearest to ``image`` in the square."""
    unit = estimate / estimate.amax(dim=(-2, -1), keepdim=True).clamp_min(1e-30)
    energy = unit.square().sum(dim=(-2, -1), keepdim=True).clamp_min(1e-30)
    return unit * ((unit * image).sum(dim=(-2, -1), keepdim=True) / energy)


def normalised_error(estimate: torch.Tensor, image: torch.Tensor) -> torch.Tensor:
    """[B] squared error over the squared truth; 1 for an all-zero estimate."""
    return (estimate - image).square().sum(dim=(-2, -1)) / image.square().sum(dim=(-2, -1))
