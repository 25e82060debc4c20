"""Images whose sides are no multiple of a network's stride: zeros at the far end, cut off again."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch.nn import functional


def pad_to_multiple(
    image: Float[torch.Tensor, "batch channels rows bins"], rows: int, bins: int | None = None
) -> Float[torch.Tensor, "batch channels padded_rows padded_bins"]:
    """Zero-padded at the end of range and angle to multiples, the same for both by default; pixel (0, 0) stays."""
    height, width = image.shape[-2:]
    return functional.pad(image, (0, -width % (bins or rows), 0, -height % rows))


def crop_like(
    image: Float[torch.Tensor, "batch channels padded_rows padded_bins"],
    reference: Float[torch.Tensor, "batch features rows bins"],
) -> Float[torch.Tensor, "batch channels rows bins"]:
    """The part of ``image`` that :func:`pad_to_multiple` did not add to ``reference``."""
    return image[..., : reference.shape[-2], : reference.shape[-1]]
