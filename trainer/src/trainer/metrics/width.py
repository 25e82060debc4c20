"""The point-spread function of one target: width, peak and integrated sidelobe ratio."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from shared.physics.errors import InputError


@dataclass(frozen=True)
class PointSpread:
    """A main lobe, from its peak to the nearest minimum on either side, and what is beside it.

    :param u: interpolated angle of the peak
    :param level: its interpolated magnitude
    :param width: -3 dB width in u; infinite where the lobe reaches the end of the axis
    :param pslr_db: largest magnitude outside the main lobe over the peak [dB], -inf where there is none
    :param islr_db: energy outside the main lobe over that inside [dB], -inf where there is none
    """

    u: float
    level: float
    width: float
    pslr_db: float
    islr_db: float


def point_spread(spectrum: NDArray[np.floating], u: NDArray[np.floating]) -> PointSpread | None:
    """Width and sidelobes of the largest peak of magnitudes [U] at rising angles u [U]; None of an empty spectrum.

    Peak and -3 dB points are those of the cubic spline through the power |I|^2, which is band limited where the image
    is the magnitude of a beam; sidelobes are those of the samples. A lobe narrower than two bins is no better known
    than its samples: a single bin measures 1.2.

    :raises InputError: fewer than 4 samples, or negative or not finite magnitudes
    """
    row = np.asarray(spectrum, dtype=np.float64)
    axis = np.asarray(u, dtype=np.float64)
    if row.ndim != 1 or row.shape != axis.shape or len(row) < 4 or not np.isfinite(row).all() or (row < 0.0).any():
        raise InputError("spectrum", f"shape {row.shape} on an axis {axis.shape}", "4 or more finite magnitudes on u")
    top = float(row.max())
    if top == 0.0:
        return None
    power = (row / top) ** 2
    place = int(np.argmax(power))
    first, last = _main_lobe(power, place)
    spline = CubicSpline(axis, power)
    near = slice(max(place - 1, 0), min(place + 1, len(row) - 1) + 1)
    turns = spline.derivative().roots(extrapolate=False)
    candidates = np.append(turns[(turns >= axis[near][0]) & (turns <= axis[near][-1])], axis[place])
    peak = float(candidates[np.argmax(spline(candidates))])
    peak_power = float(spline(peak))
    crossings = spline.solve(0.5 * peak_power, extrapolate=False)
    left, right = crossings[crossings < peak], crossings[crossings > peak]
    width = float(right.min() - left.max()) if len(left) and len(right) else float("inf")
    beside = np.concatenate([power[:first], power[last + 1 :]])
    return PointSpread(
        u=peak,
        level=top * float(np.sqrt(peak_power)),
        width=width,
        pslr_db=_power_db(float(beside.max(initial=0.0)) / peak_power),
        islr_db=_power_db(float(beside.sum()) / float(power[first : last + 1].sum())),
    )


def _main_lobe(power: NDArray[np.float64], place: int) -> tuple[int, int]:
    """First and last sample of the lobe around ``place``: as far as the samples fall."""
    rising = np.flatnonzero(np.diff(power[place:]) >= 0.0)
    falling = np.flatnonzero(np.diff(power[: place + 1]) <= 0.0)
    last = place + int(rising[0]) if len(rising) else len(power) - 1
    first = int(falling[-1]) + 1 if len(falling) else 0
    return first, last


def _power_db(ratio: float) -> float:
    return float(10.0 * np.log10(ratio)) if ratio > 0.0 else float("-inf")
