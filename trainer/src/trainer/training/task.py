"""One optimiser step and one validation, as a Lightning module."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from lightning.pytorch import LightningModule
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from numpy.typing import NDArray

from shared.radar import Radar
from shared.signal.adaptive import scanned_angles
from trainer.data.arrays import ArrayChoice
from trainer.data.dataset import BatchOrder
from trainer.data.measurements import known_world
from trainer.errors import Stopped
from trainer.metrics.image import nmse_best_scaled
from trainer.run.configuration import FitConfig
from trainer.run.imager import decode, encode
from trainer.training.augmentation import AngularAugmentation, Draw, draw
from trainer.training.imperfections import BoardErrors
from trainer.training.losses import frame_losses, scene_spots
from trainer.training.online_points import OnlinePoints
from trainer.training.start import new_imager

WARM_UP = 0.05
"""Share of the steps in which the learning rate rises."""
FINAL_RATE = 0.01
"""Learning rate at the end, relative to its peak."""

Batch = dict[str, torch.Tensor]


class ImagingTask(LightningModule):
    """Trains an :class:`trainer.run.imager.Imager`. All randomness follows from seed and batch index.

    See :mod:`trainer.training.augmentation`.
    """

    def __init__(self, config: FitConfig, radar: Radar, array: ArrayChoice) -> None:
        super().__init__()
        self.config = config
        self.imager = new_imager(config, radar, array)
        self._augment = AngularAugmentation(radar)
        self._radar = radar
        self._channels = len(self.imager.channels)
        self._points = OnlinePoints(radar, config.truth_window, self._channels) if config.points else None
        boards = config.imperfections
        self._boards = None if boards is None else BoardErrors(boards, radar, self.imager.channels.numpy())
        self.batches_seen = 0
        self._projections: list[float] = []
        self._energies: list[float] = []

    def training_step(self, batch: Batch, batch_index: int) -> torch.Tensor:
        batch = self._training_batch(batch)
        features, scale = self.imager.features(batch["range_channel"], batch["noise_power"], batch["model_error"])
        answer = self.imager.answer(features, batch.get("prior"))
        losses = self._losses(batch, answer, scale, batch["known"], batch.get("spots"))
        self.batches_seen += 1
        loss = losses.mean()
        self.log("train_loss", loss, prog_bar=True)
        return loss

    def validation_step(self, batch: Batch, batch_index: int) -> None:
        """The loss of training, of a whole frame; what the gain and the normalised error of the linear image follow
        from; that of the best-scaled DaS."""
        range_channel, image = batch["range_channel"][:, 0], batch["image"]
        features, scale = self.imager.features(range_channel, batch["noise_power"])
        answer = self.imager.answer(features, self._prior(batch))
        losses = self._losses(batch, answer, scale, torch.ones_like(image[:, :1]), self._spots(batch))
        self.log("validation_loss", losses.mean(), batch_size=len(image), prog_bar=True, sync_dist=True)
        shown = image.amax(dim=(-2, -1)) > 0  # an empty truth has no normalised error
        if self.config.target == "class" or not shown.any():
            return
        estimate = decode(self.config, answer, scale)[shown]
        if self.config.target == "row":
            estimate = estimate / batch["image_peak"].float()[shown, None, None]
        truth = image[shown]
        # Double precision: a small error is the difference of two numbers near 1.
        estimate, truth = estimate.double(), truth.double()
        energy = truth.square().sum(dim=(-2, -1))
        self._projections += ((estimate * truth).sum(dim=(-2, -1)) / energy).tolist()
        self._energies += (estimate.square().sum(dim=(-2, -1)) / energy).tolist()
        pairs = zip(self.imager.das(range_channel)[shown].cpu().numpy(), truth.cpu().numpy(), strict=True)
        das = float(np.mean([nmse_best_scaled(plain, true) for plain, true in pairs]))
        self.log("das_nmse", das, batch_size=len(truth), sync_dist=True)

    def on_validation_epoch_start(self) -> None:
        self._projections, self._energies = [], []

    def on_validation_epoch_end(self) -> None:
        """The one gain of all frames that errs least, and the error that it leaves.

        With p = <e, t> / <t, t> and q = <e, e> / <t, t> of a frame, NMSE(g) = 1 - 2 g p + g^2 q; its mean over frames
        is least for g = mean(p) / mean(q), where it is 1 - mean(p)^2 / mean(q).
        """
        if not self._projections:
            return
        projection, energy = math.fsum(self._projections), math.fsum(self._energies)
        gain = projection / energy if energy > 0.0 else 1.0
        self.log("validation_gain", gain, sync_dist=True)
        self.log("validation_nmse", 1.0 - gain * projection / len(self._projections), sync_dist=True)

    def configure_optimizers(self) -> OptimizerLRScheduler:
        config = self.config
        # fused passes over the weights once: AdamW's step takes 0.034 s instead of 0.36 s for the DoA CNN's 38 million
        # (torch 2.13, one thread), half of its training step.
        optimizer = torch.optim.AdamW(
            self.imager.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay, fused=True
        )
        warm_up = max(1, round(WARM_UP * config.steps))

        def factor(step: int) -> float:
            if step < warm_up:
                return (step + 1) / warm_up
            part = min(1.0, (step - warm_up) / max(1, config.steps - warm_up))
            return FINAL_RATE + (1.0 - FINAL_RATE) * 0.5 * (1.0 + math.cos(math.pi * part))

        schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, factor)
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

    def unseen_batches(
        self, sizes: Sequence[int], weights: Sequence[float] | None = None, shuffled: bool = True
    ) -> BatchOrder:
        """Of this process, from the batch on that the restored module has not seen yet.

        :param sizes, weights: see :class:`trainer.data.dataset.BatchOrder`
        """
        config, world = self.config, self.trainer.world_size
        return BatchOrder(
            sizes, weights, config.batch * world, config.seed if shuffled else None, config.steps * config.accumulate,
            first=self.batches_seen, rank=self.trainer.global_rank, world=world,
        )  # fmt: skip

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        checkpoint["batches_seen"] = self.batches_seen

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        self.batches_seen = checkpoint["batches_seen"]

    def _training_batch(self, batch: Batch) -> Batch:
        """The strongest Doppler peak, cropped and augmented, and behind it the online point targets, seen by boards.

        ``known`` [B, 1, U] is 1 where the truth is known, ``frame_id`` -1 for online points; ``model_error`` [B].
        """
        config, count = self.config, len(batch["frame_id"])
        largest = self._augment.largest_shift if config.augment else 0
        world, rank = self.trainer.world_size, self.trainer.global_rank
        drawn = draw(config.seed, self.batches_seen, count * world, count * rank, count, largest)
        range_channel, image = batch["range_channel"][:, 0], batch["image"]
        spots = self._spots(batch)
        truths = [image] if spots is None else [image, spots]
        first = 0
        if 0 < config.rows < image.shape[1]:
            first = int(drawn.crop * (image.shape[1] - config.rows + 1))
            range_channel = range_channel[:, first : first + config.rows]
            truths = [truth[:, first : first + config.rows] for truth in truths]
        known = torch.ones_like(truths[0][:, :1])
        if config.augment:
            range_channel, truths, known = self._augment(range_channel, truths, drawn)
        parts = {**batch, "range_channel": range_channel, "known": known}
        parts |= dict(zip(("image", "spots"), truths, strict=False))
        prior = self._prior(batch, drawn, slice(first, first + range_channel.shape[1]))
        if prior is not None:
            parts["prior"] = prior
        rows = np.full(count, float(first))
        boards = range(count * rank, count * (rank + 1))
        if self._points is None:
            return self._by_boards(parts, boards, rows)
        places = range(count * rank * config.points, count * (rank + 1) * config.points)
        crops = self._points(config.seed, self.batches_seen, places, parts["image"].shape[1], image.device)
        extra = {
            "range_channel": crops.range_channel,
            "image": crops.image,
            "image_peak": crops.image_peak,
            "noise_power": torch.ones_like(crops.image_peak),
            "known": known.new_ones(len(places), *known.shape[1:]),
            "frame_id": batch["frame_id"].new_full((len(places),), -1),
        }
        if spots is not None:
            extra["spots"] = crops.spots
        if prior is not None:
            extra["prior"] = prior.new_ones(len(places), *prior.shape[1:])
        joined = {name: torch.cat([parts[name], extra[name]]) for name in extra}
        # The boards of the points come behind those of all processes' frames.
        return self._by_boards(
            joined, [*boards, *(count * world + place for place in places)], np.concatenate([rows, crops.first_row])
        )

    def _prior(self, batch: Batch, drawn: Draw | None = None, rows: slice = slice(None)) -> torch.Tensor | None:
        """[B, R, N] what the sensor's motion says of rows of the frames, of all if nothing is drawn; None of a network
        that is not told.
        """
        if not self.config.told:
            return None
        u = scanned_angles(self._radar)
        angles = [u] * len(batch["frame_id"]) if drawn is None else self._augment.origins(u, drawn)
        priors = []
        for index, seen_at in enumerate(angles):
            frame = {name: batch[name][index].cpu() for name in ("sensor_velocity", "sensor_orientation", "velocity")}
            prior = known_world(frame, self._radar)[0][rows].prior(seen_at)
            unknown = drawn is not None and drawn.told[index] >= self.config.told
            priors.append(np.ones_like(prior) if unknown else prior)
        return torch.from_numpy(np.stack(priors).astype(np.float32)).to(batch["image"].device)

    def _by_boards(self, batch: Batch, places: Sequence[int], first_row: NDArray[np.float64]) -> Batch:
        """The batch as imperfect boards see it, and the model error of each."""
        seen, error = batch["range_channel"], torch.zeros_like(batch["image_peak"], dtype=torch.float32)
        if self._boards is not None:
            seen, error = self._boards(
                self.config.seed, self.batches_seen, places, seen, batch["noise_power"], first_row
            )
        return {**batch, "range_channel": seen, "model_error": error}

    def _losses(
        self,
        batch: Batch,
        answer: torch.Tensor,
        scale: torch.Tensor | None,
        known: torch.Tensor,
        spots: torch.Tensor | None,
    ) -> torch.Tensor:
        """[B] what is minimised, and what the weights of a run are chosen by: of the answer and of its linear image.

        :raises Stopped: one is not finite
        """
        target = encode(self.config, batch["image"], batch["image_peak"], scale)
        losses = frame_losses(self.config, answer, target, known, spots)
        losses = losses + self._linear_losses(batch, answer, scale, known)
        self._refuse_not_finite(losses, batch["frame_id"])
        return losses

    def _linear_losses(
        self, batch: Batch, answer: torch.Tensor, scale: torch.Tensor | None, known: torch.Tensor
    ) -> torch.Tensor:
        """[B] weighted squared error of the linear image over the energy of truth and noise.

        The compressed magnitudes weigh faint ground like a bright target; what the image is judged by does not.
        """
        image = batch["image"]
        if self.config.target != "row" or not self.config.linear:
            return answer.new_zeros(len(image))
        # The noise in the sum of the channels keeps a crop with next to nothing in it from outweighing all others.
        peak, noise = batch["image_peak"].double(), (batch["noise_power"].double() / self._channels).sqrt()
        # The larger of the two is 1: the truth of a frame without any echo has no peak to divide by.
        unit = torch.maximum(peak, noise)
        unit = torch.where(unit.float() > 0, unit, 1.0)
        truth = image * (peak / unit).float()[:, None, None]
        error = (decode(self.config, answer, scale) / unit.float()[:, None, None] - truth).square() * known
        energy = ((truth.square() + (noise / unit).float()[:, None, None].square()) * known).sum(dim=(-2, -1))
        return self.config.linear * error.sum(dim=(-2, -1)) / torch.where(energy > 0, energy, torch.inf)

    def _spots(self, batch: Batch) -> torch.Tensor | None:
        """[B, R, U] where the targets of whole frames are, for a network that says so."""
        if not self.imager.detects:
            return None
        return scene_spots(batch["image"], batch["image_peak"], batch["noise_power"], self._channels, self._radar)

    def _refuse_not_finite(self, losses: torch.Tensor, frame_id: torch.Tensor) -> None:
        finite = torch.isfinite(losses.detach())
        if not finite.all():
            frames = [frame if frame >= 0 else "online points" for frame in frame_id[~finite].tolist()]
            raise Stopped(
                f"loss is not finite for frame {frames} at batch {self.batches_seen}; the weights are unchanged: look "
                "at that frame, or lower the learning rate"
            )
