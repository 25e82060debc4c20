"""Hard cases of TX that take turns (TDM): targets at the edges of the velocity interval and beyond it.

Frames are made by the whole chain and compared with those of a radar whose TX all send at once: its channels are what
compensated ones should be. Angles are those of delay-and-sum.
"""

from __future__ import annotations

import numpy as np
from hardcases.case import HardCase
from hardcases.tools import frame_of, points, small_radar

from shared.dataset import Frame
from shared.radar import Radar
from shared.radar.arrays import AntennaArray, line

RANGE_M, U = 15.0, -0.85 + 1.7 * 20 / 30
"""On the grids of range and angle."""


def _radar(multiplexing: str = "tdm", overlapped: bool = False) -> Radar:
    """Two TX in turns of 320 us; overlapped, three that form a line of ten elements, the fourth and the seventh twice.

    One TX's chirps come every 640 us: the Doppler axis is 3 m/s wide.
    """
    radar = small_radar(chirps=64, multiplexing=multiplexing)
    if not overlapped:
        return radar
    half = 0.5 * radar.waveform.wavelength_m
    array = AntennaArray(tx_m=line(half * np.array([0.0, 3.0, 6.0])), rx_m=line(half * np.arange(4.0)))
    return radar.model_copy(update={"array": array})


def _frame(radar: Radar, velocity: float) -> tuple[Frame, int]:
    """A target with this range rate [m/s] that stands at :data:`RANGE_M` at mid-frame, and its row."""
    towards = np.array([np.sqrt(1.0 - U**2), U, 0.0])
    start = (RANGE_M - velocity * radar.waveform.mid_frame_s) * towards
    frame = frame_of(points([start], [velocity * towards]), radar, noise=False)
    return frame, round(RANGE_M / radar.waveform.range_step_m)


def _phase_error(share: float) -> float:
    """Largest phase error [rad] between channels of a target at this share of the velocity interval's upper edge."""
    velocity = 0.5 * share * _radar().waveform.velocity_span_mps
    (turns, row), (together, _) = (_frame(_radar(way), velocity) for way in ("tdm", "simultaneous"))
    ratio = turns.range_channel[0, row] / together.range_channel[0, row]
    return float(np.abs(np.angle(ratio / ratio[0])).max())


def _truth_follows() -> float:
    """Bins that the truth's peak of a target two intervals away lies off, in range or angle."""
    radar = _radar(overlapped=True)
    frame, row = _frame(radar, 1.3 * radar.waveform.velocity_span_mps)
    top, column = np.unravel_index(int(frame.image.argmax()), frame.image.shape)
    return float(max(abs(top - row), abs(column - 20)))


QUARTER = 0.5 / 64
"""Of a cell, as a share of half the interval."""
EDGE = 1.0 - QUARTER
"""Falls into the lowest Doppler cell."""

CASES = (
    HardCase(
        "TDM, upper edge of the velocity interval", "it falls into the lowest cell, and is turned the wrong way",
        np.pi / (2 * 64), "rad", lambda: _phase_error(EDGE),
    ),
    HardCase(
        "TDM, lower edge of the velocity interval", "as above", np.pi / (2 * 64), "rad", lambda: _phase_error(-EDGE)
    ),
    HardCase(
        "TDM, between two cells", "the compensation knows the cell's centre alone", np.pi / (2 * 64), "rad",
        lambda: _phase_error(0.5 + 1.0 / 64),
    ),
    HardCase(
        "TDM, truth of a folded target", "it is imaged in the wrong Doppler cell", 0.0, "bins", _truth_follows
    ),
)  # fmt: skip
