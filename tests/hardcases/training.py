"""Hard cases of training: numbers that half precision cannot hold, and nothing to learn from.

Networks are tiny and untrained: what is asked is that numbers stay finite, and that a run stops before it is ruined.
"""

from typing import Any
from unittest import mock

import numpy as np
from hardcases.case import HardCase
from hardcases.tools import small_radar

ROWS, BATCH = 16, 2
LEVELS = (0.0, 1e-45, 1e-38, 1e-30, 1e-12, 1.0, 1e18, 1e30)
"""Magnitudes of snapshots [sqrt(W)], from nothing over the smallest number of float32 to near its largest."""
HALF = 1e30
"""Beyond the largest number of float16 (65504) by far."""


def _config(**changes: object) -> Any:
    from trainer.run.configuration import FitConfig

    fields = {"width": 4, "hidden": 8, "batch": BATCH, "rows": 0, "points": 0, "augment": False, "precision": "bf16"}
    return FitConfig.model_validate({**fields, **changes})


def _task(**changes: object) -> Any:
    """An :class:`trainer.training.task.ImagingTask` that needs no trainer around it."""
    from types import SimpleNamespace

    from trainer.data.arrays import choose_array
    from trainer.training.task import ImagingTask

    class Alone(ImagingTask):
        trainer = SimpleNamespace(world_size=1, global_rank=0)  # type: ignore[assignment]

        def log(self, *arguments: Any, **named: Any) -> None:
            """Nowhere."""

    return Alone(_config(**changes), small_radar(), choose_array("full", small_radar()))


def _batch(level: float, truth: float = 1.0) -> dict[str, Any]:
    """Two frames of snapshots of this magnitude, the second with an empty half, and truths of one pixel a row."""
    import torch

    radar = small_radar()
    generator = np.random.default_rng(3)
    phase = generator.uniform(-np.pi, np.pi, (BATCH, 1, ROWS, radar.array.channels))
    snapshot = (level * np.exp(1j * phase)).astype(np.complex64)
    snapshot[1, :, ROWS // 2 :] = 0
    image = np.zeros((BATCH, ROWS, radar.grid.bins), np.float32)
    image[:, :, 7] = truth
    return {
        "range_channel": torch.from_numpy(snapshot),
        "image": torch.from_numpy(image),
        "image_peak": torch.full((BATCH,), level if truth else 0.0, dtype=torch.float64),
        "noise_power": torch.full((BATCH,), 1e-20, dtype=torch.float64),
        "frame_id": torch.tensor([41, 42]),
    }


def _variants() -> list[dict[str, object]]:
    return [
        {"model": "unrolled"},
        {"model": "spectral-unet"},
        {"model": "attention-unet"},
        {"model": "attention-unet", "features": "paper", "target": "paper", "foreground": 0.0},
        {"model": "spectral-unet", "target": "class"},
    ]


def _not_finite_gradients(batches: list[dict[str, Any]]) -> float:
    """Losses and gradients that are not finite, over networks, features, targets and batches."""
    import torch

    count = 0
    for changes in _variants():
        task = _task(**changes)
        for batch in batches:
            task.zero_grad()
            loss = task.training_step(batch, 0)
            loss.backward()
            numbers = [loss.detach(), *(parameter.grad for parameter in task.parameters())]
            count += sum(int((~torch.isfinite(number)).sum()) for number in numbers)
    return float(count)


def _half_precision(model: str, precision: str = "bf16") -> float:
    """Largest difference of the image at the extreme scale from that at scale 1, relative to it."""
    import torch

    task = _task(model=model, precision=precision)
    # A processor without the instructions emulates them here, which the trainer leaves to nobody.
    asked = mock.patch("trainer.run.imager.in_bfloat16", lambda config, _: config.precision == "bf16")
    with torch.inference_mode(), asked:
        one, large = (task.imager(_batch(level)["range_channel"][:, 0], _batch(1.0)["noise_power"] * level**2)
                      for level in (1.0, HALF))  # fmt: skip
    return float((large.double() / HALF - one.double()).abs().max() / one.abs().max())


def _one_strong_batch() -> dict[str, Any]:
    """Frames whose rows hold one target each, noise 80 dB below it, its truth one pixel of the target's amplitude."""
    import torch

    from shared.signal.imaging import steering_weights

    radar, batch = small_radar(), _batch(1.0)
    channels = radar.array.channels
    echo = np.conj(steering_weights(radar, np.arange(channels))[:, 7] * channels)
    generator = np.random.default_rng(5)
    shape = batch["range_channel"].shape
    noise = 1e-4 * np.sqrt(0.5) * (generator.standard_normal((*shape, 2)) @ np.array([1.0, 1.0j]))
    batch["range_channel"] = torch.from_numpy((echo + noise).astype(np.complex64))
    batch["noise_power"] = torch.full((BATCH,), 1e-8, dtype=torch.float64)
    return batch


def _untouched(**changes: object) -> Any:
    """A task of the unrolled network that adds nothing to its base, the view of the plain iterations."""
    import torch

    task = _task(precision="32", **changes)
    for head in (task.imager.network.context.head, task.imager.network.row):
        torch.nn.init.zeros_(head.weight)
    return task


def _one_strong_target() -> float:
    """Largest error of the amplitude that the unrolled network's base reads of a target at 80 dB, relative to it."""
    import torch

    batch = _one_strong_batch()
    with torch.inference_mode():
        image = _untouched(truth_window="none").imager(batch["range_channel"][:, 0], batch["noise_power"])
    return float((image.amax(dim=-1) - 1.0).abs().max())


def _noise_alone() -> float:
    """Largest amplitude that the unrolled network's base reads in rows of noise alone, over the noise's."""
    import torch

    batch = _one_strong_batch()
    generator = np.random.default_rng(7)
    noise = generator.standard_normal((*batch["range_channel"].shape, 2)) @ np.array([1.0, 1.0j]) * np.sqrt(0.5)
    snapshots = torch.from_numpy(noise.astype(np.complex64))[:, 0]
    with torch.inference_mode():
        image = _untouched().imager(snapshots, torch.ones(BATCH, dtype=torch.float64))
    return float(image.max())


CASES = (
    HardCase(
        "half precision", "bfloat16 overflows on snapshots of 1e30", 1e-5, "relative",
        lambda: _half_precision("spectral-unet"),
    ),
    HardCase(
        "unrolled network at 1e30", "an iteration multiplies what rounding changed", 1e-3, "relative",
        lambda: _half_precision("unrolled", "32"),
    ),
    HardCase(
        "half precision, unrolled", "the same in bfloat16, which rounds by 2^-9", 2.0**-9,
        "relative", lambda: _half_precision("unrolled"),
    ),
    HardCase(
        "one target at 80 dB", "a covariance that single precision cannot invert", 0.02, "relative", _one_strong_target
    ),
    HardCase(
        "gradients of one target at 80 dB", "so are its gradients", 0, "values",
        lambda: _not_finite_gradients([_one_strong_batch()]),
    ),
    HardCase(
        "an estimate of noise alone", "a converging spectrum makes targets of noise", 1.5, "of the noise's amplitude",
        _noise_alone,
    ),
    HardCase(
        "gradients at every level", "a square overflows or a logarithm meets zero", 0, "values",
        lambda: _not_finite_gradients([_batch(level) for level in LEVELS]),
    ),
    HardCase(
        "batch of zero images", "normalisation divides by an empty truth", 0, "values",
        lambda: _not_finite_gradients([_batch(1e-6, truth=0.0), _batch(0.0, truth=0.0)]),
    ),
)  # fmt: skip
