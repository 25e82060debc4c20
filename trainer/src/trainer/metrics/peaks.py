"""What the peaks of an image row say of one target, of two, and of none.

Where they stand and how well that can be known, whether two targets are told apart, how wide a lobe is and what stands
beside it, and how many peaks noise alone makes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import find_peaks

from trainer.estimators.array import LineArray


def strongest_peaks(image: NDArray[np.floating], u: NDArray[np.floating], count: int) -> NDArray[np.float64]:
    """[R, count] angles of the largest local maxima of each row of an image [R, U], rising; NaN for those missing."""
    found = np.full((len(image), count), np.nan)
    for row, spectrum in enumerate(image):
        peaks, _ = find_peaks(spectrum)
        best = peaks[np.argsort(spectrum[peaks], kind="stable")[::-1][:count]]
        found[row, : len(best)] = np.sort(np.asarray(u)[best])
    return found


def resolved(found: NDArray[np.floating], true: NDArray[np.floating]) -> NDArray[np.bool_]:
    """[T] whether both errors are below half the separation; found and true are [T, 2], both rising."""
    half = 0.5 * (true[:, 1] - true[:, 0])
    # NaN, a target not found, compares false.
    return np.all(np.abs(found - true) < half[:, None], axis=1)


def single_source_bound(array: LineArray, snr: float) -> float:
    """Least variance of u for one source, 1 / (2 SNR k^2 sum (p - mean p)^2), k = 2 pi / lambda.

    :param snr: per channel, after range and Doppler processing, linear
    """
    spread = float(np.sum((array.positions_m - array.positions_m.mean()) ** 2))
    return 1.0 / (2.0 * snr * (2.0 * np.pi / array.wavelength_m) ** 2 * spread)


def noise_level(array: LineArray, noise_power: float, probability: float) -> float:
    """Magnitude that delay-and-sum of noise exceeds at any one angle with this probability [sqrt(W)].

    |I|^2 of noise is exponential of mean sigma^2 / C, so that the level is sqrt(-ln(probability) sigma^2 / C).
    """
    return float(np.sqrt(-np.log(probability) * noise_power / array.channels))


def false_alarms(image: NDArray[np.floating], level: float) -> int:
    """Local maxima above ``level`` [sqrt(W)] in the rows of an image [R, U] of noise alone; a plateau is one.

    Delay-and-sum has sqrt(-ln p) beta Delta u / sqrt(pi) p of them in a row, at the level of probability p << 1 (Rice
    1944; beta = k std(p_c), Delta u the axis).
    """
    return sum(len(find_peaks(row, height=level)[0]) for row in image)


@dataclass(frozen=True)
class PointSpread:
    """A main lobe, from its peak to the nearest minimum on either side, and what is beside it.

    :param u: interpolated angle of the peak
    :param width: -3 dB width in u; infinite where the lobe reaches the end of the axis
    :param pslr_db: largest magnitude outside the main lobe over the peak [dB], -inf where there is none
    :param islr_db: energy outside the main lobe over that inside [dB], -inf where there is none
    """

    u: float
    width: float
    pslr_db: float
    islr_db: float


def point_spread(spectrum: NDArray[np.floating], u: NDArray[np.floating]) -> PointSpread | None:
    """Width and sidelobes of the largest peak of magnitudes [U] at rising angles u [U]; None of an empty spectrum.

    Peak and -3 dB points are those of the cubic spline through the power |I|^2, which is band limited where the image
    is the magnitude of a beam; sidelobes are those of the samples. A lobe narrower than two bins is no better known
    than its samples: a single bin measures 1.2.
    """
    row = np.asarray(spectrum, dtype=np.float64)
    axis = np.asarray(u, dtype=np.float64)
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
