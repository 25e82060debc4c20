"""Paths at mid-frame, where the truth develops their delays: as the virtual sensor sees them, and which a row sees.

Of a leg l and its derivatives (:func:`datafactory.synthesis.motion.leg_of`), with f_0 the reference frequency and T
the frame, the Doppler is f_0 T l' / c bins and the curvature f_0 T^2 l'' / (2 c) cycles. The third derivative is left
out.

Of the paths within ROW_REACH bins of an image row and DOPPLER_REACH of its Doppler cell, those that are weakest there
and hold together less than NEGLECTED_DB of the row's power are left out of it. Beyond, Hann's skirts lie below -74 and
-64 dB; but what passes by near and fast is wider: at 3 m and 30 m/s it is missed in rows of other Doppler cells where
it has -26 dB. A path that no row of a Doppler cell wants is not evaluated for this cell. Powers are added incoherently.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int64

from datafactory.paths.table import ScatteredPaths
from datafactory.synthesis.doppler_moments import BLOCK
from datafactory.synthesis.motion import coupling, instants, leg_of
from shared.physics.compiled import compiled, inlined
from shared.physics.units import SPEED_OF_LIGHT
from shared.physics.vectors import lengths, taken
from shared.radar import Radar
from shared.signal.sweep import reference_frequency_hz

ROW_REACH = 12
"""Range bins: Hann's skirts lie below -74 dB there."""
DOPPLER_REACH = 8.0
"""Doppler bins: they lie below -64 dB there."""
NEGLECTED_DB = -60.0
"""Power of the paths that are left out of a row, over that of all, incoherently summed: 30 dB below the default error
budget. With -65 dB munich frames have a tenth more pairs of path and Doppler cell, with -50 dB a quarter fewer."""
NEGLECTED, LEVELS = 10.0 ** (NEGLECTED_DB / 10.0), 140
"""The same as a ratio; levels of 1 dB that are told apart."""


class MidFrame(NamedTuple):
    """Paths at mid-frame, as seen by one TX: the input of the kernel.

    :param rx_point: [m]; ``rx_velocity`` [m/s]
    :param tx_length, tx_rate: length before the RX leg [m] and its rate [m/s]
    :param curvature: q [cycles], seen from the array's centre
    :param doppler: f [bins], unwrapped, seen from the array's centre
    :param range_bins: x = B tau seen from the array's centre, at the time of the beat frequency
    :param amplitude: [sqrt(W)]
    :param spread: largest distance of an element's Doppler from that of its block of BLOCK elements [bins]
    :param migration: range bins that the path crosses within the frame
    """

    rx_point: Float64[np.ndarray, "paths 3"]
    rx_velocity: Float64[np.ndarray, "paths 3"]
    tx_length: Float64[np.ndarray, " paths"]
    tx_rate: Float64[np.ndarray, " paths"]
    curvature: Float64[np.ndarray, " paths"]
    doppler: Float64[np.ndarray, " paths"]
    range_bins: Float64[np.ndarray, " paths"]
    amplitude: Complex128[np.ndarray, " paths"]
    spread: Float64[np.ndarray, " paths"]
    migration: Float64[np.ndarray, " paths"]

    @property
    def departure(self) -> Float64[np.ndarray, " paths"]:
        """Largest distance of an element's Doppler from the point of expansion, with migration [bins]: Hann gives the
        sweep's ends no weight. Its standard deviation of nu is 0.18, and twice that holds 96 % of the weight."""
        return self.spread + 0.36 * self.migration

    def take(self, index: Int64[np.ndarray, " chosen"]) -> MidFrame:
        """The paths at these indices."""
        return MidFrame(**{name: taken(getattr(self, name), index) for name in self._fields})


def at_mid_frame(
    paths: ScatteredPaths,
    radar: Radar,
    tx: Float64[np.ndarray, " 3"],
    centre: Float64[np.ndarray, " 3"],
    intra_chirp: bool,
) -> MidFrame:
    """Paths at mid-frame.

    :param tx: [3] the virtual sensor's only TX; :param centre: [3] of its RX [m]
    :param intra_chirp: motion within the chirp
    """
    waveform = radar.waveform
    after, lead = instants(radar, intra_chirp)
    time = waveform.chirps // 2 * waveform.chirp_interval_s + after
    frame_s = waveform.chirps * waveform.chirp_interval_s
    rx_point = paths.rx_point + paths.rx_velocity * time
    tx_leg = leg_of(paths.tx_point, paths.tx_velocity, time, tx)
    rx_leg = leg_of(paths.rx_point, paths.rx_velocity, time, centre)
    tx_length = tx_leg.length + paths.between_m + paths.between_rate_mps * time
    tx_rate = tx_leg.rate + paths.between_rate_mps
    cycles_per_metre = reference_frequency_hz(radar) / SPEED_OF_LIGHT
    doppler = cycles_per_metre * (tx_rate + rx_leg.rate) * frame_s
    return MidFrame(
        rx_point=rx_point,
        rx_velocity=paths.rx_velocity,
        tx_length=tx_length,
        tx_rate=tx_rate,
        curvature=0.5 * cycles_per_metre * (tx_leg.bend + rx_leg.bend) * frame_s**2,
        doppler=doppler,
        range_bins=waveform.bandwidth_hz
        / SPEED_OF_LIGHT
        * (tx_length + rx_leg.length + lead * (tx_rate + rx_leg.rate)),
        amplitude=paths.amplitude,
        spread=cycles_per_metre
        * lengths(paths.rx_velocity)
        * (0.5 * BLOCK * SPEED_OF_LIGHT / (2.0 * waveform.carrier_hz))
        / np.maximum(lengths(rx_point), 0.5)
        * frame_s,
        migration=np.abs(doppler) * coupling(radar),
    )


def seen_paths(
    mid: MidFrame, smeared: Float64[np.ndarray, " paths"], radar: Radar, doppler_cells: Int64[np.ndarray, " rows"]
) -> Bool[np.ndarray, "chirps paths"]:
    """For each Doppler cell the paths that are seen in one of its rows.

    :param mid: paths in the order of their folded range
    :param smeared: range and Doppler bins to either side over which migration spreads an echo
    :param doppler_cells: [rows] index on the radar's velocity axis for each image row
    """
    waveform = radar.waveform
    seen = np.zeros((waveform.chirps, len(mid.amplitude)), dtype=bool)
    # An element may see a path nearer to the cell than the centre does, and curvature widens its line.
    slack = mid.departure + np.abs(mid.curvature)
    _mark_seen(
        mid.range_bins % waveform.samples, mid.doppler, slack, smeared, np.abs(mid.amplitude) ** 2, doppler_cells,
        min(ROW_REACH + float(smeared.max(initial=0.0)), 0.5 * waveform.samples), float(waveform.samples), seen,
    )  # fmt: skip
    return seen


_FAST = {"contract", "nsz", "arcp", "reassoc"}
_C2, _C4, _C6, _C8, _C10 = -1.0 / 2.0, 1.0 / 24.0, -1.0 / 720.0, 1.0 / 40320.0, -1.0 / 3628800.0
_DB_AN_OCTAVE, _DB_OF_LOG = 10.0 * np.log10(2.0), 20.0 / np.log(10.0)
_MANTISSA, _EXPONENT_OF_ONE = np.int64(2**52 - 1), np.int64(1023 * 2**52)
LEAST_RATIO = 1e-290
"""Of powers that are told from none."""


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _hann_power(bins):
    """Power of the Hann window's response this far from its peak, the envelope of the sidelobes beyond 1.5 bins.

    Harris, Proc. IEEE 66, 51 (1978): sin(pi x) / (pi x (1 - x^2)), here its main lobe to 1.5 bins as the power of a
    cosine, which is right at 0 and 1 and at most 1.4 dB off. The cosine is its Taylor series, within 2e-8: no call that
    would keep the loop from being vectorised.
    """
    near, far = min(bins, 1.5), max(bins, 1.5)
    y = (0.25 * np.pi * near) ** 2
    cosine = 1.0 + y * (_C2 + y * (_C4 + y * (_C6 + y * (_C8 + y * _C10))))
    skirt = np.pi * far * (far * far - 1.0)
    return cosine**4 if bins < 1.5 else 1.0 / (skirt * skirt)


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _powers(bins, doppler, slack, smeared, power, row, frequency, chirps, part):
    """What paths [n] bring to a row in its Doppler cell goes to ``part`` [n]; returns their sum."""
    total = 0.0
    for k in range(len(bins)):
        delta = doppler[k] - frequency
        delta = abs(delta - chirps * np.floor(delta / chirps + 0.5))
        away = max(abs(bins[k] - row) - smeared[k], 0.0)
        brought = power[k] * _hann_power(away) * _hann_power(max(delta - slack[k], 0.0))
        brought = brought if delta <= DOPPLER_REACH + smeared[k] else 0.0
        part[k] = brought
        total += brought
    return total


@inlined(nogil=True, error_model="numpy", fastmath=_FAST)
def _decibels_below(total, part, bits, below):
    """10 log10(total / part) goes to ``below``: 2 artanh((m - 1) / (m + 1)) of the mantissa m, within 1e-8 dB.

    :param bits: [n] int64, of any value; ``part`` [n] at least 0
    """
    ratio = bits.view(np.float64)
    for k in range(len(part)):
        ratio[k] = max(part[k] / total, LEAST_RATIO)
    for k in range(len(part)):
        exponent = (bits[k] >> 52) - 1023
        bits[k] = (bits[k] & _MANTISSA) | _EXPONENT_OF_ONE
        below[k] = -_DB_AN_OCTAVE * exponent
    for k in range(len(part)):
        # From 1/sqrt(2) to sqrt(2), of which the series' argument is 0.17 at most.
        above = ratio[k] > np.sqrt(2.0)
        mantissa = 0.5 * ratio[k] if above else ratio[k]
        s = (mantissa - 1.0) / (mantissa + 1.0)
        q = s * s
        log = s * (1.0 + q * (1.0 / 3.0 + q * (1.0 / 5.0 + q * (1.0 / 7.0 + q * (1.0 / 9.0 + q / 11.0)))))
        below[k] -= _DB_OF_LOG * log + (_DB_AN_OCTAVE if above else 0.0)


@compiled(nogil=True, error_model="numpy")
def _mark_seen(bins, doppler, slack, smeared, power, doppler_cells, reach, samples, seen):
    """Mark in ``seen`` [chirps, paths] what each row sees in its Doppler cell.

    A row's paths are counted in levels of 1 dB below the row's power. From the weakest on, levels are left out while
    they hold together less than NEGLECTED_DB.
    """
    chirps, count = seen.shape
    part, below, bits = np.empty(count), np.empty(count), np.empty(count, dtype=np.int64)
    held, starts, stops = np.empty(LEVELS), np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64)
    for row in range(len(doppler_cells)):
        cell = doppler_cells[row]
        frequency = float(cell - chirps // 2)
        total, size = 0.0, 0
        # Cyclic: what lies beyond one end of the axis stands at the other.
        for turn in range(3):
            here = row + (turn - 1) * samples
            starts[turn] = np.searchsorted(bins, here - reach)
            stops[turn] = np.searchsorted(bins, here + reach)
            first, last = starts[turn], stops[turn]
            total += _powers(
                bins[first:last], doppler[first:last], slack[first:last], smeared[first:last], power[first:last],
                here, frequency, float(chirps), part[size : size + last - first],
            )  # fmt: skip
            size += last - first
        if total <= 0.0:
            continue
        _decibels_below(total, part[:size], bits[:size], below[:size])
        held[:] = 0.0
        for index in range(size):
            held[min(int(below[index]), LEVELS - 1)] += part[index]
        least, left_out = LEVELS, 0.0
        while least > 1 and left_out + held[least - 1] <= NEGLECTED * total:
            least -= 1
            left_out += held[least]
        size = 0
        for turn in range(3):
            for k in range(starts[turn], stops[turn]):
                # The last level holds all that is weaker, and those that bring nothing, which are never seen.
                if part[size] > 0.0 and (below[size] < least or least == LEVELS):
                    seen[cell, k] = True
                size += 1
