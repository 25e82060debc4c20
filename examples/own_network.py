# %% [markdown]
# # A PyTorch network of your own on the dataset
#
# A small convolutional network sees the delay-and-sum image of six receivers, and is asked for the truth. It is no
# match for the networks that ship; it shows where yours goes.

# %%
from __future__ import annotations

import os
import shutil
from pathlib import Path

import torch
from torch import nn
from torch.utils.data import DataLoader

from datafactory import render
from trainer import Example, RadarDataset

OUT = Path(os.environ.get("EXAMPLES_OUT", "build/examples")) / "own_network"
FRAMES = int(os.environ.get("EXAMPLES_FRAMES", "32"))
EPOCHS = int(os.environ.get("EXAMPLES_EPOCHS", "8"))
shutil.rmtree(OUT, ignore_errors=True)
torch.manual_seed(0)
torch.set_num_threads(1)

# %% [markdown]
# ## Data
#
# Frames of close point targets need no scene and are made in no time. `sparse6` keeps 6 of the 16 receivers.

# %%
render(None, OUT / "frames", frames=0, points=FRAMES)
train, test = (RadarDataset(OUT / "frames", split, array="sparse6") for split in ("train", "test"))
print(f"{len(train)} frames to train on, {len(test)} to test; {train[0].input.shape[-1]} channels")

# %% [markdown]
# ## What goes in, what comes out
#
# The first Doppler peak of each range bin, as a delay-and-sum image over the row's root-mean-square. The row's scale is
# taken out and kept: amplitudes fall by 60 dB from near to far. The truth is divided by
# the same scale.

# %%
places = torch.from_numpy(train.radar.array.virtual[train.channels, 1])
wavenumber = 2.0 * torch.pi / train.radar.waveform.wavelength_m
steering = torch.exp(1j * wavenumber * places[:, None] * torch.from_numpy(train.u)).to(torch.complex64) / len(places)


def features(example: Example) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """([B, 1, R, U] delay-and-sum and [B, 1, R, U] truth, both over the scale, [B, 1, R, 1] scale [sqrt(W)])."""
    snapshots = example.input[:, 0]
    scale = snapshots.abs().square().mean(dim=-1, keepdim=True).sqrt()[:, None].clamp_min(1e-20)
    peak = torch.as_tensor(example.metadata["image_peak"]).float()[:, None, None, None]
    return (snapshots @ steering).abs()[:, None] / scale, example.image[:, None] * peak / scale, scale


class Mask(nn.Module):
    """Says of each pixel which share of the delay-and-sum image is true.

    The convolutions are wide along angle, because the sidelobes of a thinned array reach far.
    """

    def __init__(self, width: int = 8) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Conv2d(1, width, (1, 31), padding=(0, 15)), nn.ReLU(),
            nn.Conv2d(width, width, (3, 15), padding=(1, 7)), nn.ReLU(),
            nn.Conv2d(width, 1, (1, 15), padding=(0, 7)),
        )  # fmt: skip

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        """[B, 1, R, U] magnitude over the row's scale, of the same [B, 1, R, U] by delay-and-sum."""
        return image * self.layers(image).sigmoid()


# %% [markdown]
# ## Training
#
# NMSE is the squared error of the image over the energy of the truth, at the scale that fits best: 1.00 is an empty
# image. It can be differentiated, and is the loss. A crop of 64 range bins that holds a target keeps a step short.


# %%
def nmse(image: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Of one image, at its best scale."""
    overlap = (image * truth).sum().square()
    return 1.0 - overlap / (image.square().sum() * truth.square().sum()).clamp_min(1e-30)


network = Mask()
optimiser = torch.optim.Adam(network.parameters(), lr=4e-3)
for epoch in range(EPOCHS):
    total, steps = 0.0, 0
    for batch in DataLoader(train, batch_size=1, shuffle=True):
        image, truth, _ = features(batch)
        lit = int(truth.amax(dim=3).argmax())
        first = min(max(lit - int(torch.randint(64, ())), 0), image.shape[2] - 64)
        rows = slice(first, first + 64)
        loss = nmse(network(image[:, :, rows]), truth[:, :, rows])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        total, steps = total + loss.item(), steps + 1
    print(f"epoch {epoch + 1}: loss {total / steps:.3f}")

# %% [markdown]
# ## Against delay-and-sum

# %%
scores: dict[str, list[float]] = {"network": [], "delay-and-sum": []}
with torch.inference_mode():
    for batch in DataLoader(test, batch_size=1):
        image, truth, scale = features(batch)
        scores["network"].append(nmse(network(image) * scale, truth * scale).item())
        scores["delay-and-sum"].append(nmse(image * scale, truth * scale).item())
for name, values in scores.items():
    print(f"{name}: NMSE {sum(values) / len(values):.2f} of {len(values)} test frames")
