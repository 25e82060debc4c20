"""The network we recommend: what the virtual sensor would see of an adaptive spectrum, corrected by learned iterations.

Plain iterations of the "iaa" rule (:mod:`shared.signal.adaptive`) begin. :func:`shared.signal.adaptive.virtual_view`
says what the virtual sensor would see of the mean echoes that they find: a smooth base, which the answer is added to.
From there on a few iterations of the "likes" rule, P <- P |q|^2 / s, sharpen the spectrum, each with a learned
correction,

    log P <- log P + (1 + beta) log(|q|^2 / s) + delta,

with beta and delta from a small convolution along angle over what the iteration knows: log P, log(|q|^2 / s), P s, and
the products z(u)* z(u + l) of z = q / sqrt(s), which no common phase changes. Where the convolution gives zero this is
the plain iteration. A light U-Net over range and angle corrects the base by what has been found, and says where targets
are. Before training its correction is zero, and the answer the base.

What the sensor's own motion says of each row's angles (:mod:`shared.signal.ego_motion`) may multiply P in both kinds of
iterations.

No weight knows the array: it enters through the tables alone.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import nn
from torch.nn import functional

from shared.radar import Radar
from shared.signal.adaptive import (
    LEAST_POWER,
    PRIOR_EXPONENT,
    AdaptiveTables,
    adaptive_forms,
    adaptive_powers,
    adaptive_tables,
    bounded_power,
    likes_ratio,
    view_table,
    virtual_view,
)
from trainer.networks.convolutional import LightUNet

LAGS = (1, 2, 4, 8)
"""Distances of the products [angle bins]; a resolution cell of the full array has 10.75."""
STATE = 4 + 2 * len(LAGS)
"""Channels of what a learned step sees."""
KERNEL = 7
"""Angle bins that a convolution of a learned step sees."""
STEP_WIDTH = 16
CONTEXT_STRIDE = 2
"""Angle bins to one of the U-Net's; the truth's lines are nine bins wide."""
LARGEST_CORRECTION = 1.0
"""Of one learned step [decades of power]: a step that is wrong leaves the next ones something to mend."""
LEAST_RATIO = 1e-6
"""Of |q|^2 / s, in a logarithm."""
SMALLEST = 1e-8
"""Far below any magnitude over its row's: the slope of a root stays finite."""
RARE = -4.0
"""Logit that detection starts with: a target in one pixel of fifty."""
IMAGES_AT_ONCE = 3
"""Of rows that stand in many images: what the U-Net needs for one fits into memory that the last one left."""


class LearnedStep(nn.Module):
    """(beta, delta) [B, 2, R, U] of the state [B, STATE, R, U], row by row; zero before training."""

    def __init__(self) -> None:
        super().__init__()
        padding, width = (0, KERNEL // 2), STEP_WIDTH
        self.first = nn.Conv2d(STATE, width, (1, KERNEL), padding=padding)
        self.second = nn.Conv2d(width, width, (1, KERNEL), padding=padding)
        self.last = nn.Conv2d(width, 2, 1)
        nn.init.zeros_(self.last.weight)
        assert self.last.bias is not None
        nn.init.zeros_(self.last.bias)

    def forward(self, state: Float[torch.Tensor, "batch planes rows bins"]) -> Float[torch.Tensor, "batch 2 rows bins"]:
        return self.last(functional.gelu(self.second(functional.gelu(self.first(state)))))


class Iterate(NamedTuple):
    """What an iteration has found in the B R rows of images.

    :param power: [B R, N] P
    :param filtered: [B R, N] q, with its parts ``real`` and ``imag``
    :param form: [B R, N] s
    :param noise: [B R] over the row's power
    :param shape: (B, R, U)
    """

    power: torch.Tensor
    filtered: Any
    form: torch.Tensor
    noise: torch.Tensor
    shape: tuple[int, int, int]


def laid_out(
    rows: Float[torch.Tensor, "1 planes rows bins"], place: Int[torch.Tensor, "images bins_of_range"]
) -> Float[torch.Tensor, "images planes bins_of_range bins"]:
    """Images of rows; ``place`` says which stands where. One that stands in several images is computed once."""
    return rows[0].permute(1, 2, 0)[place].permute(0, 3, 1, 2)


def at_least_single(values: torch.Tensor) -> torch.Tensor:
    """What autocast left in half precision, in single; double precision stays."""
    return values if values.dtype == torch.float64 else values.float()


class UnrolledNetwork(nn.Module):
    """Snapshots [B, 2 C + 1, R, 1] of :func:`shared.signal.features.snapshot_features` to [B, 1 or 2, R, U]: the
    compressed magnitude over the row's RMS, and the logit of a target.

    :param channels: [C] indices of the radar's channels that the network sees
    :param window: of the truth's virtual sensor
    :param exponent: compression of the magnitude
    :param iterations: without weights by the "iaa" rule, then with weights by the "likes" rule
    :param width: channels of the U-Net's first level
    :param detects: whether the second output is there
    :param told: whether the logarithm of a prior is an input; its weights begin at zero
    """

    def __init__(
        self,
        radar: Radar,
        channels: Int[np.ndarray, " channels"],
        window: str,
        exponent: float,
        iterations: tuple[int, int],
        width: int,
        detects: bool,
        told: bool,
    ) -> None:
        super().__init__()
        self.bins, self.exponent = radar.grid.bins, exponent
        self.plain, learned = iterations
        self.outputs = 2 if detects else 1
        # These buffers are neither trained nor stored: they follow from radar and array.
        for name, table in adaptive_tables(radar, channels)._asdict().items():
            self.register_buffer(name, torch.from_numpy(table), persistent=False)
        self.register_buffer("view", torch.from_numpy(view_table(radar, channels, window)), persistent=False)
        self.steps = nn.ModuleList(LearnedStep() for _ in range(learned))
        # The U-Net sees every second angle bin's neighbourhood; what one row says at each bin goes past it.
        self.context = LightUNet(STATE + 2, self.outputs, width, stride=CONTEXT_STRIDE)
        self.row = nn.Conv2d(STATE + 2, self.outputs, (1, KERNEL), padding=(0, KERNEL // 2))
        with torch.no_grad():
            # The image starts as the base, and detection with what is rare.
            for head in (self.context.head, self.row):
                head.weight.zero_()
                assert head.bias is not None
                head.bias.zero_()
            assert self.row.bias is not None
            self.row.bias.copy_(torch.tensor([0.0, RARE][: self.outputs]))
        # Without a bias a flat prior, whose logarithm is zero, adds nothing, before training and after it.
        self.prior = nn.Conv2d(1, STATE + 2, (1, KERNEL), padding=(0, KERNEL // 2), bias=False) if told else None
        if self.prior is not None:
            nn.init.zeros_(self.prior.weight)

    def forward(
        self,
        snapshots: Float[torch.Tensor, "batch planes rows 1"],
        prior: torch.Tensor | None = None,
        place: torch.Tensor | None = None,
    ) -> Float[torch.Tensor, "images {self.outputs} bins_of_range {self.bins}"]:
        """The answer, of [B, R] rows.

        :param prior: [B, R, N] that of :mod:`shared.signal.adaptive`, the same everywhere by default
        :param place: [D, L] see :func:`laid_out`; by default the rows are images as they come
        """
        batch, planes, rows, _ = snapshots.shape
        known = None if prior is None else prior.reshape(batch * rows, -1)
        with torch.autocast(snapshots.device.type, enabled=False):
            row = at_least_single(snapshots)[..., 0].transpose(1, 2).reshape(batch * rows, planes)
            snapshot, noise = torch.complex(row[:, : planes // 2], row[:, planes // 2 : -1]), row[:, -1]
            tables = AdaptiveTables(*(self.get_buffer(name) for name in AdaptiveTables._fields))
            with torch.no_grad():
                power = adaptive_powers(snapshot, noise, tables, self.plain, 1.0 if known is None else known)
                filtered, form = adaptive_forms(power, snapshot, noise, tables)
                # Declared in single precision: also of a network in double, where that costs a last digit of the base.
                single = torch.complex64
                seen = virtual_view(power.float(), filtered.to(single), self.get_buffer("view").to(single))
        found = Iterate(power, filtered, form, noise, (batch, rows, self.bins))
        for step in self.steps:
            power = self.stepped(found, step)
            if known is not None:
                power = bounded_power(power * known**PRIOR_EXPONENT)
            with torch.autocast(snapshots.device.type, enabled=False):
                filtered, form = adaptive_forms(power, snapshot, noise, tables)
            found = found._replace(power=power, filtered=filtered, form=form)
        return self.corrected(seen, found, None if prior is None else prior[..., : self.bins], place)

    def corrected(
        self, seen: torch.Tensor, found: Iterate, prior: torch.Tensor | None = None, place: torch.Tensor | None = None
    ) -> torch.Tensor:
        """[B, 1 or 2, R, U] the answer, or of the images of ``place``, of what the iterations have found.

        :param seen: [B R, U] the virtual view
        :param prior: [B, R, U]
        :param place: see :meth:`forward`
        """
        base = (seen + SMALLEST).pow(self.exponent).reshape(found.shape)
        state, level = self._state(found)
        known = torch.cat([state, base[:, None], level[:, None]], dim=1)
        if self.prior is not None and prior is not None:
            known = known + at_least_single(self.prior(prior.log10()[:, None]))
        own, base = at_least_single(self.row(known)), base[:, None]
        if place is None:
            context = at_least_single(self.context(known))
        else:
            parts = [at_least_single(self.context(laid_out(known, some))) for some in place.split(IMAGES_AT_ONCE)]
            context = torch.cat(parts)
            own, base = laid_out(own, place), laid_out(base, place)
        answer = context + own
        return torch.cat([answer[:, :1] + base, answer[:, 1:]], dim=1)

    def stepped(self, found: Iterate, step: nn.Module) -> torch.Tensor:
        """The powers after a learned step; angles outside the image take the plain one."""
        correction = step(self._state(found)[0])
        ratio = likes_ratio(found.filtered, found.form)
        inside = ratio[:, : self.bins].clamp_min(LEAST_RATIO)
        beta, delta = (at_least_single(correction[:, part]).reshape(-1, self.bins) for part in (0, 1))
        change = (beta * inside.log10() + delta).clamp(-LARGEST_CORRECTION, LARGEST_CORRECTION)
        change = functional.pad(change, (0, found.power.shape[1] - self.bins))
        return bounded_power(found.power * ratio * torch.pow(10.0, change))

    def _state(self, found: Iterate) -> tuple[torch.Tensor, torch.Tensor]:
        """([B, STATE, R, U] what the iteration knows at the image's angles, [B, R, U] compressed |P q|)."""
        power, form = found.power[:, : self.bins], found.form[:, : self.bins]
        real, imaginary = (part[:, : self.bins] * form.rsqrt() for part in (found.filtered.real, found.filtered.imag))
        ratio = real.square() + imaginary.square()
        shrunk = (1.0 + ratio).rsqrt()
        real, imaginary = real * shrunk, imaginary * shrunk
        # Logarithms are scaled so that powers from 1e-10 to 1e2 and ratios from 1e-6 to 1e4 stay within a few units.
        planes = [
            0.25 * power.clamp_min(LEAST_POWER).log10() + 0.5,
            0.5 * ratio.clamp_min(LEAST_RATIO).log10(),
            (power * form).clamp_max(1.0),
            (0.25 * found.noise.clamp_min(SMALLEST).log10() + 0.5)[:, None].expand_as(power),
        ]
        for lag in LAGS:
            beyond = min(lag, self.bins)
            far_real, far_imaginary = (functional.pad(part[:, lag:], (0, beyond)) for part in (real, imaginary))
            planes += [real * far_real + imaginary * far_imaginary, real * far_imaginary - imaginary * far_real]
        mean = (power * ratio.clamp_min(SMALLEST).sqrt() * form.sqrt() + SMALLEST).pow(self.exponent)
        return torch.stack([plane.reshape(found.shape) for plane in planes], dim=1), mean.reshape(found.shape)
