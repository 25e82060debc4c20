"""Cramer-Rao bounds of angles, and what MUSIC reaches; all are covariances of u = sin(azimuth).

Model: N snapshots x = A s + n, A = [a(u_1) .. a(u_K)], noise of power sigma^2 in each channel, D = dA/du, and
P_A_perp the projection off the span of A. Divide by cos(theta_i) cos(theta_j) for the covariance of the angles theta
themselves.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shared.physics.errors import InputError
from trainer.estimators.array import LineArray


def single_source_bound(array: LineArray, snr: float) -> float:
    """Least variance of u for one source, 1 / (2 SNR k^2 sum (p - mean p)^2), k = 2 pi / lambda.

    :param snr: per channel, after range and Doppler processing, linear
    :raises InputError: elements all at one place, or an SNR that is not positive
    """
    spread = float(np.sum((array.positions_m - array.positions_m.mean()) ** 2))
    if not (snr > 0.0 and spread > 0.0):
        raise InputError("bound", f"snr = {snr!r}, sum of squares {spread!r} m^2", "both positive")
    return 1.0 / (2.0 * snr * (2.0 * np.pi / array.wavelength_m) ** 2 * spread)


def deterministic_bound(
    array: LineArray,
    u: NDArray[np.floating],
    sources: NDArray[np.complexfloating],
    noise_power: float,
    snapshots: int = 1,
) -> NDArray[np.float64]:
    """[K, K] bound for unknown, fixed amplitudes: sigma^2 / (2 N) { Re[(D^H P_A_perp D) o S^T] }^-1.

    Stoica and Nehorai, "MUSIC, maximum likelihood, and Cramer-Rao bound", IEEE Trans. Acoust. Speech Signal Process.
    37(5), 1989. o is the product of elements.

    :param u: [K]
    :param sources: [K, K] S, the mean of s s^H over the snapshots [W]; s s^H itself for one
    :raises InputError: as many sources as channels, or sources at one angle
    """
    _, curvature = _manifold_and_curvature(array, u)
    return noise_power / (2.0 * snapshots) * _inverse((curvature * np.asarray(sources).T).real)


def stochastic_bound(
    array: LineArray,
    u: NDArray[np.floating],
    sources: NDArray[np.complexfloating],
    noise_power: float,
    snapshots: int,
) -> NDArray[np.float64]:
    """[K, K] bound for Gaussian amplitudes of covariance S: the deterministic one with S A^H R^-1 A S for S.

    Stoica and Nehorai, "Performance study of conditional and unconditional direction-of-arrival estimation", IEEE
    Trans. Acoust. Speech Signal Process. 38(10), 1990. R = A S A^H + sigma^2 I.

    :raises InputError: as many sources as channels, or sources at one angle
    """
    manifold, curvature = _manifold_and_curvature(array, u)
    covariance = manifold @ sources @ manifold.conj().T + noise_power * np.eye(array.channels)
    seen = sources @ manifold.conj().T @ np.linalg.solve(covariance, manifold @ sources)
    return noise_power / (2.0 * snapshots) * _inverse((curvature * seen.T).real)


def uncorrelated_bound(
    array: LineArray, u: NDArray[np.floating], powers: NDArray[np.floating], noise_power: float, snapshots: int
) -> NDArray[np.float64]:
    """[K, K] bound for Gaussian amplitudes known to be uncorrelated; more sources than channels may be possible.

    Fisher information J_ij = N tr(R^-1 dR/d_i R^-1 dR/d_j) of Gaussian data (Bangs 1971) over all u, powers and
    sigma^2.

    :param powers: [K] [W]
    :raises InputError: sources that the array cannot tell apart
    """
    manifold = array.manifold(u)
    covariance = (manifold * powers) @ manifold.conj().T + noise_power * np.eye(array.channels)
    inverse = np.linalg.inv(covariance)
    by_u = [power * _hermitian(d, a) for power, d, a in zip(powers, _derivative(array, u).T, manifold.T, strict=True)]
    by_power = [np.outer(a, a.conj()) for a in manifold.T]
    slopes = np.array([*by_u, *by_power, np.eye(array.channels)])
    whitened = inverse @ slopes
    information = snapshots * np.einsum("iab,jba->ij", whitened, whitened).real
    return _inverse(information)[: len(u), : len(u)]


def music_covariance(
    array: LineArray,
    u: NDArray[np.floating],
    sources: NDArray[np.complexfloating],
    noise_power: float,
    snapshots: int,
) -> NDArray[np.float64]:
    """[K, K] covariance of MUSIC's angles for many snapshots and K known.

    sigma^2 / (2 N) (H o I)^-1 Re[ H o (S^-1 + sigma^2 S^-1 (A^H A)^-1 S^-1)^T ] (H o I)^-1,  H = D^H P_A_perp D

    (Stoica and Nehorai 1989). There is no such thing for one snapshot: S has rank one.

    :raises InputError: as many sources as channels, sources at one angle, or coherent sources
    """
    manifold, curvature = _manifold_and_curvature(array, u)
    if np.linalg.matrix_rank(sources, hermitian=True) < len(sources):
        raise InputError("MUSIC", "coherent sources, whose covariance is singular", "a covariance of full rank")
    inverse = np.linalg.inv(sources)
    gram = np.linalg.inv(manifold.conj().T @ manifold)
    spread = inverse + noise_power * inverse @ gram @ inverse
    scale = 1.0 / np.diag(curvature).real
    return noise_power / (2.0 * snapshots) * scale[:, None] * (curvature * spread.T).real * scale[None, :]


def _derivative(array: LineArray, u: NDArray[np.floating]) -> NDArray[np.complex128]:
    """[C, K] D = dA/du = -j k p a."""
    return -2j * np.pi / array.wavelength_m * array.positions_m[:, None] * array.manifold(u)


def _manifold_and_curvature(
    array: LineArray, u: NDArray[np.floating]
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """A [C, K] and D^H P_A_perp D [K, K]."""
    if len(u) >= array.channels:
        raise InputError("bound", f"{len(u)} sources with {array.channels} channels", "fewer sources than channels")
    manifold, derivative = array.manifold(u), _derivative(array, u)
    basis, _ = np.linalg.qr(manifold)
    outside = derivative - basis @ (basis.conj().T @ derivative)
    return manifold, derivative.conj().T @ outside


def _hermitian(first: NDArray[np.complex128], second: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """first second^H + second first^H."""
    product = np.outer(first, second.conj())
    return product + product.conj().T


def _inverse(information: NDArray[np.float64]) -> NDArray[np.float64]:
    # Scaled to a unit diagonal, since angles and powers have different units.
    diagonal = np.diag(information)
    if (diagonal > 0.0).all():
        scale = 1.0 / np.sqrt(diagonal)
        unit = information * np.outer(scale, scale)
        if np.linalg.cond(unit) < 1e12:
            return np.linalg.inv(unit) * np.outer(scale, scale)
    raise InputError("bound", "a singular Fisher information", "sources that the array can tell apart")
