"""The paper's three arrays, and snapshots of them: plane waves of targets at known angles, and white noise."""

import numpy as np
from numpy.typing import NDArray

from shared.radar import Radar
from trainer.data.arrays import choose_array
from trainer.estimators.array import LineArray, line_array

RADAR = Radar()
U = RADAR.grid.u
ARRAYS = {name: line_array(RADAR, choose_array(name, RADAR).channels(RADAR)) for name in ("full", "sparse6", "sparse4")}
FAR = RADAR.model_copy(
    update={
        "waveform": RADAR.waveform.model_copy(
            update={
                "samples": 128, "range_bins": 128, "chirps": 1, "bandwidth_hz": RADAR.waveform.bandwidth_hz / 128.0,
            }
        )
    }
)  # fmt: skip
"""Range bins of 19 m: simulated trials cost a fiftieth, and from the second one on, at 250 m, the waves are plane."""
IRREGULAR = LineArray(np.array([0.0, 3.1e-3, 7.7e-3, 9.0e-3, 16.3e-3, 20.0e-3]), RADAR.waveform.wavelength_m)
"""Elements on no common grid."""


def half_wavelength_line(elements: int) -> LineArray:
    """A line of elements half a wavelength apart, from the origin on."""
    return LineArray(0.5 * np.arange(float(elements)), 1.0)


def echoes(
    array: LineArray, u: NDArray[np.floating], amplitudes: NDArray[np.complexfloating]
) -> NDArray[np.complex128]:
    """[R, C] noise-free snapshots of targets at u [R, K] with complex amplitudes [R, K] [sqrt(W)]."""
    return np.asarray(np.einsum("crk,rk->rc", array.manifold(u), amplitudes), dtype=np.complex128)


def noise(array: LineArray, rows: int, noise_power: float, generator: np.random.Generator) -> NDArray[np.complex128]:
    """[rows, C] circular white Gaussian noise of ``noise_power`` [W] in each channel."""
    parts = generator.standard_normal((rows, array.channels, 2))
    return np.asarray(np.sqrt(0.5 * noise_power) * (parts[..., 0] + 1j * parts[..., 1]), dtype=np.complex128)


def some_rows(array: LineArray, rows: int = 5, targets: int = 3, noise_power: float = 1e-3) -> NDArray[np.complex128]:
    """[rows, C] snapshots of targets of unit amplitude at random angles, in noise."""
    generator = np.random.default_rng(7)
    u = generator.uniform(-0.8, 0.8, (rows, targets))
    amplitudes = np.exp(2j * np.pi * generator.random((rows, targets)))
    return echoes(array, u, amplitudes) + noise(array, rows, noise_power, generator)


def lines_image(places: list[list[int]], width: float = 1.0) -> NDArray[np.float64]:
    """[rows, 450] images of Gaussian lines of equal height."""
    bins = np.arange(len(U))
    return np.array([sum((np.exp(-0.5 * ((bins - p) / width) ** 2) for p in row), np.zeros(len(U))) for row in places])


def deterministic_bound(
    array: LineArray,
    u: NDArray[np.floating],
    sources: NDArray[np.complexfloating],
    noise_power: float,
    snapshots: int = 1,
) -> NDArray[np.float64]:
    """[K, K] least covariance of u for unknown, fixed amplitudes: sigma^2 / (2 N) { Re[(D^H P_A_perp D) o S^T] }^-1.

    Stoica and Nehorai, "MUSIC, maximum likelihood, and Cramer-Rao bound", IEEE Trans. Acoust. Speech Signal Process.
    37(5), 1989. D = dA/du, P_A_perp projects off the span of A, o is the product of elements.

    :param sources: [K, K] S, the mean of s s^H over the snapshots [W]; s s^H itself for one
    """
    manifold = array.manifold(u)
    derivative = -2j * np.pi / array.wavelength_m * array.positions_m[:, None] * manifold
    basis, _ = np.linalg.qr(manifold)
    outside = derivative - basis @ (basis.conj().T @ derivative)
    information = ((derivative.conj().T @ outside) * np.asarray(sources).T).real
    return np.asarray(noise_power / (2.0 * snapshots) * np.linalg.inv(information))
