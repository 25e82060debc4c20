"""Which paths an image row sees in its Doppler cell.

Of the paths within ROW_REACH bins of a row and DOPPLER_REACH of its Doppler cell (beyond, Hann's skirts lie below -74
and -64 dB), those that are weakest there and hold together less than NEGLECTED_DB of the row's power are left out of
it. A path that no row of a Doppler cell wants is not evaluated for this cell. Powers are added incoherently.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Int64

from datafactory.synthesis.mid_frame import MidFrame
from shared.physics.compiled import compiled
from shared.radar import Radar

ROW_REACH = 12
"""Range bins: Hann's skirts lie below -74 dB there."""
DOPPLER_REACH = 8.0
"""Doppler bins: they lie below -64 dB there."""
NEGLECTED_DB = -65.0
"""Power of the paths that are left out of a row, over that of all, incoherently summed: 15 dB below the terms' errors.
On munich at 2.5 m/s half of the pairs of path and Doppler cell remain; at -50 dB, a quarter fewer."""
NEGLECTED, LEVELS = 10.0 ** (NEGLECTED_DB / 10.0), 140
"""The same as a ratio; levels of 1 dB that are told apart."""


def seen_paths(
    mid: MidFrame, radar: Radar, doppler_cells: Int64[np.ndarray, " rows"]
) -> Bool[np.ndarray, "chirps paths"]:
    """For each Doppler cell the paths that are seen in one of its rows.

    :param mid: paths in the order of their folded range
    :param doppler_cells: [rows] index on the radar's velocity axis for each image row
    """
    waveform = radar.waveform
    seen = np.zeros((waveform.chirps, len(mid.amplitude)), dtype=bool)
    # An element may see a path nearer to the cell than the centre does, and curvature widens its line.
    slack = mid.departure + np.abs(mid.curvature)
    _mark_seen(
        mid.range_bins % waveform.samples, mid.doppler, slack, np.abs(mid.amplitude) ** 2, doppler_cells,
        min(float(ROW_REACH), 0.5 * waveform.samples), float(waveform.samples), seen,
    )  # fmt: skip
    return seen


@compiled(cache=False, inline="always", error_model="numpy")
def _hann_power(bins):
    """Power of the Hann window's response this far from its peak, the envelope of the sidelobes beyond 1.5 bins.

    Harris, Proc. IEEE 66, 51 (1978): sin(pi x) / (pi x (1 - x^2)), here its main lobe to 1.5 bins as the power of a
    cosine, which is right at 0 and 1 and at most 1.4 dB off.
    """
    if bins < 1.5:
        return np.cos(0.25 * np.pi * bins) ** 4
    return 1.0 / (np.pi * bins * (bins * bins - 1.0)) ** 2


@compiled(nogil=True, error_model="numpy")
def _mark_seen(bins, doppler, slack, power, doppler_cells, reach, samples, seen):
    """Mark in ``seen`` [chirps, paths] what each row sees in its Doppler cell.

    A row's paths are counted in levels of 1 dB below the row's power. From the weakest on, levels are left out while
    they hold together less than NEGLECTED_DB.
    """
    chirps, count = seen.shape
    part, held = np.empty(count), np.empty(LEVELS)
    for row in range(len(doppler_cells)):
        cell = doppler_cells[row]
        frequency = cell - chirps // 2
        total = 0.0
        # Cyclic: what lies beyond one end of the axis stands at the other.
        first = np.searchsorted(bins, (row - reach) % samples)
        size = 0
        while size < count:
            k = (first + size) % count
            offset = bins[k] - row
            offset = abs(offset - samples * np.floor(offset / samples + 0.5))
            if offset > reach:
                break
            delta = doppler[k] - frequency
            delta = abs(delta - chirps * np.floor(delta / chirps + 0.5))
            part[size] = 0.0
            if delta <= DOPPLER_REACH:
                part[size] = power[k] * _hann_power(offset) * _hann_power(max(delta - slack[k], 0.0))
            total += part[size]
            size += 1
        if total <= 0.0:
            continue
        held[:] = 0.0
        for index in range(size):
            if part[index] > 0.0:
                level = min(int(10.0 * np.log10(total / part[index])), LEVELS - 1)
                held[level] += part[index]
        least, left_out = LEVELS, 0.0
        while least > 1 and left_out + held[least - 1] <= NEGLECTED * total:
            least -= 1
            left_out += held[least]
        for index in range(size):
            if part[index] > 0.0 and min(int(10.0 * np.log10(total / part[index])), LEVELS - 1) < least:
                seen[cell, (first + index) % count] = True
