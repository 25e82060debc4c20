"""Snapshots as imperfect boards see them: each frame, and each crop of online points, by a board of its own.

What a board does to the channels of one echo is linear and the same for all range bins, x -> M x with

    M = diag(g) (I + D G_1 + D^2 G_2) (C_rx (x) C_tx)

- *Coupling*: C of a line of elements is 1 on its diagonal and c beside it, one complex c for the TX and one for the RX.
- *Positions*: D holds the channels' displacement p, the sum of that of their TX and of their RX. An echo from u has its
  phase changed by exp(-j k u p) = 1 - j k u p - (k u p)^2 / 2 - ...; G_1 and G_2 are the least-squares operators that
  multiply the channels of every echo by -j k u and -(k u)^2 / 2. They err by 5 % within |u| < 0.8, mostly in the outer
  elements, whose echoes have neighbours on one side alone; the next term is below 1e-3 for p = 0.1 mm.
- *Gain and phase*: g, in dB and in degrees the sum of a part of the TX and one of the RX of equal power. 0 for a
  receiver that is dead.

What depends on the range bin r (whole frames' bins, T_c the duration of a chirp, B its bandwidth):

- *Delay* t behind the mixer turns the beat frequency r / T_c by exp(-j 2 pi (r - r_0) t / T_c), in all channels of a
  receiver. Calibration took it out at r_0, where its reflector stood.
- *Phase noise*: each tone has sidebands m bins away, D_m(r) of :func:`shared.radar.receiver.with_phase_noise`, the same
  in all channels. In a Doppler cell the chirps' independent draws average, by the window over the chirps. All rows of a
  crop are taken to show one Doppler cell; tones outside of the crop give nothing.
- *Leakage* from TX to RX is the range response of range zero, with an independent phase in every channel.
- *Quantisation*: white noise of q^2 / 12 in both parts of a sample (Bennett 1948), after both windows. The full scale
  lies a stated headroom above the root mean square of the strongest channel.

The thermal noise of the data passes M too. The truth stays that of the ideal array, and the noise power is not changed:
what it leaves out is the model error, the share of a plane wave's power that no plane wave from its angle explains in
the channels chosen, as calibration reports it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Complex128, Float, Float64, Int

from shared.physics.units import db_to_amplitude, db_to_power
from shared.radar import Radar
from shared.signal.signal import manifold
from shared.signal.windows import hann_noise_share, hann_spectrum, power_in_cell
from trainer.run.configuration import Imperfections

STREAM = 2
"""Third entry of a board's seed: :mod:`trainer.training.augmentation` has none, online points have 1."""
CALIBRATION_RANGE_M = (3.0, 10.0)
"""Where the reflector of a calibration stands: beyond the near field, within a hall."""
RIDGE = 1e-3
"""Of the least-squares operators, of their largest eigenvalue: what no angle of the image excites stays as it is."""
ANGLES = 64
"""Of the image that a board's model error is the mean of."""


@dataclass(frozen=True, eq=False)
class Board:
    """One draw.

    :param matrix: [C, C] M
    :param moved_m: [C] displacement of each channel
    :param delay_s: [C] of each channel
    :param calibrated_row: r_0
    :param leakage: [C] at range zero, over the amplitude of the noise
    :param reported: model error that calibration reports over the true one, power
    :param seed: of what is drawn cell by cell
    """

    matrix: Complex128[np.ndarray, "channels channels"]
    moved_m: Float64[np.ndarray, " channels"]
    delay_s: Float64[np.ndarray, " channels"]
    calibrated_row: float
    leakage: Complex128[np.ndarray, " channels"]
    reported: float
    seed: int


class BoardErrors:
    """Boards for one radar.

    :param imperfections: their magnitudes
    :param channels: [chosen] that the network sees
    """

    def __init__(self, imperfections: Imperfections, radar: Radar, channels: Int[np.ndarray, " chosen"]) -> None:
        self.imperfections, self._radar, self._channels = imperfections, radar, channels
        wavelength_m = radar.waveform.wavelength_m
        wavenumber = 2.0 * np.pi / wavelength_m
        positions_m, u = radar.array.virtual[:, 1], radar.grid.u
        echoes = manifold(positions_m - positions_m.mean(), wavelength_m, u)  # [C, U]
        gram = echoes @ echoes.conj().T
        gram += RIDGE * np.linalg.eigvalsh(gram)[-1] * np.eye(len(gram))
        slopes = (-1j * wavenumber * u, -0.5 * (wavenumber * u) ** 2)
        self._moves = [np.linalg.solve(gram.T, ((echoes * slope) @ echoes.conj().T).T).T for slope in slopes]
        self._echoes = echoes[:, np.unique(np.linspace(0, len(u) - 1, ANGLES).astype(int))]
        bits = imperfections.bits
        # Two parts of q^2 / 12 each, q = 2 A / 2^b, over the square of the full scale A.
        self._quantisation = 0.0 if bits is None else power_in_cell((2.0 / 3.0) * 4.0**-bits, radar.waveform)
        self._doppler = hann_noise_share(radar.waveform.chirps)

    def __call__(
        self,
        seed: int,
        step: int,
        places: Sequence[int],
        range_channel: torch.Tensor,
        noise_power: torch.Tensor,
        first_row: Float[np.ndarray, " batch"],
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """([B, R, C] what the boards of these places of the batch record, [B] float32 their model errors).

        A function of seed, step and place alone, on one kind of device.

        :param places: in the batch of all processes
        :param range_channel: [B, R, C] of the ideal array [sqrt(W)]
        :param noise_power: [B] of one channel and cell [W]
        :param first_row: [B] range bin of the first row
        """
        device, rows = range_channel.device, range_channel.shape[1]
        seen, errors = [], []
        for index, place in enumerate(places):
            generator = np.random.default_rng([seed, step, STREAM, place])
            board = self.draw(generator)
            if board is None:
                seen.append(range_channel[index])
                errors.append(0.0)
                continue
            row = first_row[index] + np.arange(rows)
            middle = self._turned(board, np.array([row.mean()]))[0]
            errors.append(min(board.reported * self.model_error(middle[:, None] * board.matrix), 1.0))
            seen.append(self._recorded(board, range_channel[index], noise_power[index], row))
        return torch.stack(seen), torch.tensor(errors, dtype=torch.float32, device=device)

    def draw(self, generator: np.random.Generator) -> Board | None:
        """A board, or None for a perfect one."""
        drawn, array = self.imperfections, self._radar.array
        if generator.random() < drawn.perfect:
            return None

        def deviation(spread: tuple[float, float]) -> float:
            return float(generator.uniform(*spread))

        def of_channels(size: float) -> Float64[np.ndarray, " channels"]:
            """Sums of a part of the TX and one of the RX, of this root mean square."""
            tx, rx = (generator.standard_normal(len(line)) for line in (array.tx_m, array.rx_m))
            return size * np.sqrt(0.5) * (tx[array.channel_tx] + rx[array.channel_rx])

        gain_db = of_channels(deviation(drawn.gain_db))
        phase = np.deg2rad(of_channels(deviation(drawn.phase_deg)))
        # The elements' own root mean square is stated, the channels' is root 2 of it.
        moved_m = np.sqrt(2.0) * of_channels(deviation(drawn.position_m))
        delay_s = (deviation(drawn.delay_s) * generator.standard_normal(len(array.rx_m)))[array.channel_rx]
        dead = (generator.random(len(array.rx_m)) < drawn.dead)[array.channel_rx]
        factors = np.where(dead, 0.0, db_to_amplitude(gain_db) * np.exp(1j * phase))
        first, second = self._moves
        matrix = np.eye(array.channels) + moved_m[:, None] * first + moved_m[:, None] ** 2 * second
        if drawn.coupling_db is not None:
            rx, tx = (_coupled(len(line), drawn.coupling_db, generator) for line in (array.rx_m, array.tx_m))
            matrix = matrix @ np.kron(rx, tx)  # channels are rx-major
        leakage = np.zeros(array.channels, dtype=np.complex128)
        if drawn.leakage_db is not None:
            level = db_to_amplitude(generator.uniform(*drawn.leakage_db))
            leakage = np.where(dead, 0.0, level * np.exp(2j * np.pi * generator.random(array.channels)))
        return Board(
            matrix=factors[:, None] * matrix,
            moved_m=moved_m,
            delay_s=delay_s,
            calibrated_row=float(generator.uniform(*CALIBRATION_RANGE_M)) / self._radar.waveform.range_step_m,
            leakage=leakage,
            reported=float(db_to_power(drawn.reported_db * generator.standard_normal())),
            seed=int(generator.integers(2**62)),
        )

    def model_error(self, matrix: Complex128[np.ndarray, "channels channels"]) -> float:
        """Share of a plane wave's power that its best multiple does not explain after ``matrix``, mean over angles."""
        ideal = self._echoes[self._channels]
        found = matrix[self._channels] @ self._echoes
        energy = np.sum(np.abs(found) ** 2, axis=0)
        explained = np.abs(np.sum(ideal.conj() * found, axis=0)) ** 2 / len(ideal)
        # With all receivers dead there is nothing to explain.
        return float(np.mean(1.0 - explained / np.where(energy > 0, energy, np.inf)))

    def _turned(self, board: Board, row: Float64[np.ndarray, " rows"]) -> Complex128[np.ndarray, "rows channels"]:
        """[R, C] what the delays turn the channels by."""
        beat_hz = (row - board.calibrated_row) / self._radar.waveform.chirp_duration_s
        return np.exp(-2j * np.pi * beat_hz[:, None] * board.delay_s)

    def _recorded(
        self, board: Board, snapshots: torch.Tensor, noise_power: torch.Tensor, row: Float64[np.ndarray, " rows"]
    ) -> torch.Tensor:
        """[R, C] what one board records of [R, C]."""
        device, kind = snapshots.device, snapshots.dtype

        def moved(values: np.ndarray) -> torch.Tensor:
            return torch.from_numpy(values).to(device=device, dtype=kind)

        generator = torch.Generator(device).manual_seed(board.seed)
        # The largest is divided out: no product leaves single precision.
        unit = snapshots.abs().max().clamp_min(1e-30)
        seen = (snapshots / unit) @ moved(board.matrix).T * moved(self._turned(board, row))
        seen = seen + noise_power.sqrt().float() / unit * moved(hann_spectrum(row)[:, None] * board.leakage)
        seen = seen + self._sidebands(row, generator, device) @ seen
        if self._quantisation:
            strongest = seen.abs().square().sum(0).max().sqrt() * float(db_to_amplitude(self.imperfections.headroom_db))
            white = torch.randn(seen.shape, dtype=kind, device=device, generator=generator)
            seen = seen + strongest * float(np.sqrt(self._quantisation)) * white
        return seen * unit

    def _sidebands(
        self, row: Float64[np.ndarray, " rows"], generator: torch.Generator, device: torch.device
    ) -> torch.Tensor:
        """[to, from] D of the rows of a crop."""
        noise, waveform = self.imperfections.phase_noise, self._radar.waveform
        if noise is None:
            return torch.zeros(len(row), len(row), dtype=torch.complex64, device=device)
        duration_s, apart = waveform.chirp_duration_s, np.arange(len(row))[:, None] - np.arange(len(row))
        density = noise.density_per_hz(np.arange(1, len(row)) / duration_s) / duration_s  # [rad^2]
        deviation = torch.from_numpy(np.sqrt(self._doppler * density)).float().to(device)
        phase = torch.randn(len(row) - 1, dtype=torch.complex64, device=device, generator=generator) * deviation
        both = torch.cat([phase.conj().flip(0), phase.new_zeros(1), phase])  # Phi_m from -(R - 1) on
        turned = 1.0 - np.exp(-2j * np.pi * apart * row / (duration_s * waveform.bandwidth_hz))
        spread = both[torch.from_numpy(apart + len(row) - 1).to(device)]
        return 1j * spread * torch.from_numpy(turned.astype(np.complex64)).to(device)


def _coupled(
    elements: int, level_db: tuple[float, float], generator: np.random.Generator
) -> Complex128[np.ndarray, "{elements} {elements}"]:
    """Coupling of a line of elements to its nearest neighbours, of one level and phase for all."""
    coefficient = db_to_amplitude(generator.uniform(*level_db)) * np.exp(2j * np.pi * generator.random())
    beside = np.eye(elements, k=1) + np.eye(elements, k=-1)
    return np.eye(elements) + coefficient * beside
