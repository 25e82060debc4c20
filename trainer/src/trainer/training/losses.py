"""Losses of Table 2 of the paper, weighted against the empty background."""

from __future__ import annotations

import torch
from torch.nn import functional

from trainer.run.configuration import FitConfig


def frame_losses(
    config: FitConfig,
    answer: torch.Tensor,
    target: torch.Tensor,
    known: torch.Tensor | None = None,
    spots: torch.Tensor | None = None,
) -> torch.Tensor:
    """[B] loss of each frame, a mean over its known pixels.

    Regression: w (x - y)^2 + alpha |x|. Classification: w times the cross entropy -log p(class) of the two-class
    softmax (the paper's table prints it without the minus). w = 1 + foreground min(y, 1), scaled for the paper's beta.
    A detection head adds ``config.detection`` times the binary cross entropy of its logit.

    :param answer: [B, 1 or 2, R, U]
    :param target: [B, R, U]
    :param spots: [B, R, U] where targets are, for a network that detects (:mod:`trainer.training.spots`)
    :param known: [B, 1, U] 1 where the truth is known, 0 where an augmented frame has none; all known by default
    """
    answer = answer.float()
    full = config.beta if config.target == "paper" else 1.0
    weight = 1.0 + config.foreground * (target / full).clamp(max=1.0)
    if config.target == "class":
        loss = weight * functional.cross_entropy(answer, target.long(), reduction="none")
    else:
        loss = weight * (answer[:, 0] - target).square() + config.alpha * answer[:, 0].abs()
    if spots is not None:
        loss = loss + config.detection * functional.binary_cross_entropy_with_logits(
            answer[:, 1], spots, reduction="none"
        )
    if known is None:
        return loss.mean(dim=(-2, -1))
    return (loss * known).sum(dim=(-2, -1)) / (known.sum(dim=(-2, -1)) * loss.shape[-2])
