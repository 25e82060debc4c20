"""The iterative adaptive spectrum of every range bin: where echoes are, whatever array has seen them.

IAA-APES (Yardibi, Li, Stoica, Xue and Baggeroer, IEEE Trans. Aerosp. Electron. Syst. 46(1), 2010) for one snapshot x of
C virtual elements at p, from delay-and-sum on:

    R = sum_n |s(u_n)|^2 a_n a_n^H + sigma^2 I,    s(u) = a(u)^H R^-1 x / a(u)^H R^-1 a(u),    a(u) = exp(-j k u p)

The iteration knows the elements' positions and divides a snapshot's power among all angles at once. That removes a
thinned array's ambiguities, and with them most of the difference between arrays. It assumes plane waves: right for the
input array beyond some 5 m. Two targets closer than about half a cell merge after a few iterations.

One implementation for NumPy and torch, in single precision and for all rows at once: a network's input.
``trainer.estimators.iaa`` is the estimator, in double precision, on an axis as fine as its array asks for.
"""

from __future__ import annotations

import importlib
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex64, Float32, Int, Int64

from shared.radar import Radar
from shared.signal.steering import manifold

Array = Any
"""A NumPy array or a torch tensor; what goes in comes out."""

FLOOR = 1e-4
"""Least power of white noise, of the power in a row: the inverse then stays within single precision."""
DISTANCE_DIGITS = 8
"""Distances that agree to this many decimals of a wavelength count as equal."""


class AdaptiveTables(NamedTuple):
    """What follows from array and grid alone, for N scanned angles and the L distances between C elements.

    :param matched: [C, N] complex64 conjugate of the manifold, exp(j k u p)
    :param phases: [2, L, N] float32 cosine and sine of k u l, l the distance
    :param pair: [C * C] int64 which distance p_c - p_d has, row by row
    :param sign: [C * C] float32 of p_c - p_d; 0 for elements at one place
    """

    matched: Complex64[Array, "channels angles"]
    phases: Float32[Array, "2 distances angles"]
    pair: Int64[Array, " pairs"]
    sign: Float32[Array, " pairs"]


def adaptive_tables(radar: Radar, channels: Int[np.ndarray, " channels"]) -> AdaptiveTables:
    """Tables of these channels of the radar's array, as NumPy arrays.

    The first scanned angles are the image's. Others in the same steps follow as far as |u| = 1: the iteration would
    assign an echo from an angle that is not scanned to wrong angles.
    """
    grid = radar.grid
    below = np.arange(grid.u[0] - grid.step, -1.0, -grid.step)
    above = np.arange(grid.u[-1] + grid.step, 1.0, grid.step)
    u = np.concatenate([grid.u, below, above])
    positions_m, wavelength_m = radar.array.virtual[channels, 1], radar.waveform.wavelength_m
    positions = positions_m / wavelength_m
    difference = np.round(positions[:, None] - positions[None, :], DISTANCE_DIGITS).ravel()
    distance, pair = np.unique(np.abs(difference), return_inverse=True)
    phase = 2.0 * np.pi * np.outer(distance, u)
    return AdaptiveTables(
        manifold(positions_m, wavelength_m, u).conj().astype(np.complex64),
        np.stack([np.cos(phase), np.sin(phase)]).astype(np.float32),
        pair.reshape(-1).astype(np.int64),
        np.sign(difference).astype(np.float32),
    )


def adaptive_spectrum(
    rows: Complex64[Array, "*rows channels"],
    noise: Float32[Array, "*rows"],
    tables: AdaptiveTables,
    bins: int,
    iterations: int,
) -> Float32[Array, "*rows {bins}"]:
    """[..., bins] magnitude of the adaptive spectrum at the image's angles, in the rows' unit; zero rows give zeros.

    :param rows: [..., C] complex64 snapshots of RMS 1 or 0
    :param noise: [...] float32 sigma^2, noise power over the row's
    :param tables: of :func:`adaptive_tables`, on the rows' device
    :param iterations: after delay-and-sum; at 0 it is delay-and-sum
    """
    xp = np if isinstance(rows, np.ndarray) else importlib.import_module("torch")
    channels, (cosine, sine) = rows.shape[-1], tables.phases
    shape, snapshot = rows.shape[:-1], rows.reshape(-1, channels)
    loading = noise.reshape(-1)
    identity = xp.eye(channels, dtype=cosine.dtype, device=rows.device)
    # [C * C, L]: sums over the pairs of one distance as a matrix product.
    sums = xp.asarray(tables.pair[:, None] == xp.arange(len(cosine), device=rows.device), dtype=cosine.dtype)
    magnitude = xp.abs(snapshot @ tables.matched) / channels
    for _ in range(iterations):
        power = magnitude * magnitude
        # The covariance depends on the distance alone: r(l) = sum_n P_n exp(-j k u_n l).
        real, imaginary = power @ cosine.T, power @ sine.T
        covariance = real[:, tables.pair] - 1j * (imaginary[:, tables.pair] * tables.sign)
        total = power.sum(-1)
        white = xp.maximum(loading, FLOOR * total + FLOOR)
        inverse = xp.linalg.inv(covariance.reshape(-1, channels, channels) + white[:, None, None] * identity)
        numerator = xp.abs((inverse @ snapshot[:, :, None])[:, :, 0] @ tables.matched)
        # a^H M a = sum_l (Re m_l cos(k u l) - Im m_l sin(k u l)), m_l the sum of M_cd over p_c - p_d = +-l.
        flat = inverse.reshape(-1, channels * channels)
        form = (flat.real @ sums) @ cosine - ((flat.imag * tables.sign) @ sums) @ sine
        # It is at least C / trace(R). A smaller value comes from rounding.
        magnitude = numerator / xp.maximum(form, (1.0 / (total + white))[:, None])
    return magnitude[:, :bins].reshape(*shape, bins)
