"""How a path's Doppler is developed: with how many terms, over how many elements, in how many bands of the sweep.

Beyond the point of expansion a Doppler of d bins multiplies the frame by exp(j 2 pi d eta), a polynomial in d whose
coefficients are the derivatives of

    G(delta, q) = sum_m w_m exp(j 2 pi (delta eta_m + q eta_m^2)) / sum_m w_m.

Elements see a path with other Dopplers than the centre of their block, and the ends of the sweep see it with others
than its centre, by f_c kappa nu, as it migrates. Where MAX_DOPPLER_TERMS are too few, the sweep is cut into bands, each
developed around f_c (1 + kappa nu_b), and elements near by have points of expansion of their own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import factorial

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int64

from datafactory.paths.columns import WHOLE, Columns
from datafactory.synthesis.doppler_moments import CURVATURE_STEP, DELTA_STEP, MAX_DOPPLER_TERMS
from datafactory.synthesis.mid_frame import DOPPLER_REACH, MidFrame
from shared.radar.waveform import Waveform
from shared.signal.windows import unit_hann

DOPPLER_ERROR = 1e-2
"""Bound on the Doppler polynomial's error, relative to the path's own amplitude. It is reached by the element farthest
from its block's centre and the path farthest from its node alone: with 3e-3 eight munich frames were not nearer to the
reference, and a fifth dearer."""


@dataclass(frozen=True)
class Expansions(Columns):
    """How K paths' Doppler is developed so that the remainder stays below DOPPLER_ERROR.

    With s the largest departure from the point of expansion, the remainder of E terms is at most
    (2 pi s)^E / E! sum w |eta|^E / sum w.

    :param departure: [K] s over the whole sweep [bins]
    :param across_block: [K] what the elements of a block have of it, nothing where each has its own point
    :param migration: [K] what all of the sweep adds
    :param by_element: [K] whether every element has its own point; :param bands: [K] of the sweep that are needed
    :param limits: departures that 2 to MAX_DOPPLER_TERMS terms serve; none where nothing moves
    """

    departure: Float64[np.ndarray, " paths"]
    across_block: Float64[np.ndarray, " paths"]
    migration: Float64[np.ndarray, " paths"]
    by_element: Bool[np.ndarray, " paths"]
    bands: Int64[np.ndarray, " paths"]
    limits: Float64[np.ndarray, " counts"] = field(metadata=WHOLE)

    @staticmethod
    def of(mid: MidFrame, waveform: Waveform) -> Expansions:
        """Points of their own and bands for those paths alone for which MAX_DOPPLER_TERMS are too few."""
        eta, window = np.abs(_frame_positions(waveform.chirps)), unit_hann(waveform.chirps)
        moves = bool(np.any(mid.doppler) or np.any(mid.rx_velocity))
        counts = np.arange(2, MAX_DOPPLER_TERMS + 1 if moves else 2)
        with np.errstate(divide="ignore"):  # one chirp tells no Doppler: any departure will do
            limits = np.array([(DOPPLER_ERROR * factorial(n) / (window @ eta**n)) ** (1.0 / n) for n in counts])
        limits /= 2.0 * np.pi
        room = limits.max(initial=0.0) - 0.5 * DELTA_STEP
        far = mid.departure > room if moves else np.zeros(len(mid.departure), dtype=bool)
        # Elements that take more than half of the room would leave too little to the bands.
        by_element = far & (mid.spread > 0.5 * room)
        across_block, bands = np.where(by_element, 0.0, mid.spread), np.ones(len(far), dtype=np.int64)
        # No window takes the ends off a band. One sample has no ends.
        needed = np.ceil(0.5 * mid.migration[far] / (room - across_block[far]))
        bands[far] = np.clip(needed, 1.0, waveform.samples).astype(np.int64)
        departure = np.where(far, across_block + 0.5 * mid.migration, mid.departure)
        return Expansions(departure, across_block, mid.migration, by_element, bands, limits)

    def groups(
        self, index: Int64[np.ndarray, " chosen"]
    ) -> Iterator[tuple[int, Int64[np.ndarray, " some"], Int64[np.ndarray, " some"]]]:
        """Of these paths those of the whole sweep, and those of as many bands as one needs: how many, which, and the
        terms of each."""
        banded = self.bands[index] > 1
        for some in (index[~banded], index[banded]):
            if len(some):
                bands = int(self.bands[some].max())
                in_band = self.across_block[some] + 0.5 * self.migration[some] / bands
                departure = (in_band if bands > 1 else self.departure[some]) + 0.5 * DELTA_STEP
                terms = np.searchsorted(self.limits, departure, side="right") + (2 if len(self.limits) else 1)
                yield bands, some, np.minimum(terms, MAX_DOPPLER_TERMS)


def _frame_positions(chirps: int) -> Float64[np.ndarray, " {chirps}"]:
    return (np.arange(chirps) - chirps // 2) / chirps


def doppler_table(
    curvature: Float64[np.ndarray, " paths"], chirps: int, terms: int
) -> tuple[int, float, Complex128[np.ndarray, "q delta {terms}"]]:
    """First curvature index, first delta, and G with its derivatives over their factorials."""
    lowest = int(np.rint(curvature.min(initial=0.0) / CURVATURE_STEP))
    highest = int(np.rint(curvature.max(initial=0.0) / CURVATURE_STEP))
    # An echo of 16 cycles is 32 Doppler cells wide. What passes by nearer and faster yet is taken for that.
    lowest, highest = max(lowest, -512), min(highest, 512)
    q = CURVATURE_STEP * np.arange(lowest, highest + 1)
    delta = np.arange(-DOPPLER_REACH - 1.0, DOPPLER_REACH + 1.0 + DELTA_STEP, DELTA_STEP)
    eta = _frame_positions(chirps)
    window = unit_hann(chirps)
    table = np.empty((len(q), len(delta), terms), dtype=np.complex128)
    kernel = np.exp(2j * np.pi * delta[:, None] * eta)
    bend = window * np.exp(2j * np.pi * q[:, None] * eta**2)
    for e in range(terms):
        table[:, :, e] = (bend * (2j * np.pi * eta) ** e / factorial(e)) @ kernel.T
    return lowest, float(delta[0]), table
