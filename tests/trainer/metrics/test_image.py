"""NMSE and SSIM: a perfect image, an empty one, white noise, torchmetrics."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torchmetrics.functional.image import structural_similarity_index_measure

from shared.physics.errors import InputError
from trainer.metrics.image import nmse, nmse_best_scaled, ssim


def test_image_metrics_of_perfect_and_empty_images() -> None:
    truth = np.random.default_rng(2).random((40, 60))
    empty = np.zeros_like(truth)
    assert nmse(truth, truth) == nmse_best_scaled(truth, truth) == 0.0
    assert nmse(empty, truth) == nmse_best_scaled(empty, truth) == 1.0
    assert nmse(3.0 * truth, truth) == pytest.approx(4.0)
    assert nmse_best_scaled(3.0 * truth, truth) == pytest.approx(0.0, abs=1e-12)
    assert ssim(truth, truth) == pytest.approx(1.0)
    assert ssim(empty, truth) < 0.02


def test_ssim_is_that_of_torchmetrics() -> None:
    generator = np.random.default_rng(0)
    truth = generator.random((30, 26))
    estimate = truth + 0.3 * generator.standard_normal(truth.shape)
    one, other = (torch.from_numpy(image)[None, None] for image in (estimate, truth))
    _, likeness = structural_similarity_index_measure(one, other, data_range=1.0, sigma=1.5, return_full_image=True)
    # Its mean includes pixels whose window hangs over the edge.
    assert ssim(estimate, truth) == pytest.approx(float(likeness[..., 5:-5, 5:-5].mean()), abs=1e-9)


@pytest.mark.parametrize(
    "call",
    [
        lambda: nmse(np.zeros(3), np.zeros(4)), lambda: nmse(np.ones(3), np.zeros(3)),
        lambda: nmse(np.full(3, np.nan), np.ones(3)), lambda: ssim(np.ones((5, 50)), np.ones((5, 50))),
        lambda: nmse(np.empty(0), np.empty(0)),
    ],
)  # fmt: skip
def test_images_that_cannot_be_compared_are_refused(call) -> None:
    with pytest.raises(InputError, match="expected"):
        call()
