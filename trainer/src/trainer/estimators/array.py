"""What every estimator shares: the line of virtual elements, its manifold, the angles that it can tell apart.

Signal model, for one range bin after range and Doppler processing (plane waves, one snapshot):

    x_c = sum_k s_k exp(-j k u_k p_c) + n_c,    k = 2 pi / lambda,    p_c = y_tx + y_rx,    u = sin(azimuth)

with the sign and the mid-sweep wavelength of :func:`shared.signal.signal.manifold`, so that a target on the left
peaks at u > 0. Valid from about 5 m for the input array of 94 mm; nearer than that the wave front is curved: by
exp(j k (1 - u^2) q_c / R), q_c = (y_tx^2 + y_rx^2) / 2 (Fresnel), which the fit of a frame's detections takes in.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.physics.errors import InputError
from shared.radar import Radar
from shared.signal.signal import manifold

FINEST_DIVISION = 8
"""A common spacing is sought among the smallest gap between two elements and its parts down to this one."""
SPACING_TOLERANCE = 1e-3
"""Of a wavelength: elements nearer than that to a grid are on it (0.4 degrees of phase)."""
POINTS_PER_CELL = 8
"""Scanned angles in a resolution cell where the caller asks for none; half a step off costs 0.06 dB of a peak."""
ROWS_AT_ONCE = 64
"""Range bins solved together: covariances of 48 channels then take some 2 MB."""
LARGEST_RELATIVE_NOISE = 1e6
"""Noise amplitude over a row's largest element; more is no different to any estimator and would overflow in some."""


NoisePower = float | NDArray[np.float64]
"""Of one channel [W]: one number for all range bins, or [R] one for each, :func:`shared.signal.model_error.row_noise`
of measured ones."""


@dataclass(frozen=True, eq=False)
class LineArray:
    """Virtual elements along y.

    :param positions_m: [C] y_tx + y_rx of each virtual channel relative to the radar's origin [m]
    :param wavelength_m: at mid-sweep [m]
    :param bend_m2: [C] q_c [m^2]; None for plane waves
    :param elements: [2, C] numbers of each channel's TX and RX; None where they are not known
    :raises InputError: no element, a position that is not finite, a wavelength that is not positive
    """

    positions_m: NDArray[np.float64]
    wavelength_m: float
    bend_m2: NDArray[np.float64] | None = None
    elements: NDArray[np.intp] | None = None

    def __post_init__(self) -> None:
        positions = np.asarray(self.positions_m, dtype=np.float64)
        if positions.ndim != 1 or not len(positions) or not np.isfinite(positions).all():
            raise InputError("array", f"positions_m of shape {positions.shape}", "one or more finite positions [m]")
        if not (np.isfinite(self.wavelength_m) and self.wavelength_m > 0.0):
            raise InputError("array", f"wavelength_m = {self.wavelength_m!r}", "a positive number of metres")
        object.__setattr__(self, "positions_m", positions)

    @property
    def channels(self) -> int:
        """Number of virtual elements."""
        return len(self.positions_m)

    @property
    def tells_no_angle(self) -> bool:
        """Whether all elements stand at one place along y."""
        return float(np.ptp(self.positions_m)) <= SPACING_TOLERANCE * self.wavelength_m

    @property
    def spacing_m(self) -> float | None:
        """Largest spacing of a grid that holds all elements [m]; None where there is no such grid.

        The manifold repeats every lambda / spacing in u, but for one phase common to all elements.
        """
        offsets = np.sort(self.positions_m) - self.positions_m.min()
        gaps = np.diff(offsets)
        gaps = gaps[gaps > SPACING_TOLERANCE * self.wavelength_m]
        if not len(gaps):
            return None
        for division in range(1, FINEST_DIVISION + 1):
            spacing = gaps.min() / division
            # The smallest gap carries its own rounding; the mean over the span does not.
            spacing = offsets[-1] / max(round(offsets[-1] / spacing), 1)
            misfit = np.abs(offsets - spacing * np.round(offsets / spacing)).max()
            if misfit <= SPACING_TOLERANCE * self.wavelength_m:
                return float(spacing)
        return None

    @property
    def half_period(self) -> float:
        """Largest |u| that the array tells apart, lambda / (2 spacing), and at most 1: 0.967 for 2 mm at 77.5 GHz."""
        spacing = self.spacing_m
        return 1.0 if spacing is None else min(0.5 * self.wavelength_m / spacing, 1.0)

    @property
    def resolution_cell(self) -> float:
        """Resolution cell lambda / (span + spacing) in u, half a wavelength standing for a spacing there is none."""
        return self.wavelength_m / (float(np.ptp(self.positions_m)) + (self.spacing_m or 0.5 * self.wavelength_m))

    def manifold(self, u: NDArray[np.floating] | float) -> NDArray[np.complex128]:
        """[C, *u.shape] echoes exp(-j k u p) of unit amplitude from the directions u."""
        return manifold(self.positions_m, self.wavelength_m, np.asarray(u))

    def bend_phase(self, range_m: NDArray[np.floating]) -> NDArray[np.float64]:
        """[*range_m.shape, C] k q_c / R [rad], by which an echo from straight ahead is bent."""
        bend = np.zeros(self.channels) if self.bend_m2 is None else self.bend_m2
        return 2.0 * np.pi / self.wavelength_m * bend / np.asarray(range_m, dtype=np.float64)[..., None]

    def ghost_share(self, apart: NDArray[np.floating]) -> NDArray[np.float64]:
        """[N] power of a line ``apart`` in u from an echo, by errors of single elements, over echo and model error.

        Let each channel err by the sum of what its TX and its RX err, independent of each other, of equal power, and of
        the share e of the echo's power P together. The best line at a distance d in u from the echo is then
        s = mean_c err_c exp(j k d p_c), and

            E |s|^2 / (e P) = 1 / (2 C^2) (sum_TX |sum_c exp(j k d p_c)|^2 + sum_RX |sum_c exp(j k d p_c)|^2)

        with the inner sums over the channels of one TX or one RX. Errors independent from channel to channel would give
        1 / C; here the lobes of the smaller array stand in it, up to 1 / (2 TX) and 1 / (2 RX). 0 where the elements
        are not known.
        """
        share = np.zeros(len(apart))
        turned = self.manifold(apart)
        for element in () if self.elements is None else self.elements:
            of_one = np.equal.outer(np.unique(element), element)
            share += np.sum(np.abs(of_one @ turned) ** 2, axis=0)
        return share / (2.0 * self.channels**2)


def line_array(radar: Radar, channels: NDArray[np.intp] | None = None) -> LineArray:
    """The virtual elements of a radar, in its rx-major channel order.

    :param channels: indices of the virtual elements to use; all by default
    """
    array, used = radar.array, slice(None) if channels is None else channels
    bend = 0.5 * (array.tx[array.channel_tx, 1] ** 2 + array.rx[array.channel_rx, 1] ** 2)
    elements = np.stack([array.channel_tx, array.channel_rx])[:, used]
    return LineArray(array.virtual[used, 1], radar.waveform.wavelength_m, bend[used], elements)


def scan_axis(array: LineArray, u: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """(angles [N] that cover one period of the array, [U] where among them each of ``u`` stands).

    The angles asked for, brought into the first period, and between and beyond them others at
    :data:`POINTS_PER_CELL` to a resolution cell. A method that explains the snapshot by a superposition of angles
    needs them all: what comes from an angle it may not use, it would explain by wrong ones.
    """
    half = array.half_period
    asked = np.asarray(u, dtype=np.float64)
    periodic = array.spacing_m is not None and half < 1.0
    wrapped = (asked + half) % (2.0 * half) - half if periodic else asked
    scanned, shown = np.unique(wrapped, return_inverse=True)
    others = uniform_axis(array, POINTS_PER_CELL)
    place = np.searchsorted(scanned, others)
    below = scanned[np.maximum(place - 1, 0)] if len(scanned) else np.full(len(others), np.inf)
    above = scanned[np.minimum(place, len(scanned) - 1)] if len(scanned) else below
    away = np.minimum(np.abs(others - below), np.abs(others - above))
    others = others[away > 0.5 * array.resolution_cell / POINTS_PER_CELL]
    return np.concatenate([scanned, others]), shown.reshape(-1)


def uniform_axis(array: LineArray, points_per_cell: float) -> NDArray[np.float64]:
    """[N] angles over one period, about ``points_per_cell`` to a resolution cell, without the period's end."""
    half = array.half_period
    count = max(round(2.0 * half / array.resolution_cell * points_per_cell), 2)
    return -half + 2.0 * half / count * np.arange(count, dtype=np.float64)


Solver = Callable[..., NDArray[np.float64]]
"""([B, C] snapshots of largest element 1, [B] noise power in their scale) to [B, U] magnitudes; a third argument is
what else is known of these rows."""


def image_rows(
    snapshots: NDArray[np.complexfloating],
    array: LineArray,
    bins: int,
    noise_power: NoisePower,
    solve: Solver,
    known: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """[R, bins] magnitudes of ``solve`` in the snapshots' unit, zero where the snapshot is zero.

    Every row is solved at a largest element of 1, so that neither 1e-20 nor 1e20 sqrt(W) leaves the range of numbers.

    :param snapshots: [R, C] one for each range bin [sqrt(W)]
    :param noise_power: of one channel [W], of all rows or of each; 0 where there is none
    :param known: [R, ...] what else ``solve`` is told of each row
    :raises InputError: of another shape, not finite, or negative noise power
    """
    check_snapshots(snapshots, array)
    noise = row_powers(noise_power, len(snapshots))
    image = np.zeros((len(snapshots), bins))
    for block, x, scale in scaled_blocks(snapshots):
        # The quotient comes before the square: the square of 1e-200 would be zero.
        relative = np.minimum(np.sqrt(noise[block]) / scale[:, 0], LARGEST_RELATIVE_NOISE) ** 2
        told = () if known is None else (known[block],)
        image[block] = scale * solve(x, relative, *told)
    return image


def scaled_blocks(
    snapshots: NDArray[np.complexfloating],
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.complex128], NDArray[np.float64]]]:
    """(Places [B], rows of largest element 1 [B, C], their scale [B, 1]) of snapshots [R, C] that are not zero."""
    rows = np.asarray(snapshots, dtype=np.complex128)
    scale = np.abs(rows).max(axis=1, keepdims=True)
    present = np.flatnonzero(scale > 0.0)
    for start in range(0, len(present), ROWS_AT_ONCE):
        block = present[start : start + ROWS_AT_ONCE]
        yield block, rows[block] / scale[block], scale[block]


def row_powers(noise_power: NoisePower, rows: int) -> NDArray[np.float64]:
    """[R] noise power of each of so many rows [W].

    :raises InputError: of another shape, not finite or negative
    """
    powers = np.asarray(noise_power, dtype=np.float64)
    if powers.shape not in ((), (rows,)):
        raise InputError("noise_power", f"shape {powers.shape}", f"one power, or one for each of {rows} rows")
    wrong = powers[~(np.isfinite(powers) & (powers >= 0.0))]
    if wrong.size:
        raise InputError("noise_power", repr(float(wrong.flat[0])), "a finite power of at least 0 W")
    return np.broadcast_to(powers, (rows,))


def check_snapshots(snapshots: NDArray[np.complexfloating], array: LineArray) -> None:
    """Refuse snapshots that are not [R, C] or not finite.

    :raises InputError: naming the first such row
    """
    shape = np.shape(snapshots)
    if len(shape) != 2 or shape[1] != array.channels:
        raise InputError("snapshots", f"shape {shape}", f"[range bins, {array.channels} channels]")
    faults = np.flatnonzero(~np.isfinite(snapshots).all(axis=1))
    if len(faults):
        raise InputError("snapshots", f"{len(faults)} rows not finite, the first is row {faults[0]}", "finite numbers")


def draw_lines(
    u_found: NDArray[np.float64], amplitude: NDArray[np.float64], array: LineArray, u: NDArray[np.floating]
) -> NDArray[np.float64]:
    """[B, U] magnitudes with each line in the bin nearest to it, the larger one where two share a bin.

    Lines more than half a bin beyond the ends of ``u`` are not shown, and lines of amplitude 0 are none.

    :param u_found: [B, K] angles of the lines
    :param amplitude: [B, K] their magnitudes, 0 for none
    :param u: [U] rising
    """
    axis = np.asarray(u, dtype=np.float64)
    image = np.zeros((len(u_found), len(axis)))
    if not len(axis) or not u_found.shape[1]:
        return image
    step = float(np.median(np.diff(axis))) if len(axis) > 1 else array.resolution_cell
    edges = 0.5 * (axis[1:] + axis[:-1])
    place = np.searchsorted(edges, u_found, side="right")
    shown = (amplitude > 0.0) & (np.abs(u_found - axis[place]) <= step)
    inside = (u_found >= axis[0] - 0.5 * step) & (u_found <= axis[-1] + 0.5 * step)
    row, line = np.nonzero(shown & inside)
    np.maximum.at(image, (row, place[row, line]), amplitude[row, line])
    return image
