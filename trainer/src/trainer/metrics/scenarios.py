"""Snapshots of known content: targets in white noise, pairs of targets, noise alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.physics.errors import InputError
from trainer.estimators.array import LineArray

CENTRE_SPAN = 0.5
"""Pairs are centred at angles drawn evenly from -0.5 to 0.5."""


def noise(array: LineArray, rows: int, noise_power: float, generator: np.random.Generator) -> NDArray[np.complex128]:
    """[rows, C] circular white Gaussian noise of ``noise_power`` [W] in each channel."""
    parts = generator.standard_normal((rows, array.channels, 2))
    return np.sqrt(0.5 * noise_power) * (parts[..., 0] + 1j * parts[..., 1])


def echoes(
    array: LineArray, u: NDArray[np.floating], amplitudes: NDArray[np.complexfloating]
) -> NDArray[np.complex128]:
    """[R, C] noise-free snapshots of targets at u [R, K] with complex amplitudes [R, K] [sqrt(W)]."""
    return np.einsum("crk,rk->rc", array.manifold(u), amplitudes)


@dataclass(frozen=True)
class Pair:
    """Two targets in one range bin.

    :param separation: in resolution cells
    :param snr_db: of the stronger one, per channel after range and Doppler processing [dB]
    :param ratio_db: of the other one's amplitude to that [dB], at most 0
    :param phase_rad: between the two, as seen at the array's centre; drawn evenly from all where None
    """

    separation: float
    snr_db: float
    ratio_db: float = 0.0
    phase_rad: float | None = None

    def __post_init__(self) -> None:
        if not self.separation > 0.0:
            raise InputError("pair", f"separation = {self.separation!r}", "a positive number of resolution cells")
        if self.ratio_db > 0.0:
            raise InputError("pair", f"ratio_db = {self.ratio_db!r}", "at most 0, the weaker over the stronger")


@dataclass(frozen=True, eq=False)
class Trials:
    """Snapshots of a scenario and what is in them.

    :param snapshots: [T, C] [sqrt(W)], the stronger target of amplitude 1
    :param u: [T, K] rising
    :param amplitudes: [T, K] at the radar's origin [sqrt(W)]
    :param noise_power: [W]
    """

    snapshots: NDArray[np.complex128]
    u: NDArray[np.float64]
    amplitudes: NDArray[np.complex128]
    noise_power: float


def draw_pairs(array: LineArray, pair: Pair, trials: int, seed: int, cell: float | None = None) -> Trials:
    """Independent snapshots of a pair: centre, phases, which of the two is the stronger, and noise are drawn.

    The same seed draws the same pairs for every array. The pair's phase is that at the centre of the array, where it
    decides whether two close targets add up or cancel.

    :param cell: resolution cell in u, by default that of the array
    """
    generator = np.random.default_rng(seed)
    half = 0.5 * pair.separation * (array.resolution if cell is None else cell)
    centre = generator.uniform(-CENTRE_SPAN, CENTRE_SPAN, trials)
    common = generator.uniform(0.0, 2.0 * np.pi, trials)
    between = generator.uniform(0.0, 2.0 * np.pi, trials) if pair.phase_rad is None else np.full(trials, pair.phase_rad)
    left_stronger = generator.random(trials) < 0.5
    u = np.stack([centre - half, centre + half], axis=1)
    weak = 10.0 ** (pair.ratio_db / 20.0)
    magnitude = np.where(left_stronger[:, None], [weak, 1.0], [1.0, weak])
    phase = common[:, None] + np.stack([np.zeros(trials), between], axis=1)
    middle = 0.5 * (array.positions_m.min() + array.positions_m.max())
    phase += 2.0 * np.pi / array.wavelength_m * middle * u
    amplitudes = magnitude * np.exp(1j * phase)
    noise_power = 10.0 ** (-pair.snr_db / 10.0)
    return Trials(
        echoes(array, u, amplitudes) + noise(array, trials, noise_power, generator), u, amplitudes, noise_power
    )


def draw_single(array: LineArray, snr_db: float, trials: int, seed: int) -> Trials:
    """Independent snapshots of one target of amplitude 1 at an angle drawn from :data:`CENTRE_SPAN`."""
    generator = np.random.default_rng(seed)
    u = generator.uniform(-CENTRE_SPAN, CENTRE_SPAN, (trials, 1))
    amplitudes = np.exp(2j * np.pi * generator.random((trials, 1)))
    noise_power = 10.0 ** (-snr_db / 10.0)
    return Trials(
        echoes(array, u, amplitudes) + noise(array, trials, noise_power, generator), u, amplitudes, noise_power
    )
