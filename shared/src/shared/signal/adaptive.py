"""Adaptive spectra of every range bin: where echoes are, whatever array has seen them, and what another sensor saw.

The snapshot x of C virtual elements at p is modelled as a superposition of uncorrelated echoes from all angles at once,

    x = sum_n s_n a_n + noise,    E|s_n|^2 = P_n,    a(u) = exp(-j k u p),    R = sum_n P_n a_n a_n^H + sigma^2 I

and each iteration, from delay-and-sum on, follows from q = a^H R^-1 x and s = a^H R^-1 a by one of two rules:

    "iaa"     P <- |q / s|^2      IAA-APES: Yardibi, Li, Stoica, Xue and Baggeroer, IEEE Trans. Aerosp. Electron. Syst.
                                  46(1), 2010. Smooth; two targets closer than about half a cell merge.
    "likes"   P <- P |q|^2 / s    MacKay's update of the marginal likelihood x^H R^-1 x + ln det R (MacKay, Neural
                                  Computation 4(3), 1992; Tipping, JMLR 1, 2001). Its fixed points are those of LIKES
                                  (Stoica and Babu, Signal Process. 92, 2012), whose step P |q| / sqrt(s) is its square
                                  root: 12 iterations do what takes LIKES 30. Sparse; resolves what the array can.

It assumes plane waves: right for the input array beyond some 5 m.

Given P the echoes have the mean P q a posteriori: :func:`virtual_view` says what the virtual sensor would see of it.

What is known beforehand of where echoes are, a prior w_n (:mod:`shared.signal.ego_motion`), multiplies P in each
iteration of "iaa", and :data:`PRIOR_EXPONENT` of it in each of "likes". Without one, or where it is 1, nothing changes.

One implementation for NumPy and torch, for all rows at once: in single precision a network's input, in double precision
what ``trainer.estimators`` are made of, on an axis as fine as their array asks for.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Complex64, Float, Float32, Float64, Int

from shared.radar import Radar
from shared.signal.imaging import sensor_weights
from shared.signal.signal import manifold

Array = Any
"""A NumPy array or a torch tensor; what goes in comes out."""

FLOOR = 1e-4
"""Least power of white noise, of the power in a row: the inverse then stays within single precision."""
DISTANCE_DIGITS = 8
"""Distances that agree to this many decimals of a wavelength count as equal."""
PRIOR_EXPONENT = 0.3
"""Of the prior in an iteration of "likes", which keeps what earlier ones did: the whole prior in each is too much."""
LEAST_POWER, MOST_POWER = 1e-10, 1e6
"""Of an angle, in units of the row's power: an angle that fell to nothing can be called back, and no square
overflows."""


def array_namespace(array: Array) -> Any:
    """The library that an array belongs to; torch is never imported for a NumPy array."""
    return np if isinstance(array, np.ndarray) else importlib.import_module(type(array).__module__.partition(".")[0])


@contextmanager
def one_thread(library: Any) -> Iterator[None]:
    """LAPACK on one thread: on small matrices two cost more than they save.

    Where another process has one of two cores, 1890 inverses of 18 x 18 take torch 0.03 to 1.5 s with two threads,
    which wait for each other at every matrix, and 0.014 s with one.
    """
    if not hasattr(library, "set_num_threads"):
        yield
        return
    threads = library.get_num_threads()
    library.set_num_threads(1)
    try:
        yield
    finally:
        library.set_num_threads(threads)


class AdaptiveTables(NamedTuple):
    """What follows from array and grid alone, for N scanned angles and the L distances between C elements.

    :param matched: [C, N] exp(j k u p)
    :param phases: [2, L, N] cosine and sine of k u l, l the distance
    :param pair: [C * C] which distance p_c - p_d has, row by row
    :param sign: [C * C] of p_c - p_d; 0 for elements at one place
    :param entry: [C * C] where R_cd stands among r(l), their conjugates and r(0) + sigma^2
    :param sums: [C * C, L] 1 for the pairs of each distance: their sums as a matrix product
    """

    matched: Complex[Array, "channels angles"]
    phases: Float[Array, "2 distances angles"]
    pair: Int[Array, " pairs"]
    sign: Float[Array, " pairs"]
    entry: Int[Array, " pairs"]
    sums: Float[Array, "pairs distances"]


def scanned_angles(radar: Radar) -> Float64[np.ndarray, " angles"]:
    """[N] angles u: first the image's, then others in the same steps as far as |u| = 1.

    The iteration would assign an echo from an angle that is not scanned to wrong angles.
    """
    grid = radar.grid
    below = np.arange(grid.u[0] - grid.step, -1.0, -grid.step)
    above = np.arange(grid.u[-1] + grid.step, 1.0, grid.step)
    return np.concatenate([grid.u, below, above])


def line_tables(
    positions_m: Float64[np.ndarray, " channels"],
    wavelength_m: float,
    u: Float64[np.ndarray, " angles"],
    digits: int = 15,
) -> AdaptiveTables:
    """Tables of elements at these places of a line on angles ``u``, in double precision, as NumPy arrays.

    :param digits: decimals of a wavelength that distances have
    """
    positions = positions_m / wavelength_m
    difference = (positions[:, None] - positions[None, :]).ravel()
    rounded = np.round(difference, DISTANCE_DIGITS)
    _, first, pair = np.unique(np.abs(rounded), return_index=True, return_inverse=True)
    phase = 2.0 * np.pi * np.outer(np.round(np.abs(difference[first]), digits), u)
    channels, distances, pair, sign = len(positions), len(phase), pair.reshape(-1), np.sign(rounded)
    entry = pair + distances * (sign < 0.0)
    entry[:: channels + 1] = 2 * distances
    return AdaptiveTables(
        matched=manifold(positions_m, wavelength_m, u).conj(),
        phases=np.stack([np.cos(phase), np.sin(phase)]),
        pair=pair,
        sign=sign,
        entry=entry,
        sums=np.equal.outer(pair, np.arange(distances)).astype(np.float64),
    )


def adaptive_tables(radar: Radar, channels: Int[np.ndarray, " channels"]) -> AdaptiveTables:
    """Tables of these channels of the radar's array on :func:`scanned_angles`, as NumPy arrays.

    Places count from their mean: the phase of q then does not turn with the place of the array.
    """
    positions_m = radar.array.virtual[channels, 1]
    centred, wavelength_m = positions_m - positions_m.mean(), radar.waveform.wavelength_m
    # A network's last digits follow from these distances, and the shipped weights were trained with them.
    found = line_tables(centred, wavelength_m, scanned_angles(radar), DISTANCE_DIGITS)
    return AdaptiveTables(
        found.matched.astype(np.complex64),
        found.phases.astype(np.float32),
        found.pair.astype(np.int64),
        found.sign.astype(np.float32),
        found.entry.astype(np.int64),
        found.sums.astype(np.float32),
    )


def view_table(
    radar: Radar, channels: Int[np.ndarray, " channels"], window: str
) -> Complex64[np.ndarray, "angles bins"]:
    """[N, U] what the virtual sensor sees of an echo of amplitude 1 from each scanned angle, far away.

    Its elements' ``window`` is the truth's. An echo's phase is that in the middle of these channels, as in
    :class:`AdaptiveTables`.
    """
    sensor, u = radar.virtual_sensor, scanned_angles(radar)
    wavelength_m = radar.waveform.wavelength_m
    seen = manifold(sensor.virtual[:, 1], wavelength_m, u).T @ sensor_weights(radar, window)
    middle_m = float(radar.array.virtual[channels, 1].mean())
    return (seen * np.exp(2j * np.pi / wavelength_m * middle_m * u)[:, None]).astype(np.complex64)


def adaptive_forms(
    power: Float[Array, "rows angles"],
    snapshot: Complex[Array, "rows channels"],
    loading: Float[Array, " rows"],
    tables: AdaptiveTables,
    floor: float = FLOOR,
    least: float = FLOOR,
) -> tuple[Complex[Array, "rows angles"], Float[Array, "rows angles"]]:
    """(q = a^H R^-1 x, s = a^H R^-1 a) [B, N] of powers [B, N] and snapshots [B, C], in the tables' precision.

    :param loading: [B] sigma^2
    :param floor: least sigma^2, of the power in a row; :param least: what is added to that
    """
    xp = array_namespace(snapshot)
    channels, (cosine, sine) = snapshot.shape[-1], tables.phases
    # The covariance depends on the distance alone: r(l) = sum_n P_n exp(-j k u_n l).
    real, imaginary = power @ cosine.T, power @ sine.T
    total = power.sum(-1)
    white = xp.maximum(loading, floor * total + least)
    apart, own = real - 1j * imaginary, real[:, :1] + white[:, None] + 0j
    covariance = xp.concatenate([apart, apart.conj(), own], 1)[:, tables.entry]
    with one_thread(xp):
        inverse = xp.linalg.inv(covariance.reshape(-1, channels, channels))
    filtered = (inverse @ snapshot[:, :, None])[:, :, 0] @ tables.matched
    # a^H M a = sum_l (Re m_l cos(k u l) - Im m_l sin(k u l)), m_l the sum of M_cd over p_c - p_d = +-l.
    flat = inverse.reshape(-1, channels * channels)
    form = (flat.real @ tables.sums) @ cosine - ((flat.imag * tables.sign) @ tables.sums) @ sine
    # It is at least C / trace(R). A smaller value comes from rounding.
    return filtered, xp.maximum(form, (1.0 / (total + white))[:, None])


def likes_ratio(filtered: Array, form: Array) -> Array:
    """[B, N] |q|^2 / s, by which the "likes" rule multiplies P; 1 where the iteration stands still."""
    return _squared(filtered) / form


def bounded_power(power: Array) -> Array:
    """Powers within :data:`LEAST_POWER` and :data:`MOST_POWER`."""
    return array_namespace(power).clip(power, LEAST_POWER, MOST_POWER)


def adaptive_powers(
    snapshot: Complex[Array, "rows channels"],
    loading: Float[Array, " rows"],
    tables: AdaptiveTables,
    iterations: int,
    prior: Float[Array, "rows angles"] | float = 1.0,
    floor: float = FLOOR,
    least: float = FLOOR,
) -> Float[Array, "rows angles"]:
    """[B, N] powers P after ``iterations`` by the "iaa" rule, of rows of about RMS 1, or 0; delay-and-sum after none.

    :param loading: [B] sigma^2, noise power over the row's
    :param prior: [B, N] how far echoes are expected at each angle, at most 1
    :param floor, least: see :func:`adaptive_forms`
    """
    power = _squared(snapshot @ tables.matched) / snapshot.shape[-1] ** 2
    for _ in range(iterations):
        filtered, form = adaptive_forms(power, snapshot, loading, tables, floor, least)
        power = _squared(filtered) / form**2 * prior
    return power


def adaptive_spectrum(
    rows: Complex64[Array, "*rows channels"],
    noise: Float32[Array, "*rows"],
    tables: AdaptiveTables,
    bins: int,
    iterations: int,
) -> Float32[Array, "*rows {bins}"]:
    """[..., bins] root of P by the "iaa" rule at the image's angles, in the rows' unit; zero rows give zeros.

    :param rows: [..., C] complex64 snapshots of RMS 1 or 0
    :param noise: [...] float32 sigma^2, noise power over the row's
    :param tables: of :func:`adaptive_tables`, on the rows' device
    :param iterations: after delay-and-sum; at 0 it is delay-and-sum
    """
    xp = array_namespace(rows)
    snapshot, loading = rows.reshape(-1, rows.shape[-1]), noise.reshape(-1)
    magnitude = xp.sqrt(adaptive_powers(snapshot, loading, tables, iterations))
    return magnitude[:, :bins].reshape(*rows.shape[:-1], bins)


def virtual_view(
    power: Float32[Array, "rows angles"],
    filtered: Complex64[Array, "rows angles"],
    view: Complex64[Array, "angles bins"],
) -> Float32[Array, "rows bins"]:
    """[B, U] |sum_n h_n(u) P_n q_n|, the virtual sensor's image of the expected echoes, given P and q of
    :func:`adaptive_forms`; h_n(u) is the sensor's response to an echo from u_n.

    :param view: of :func:`view_table`, on the powers' device
    """
    expected = _squared((power * filtered) @ view)
    # The root has no slope at zero, which a gradient would divide by.
    return array_namespace(power).sqrt(expected + LEAST_POWER) - LEAST_POWER**0.5


def _squared(values: Array) -> Array:
    """|z|^2, whose slope is finite at zero too."""
    return values.real**2 + values.imag**2
