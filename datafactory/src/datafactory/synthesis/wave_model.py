"""The parts of the signal model that can be chosen: motion within frame and chirp, curvature of the wave.

A chirp that starts at t sees the echo's phase at mid-sweep and its beat frequency. Eq. (1) freezes the delay at the
chirp's start, tau(t) for both. With motion within the chirp the phase (f_c + mu s) tau(t + s), developed around
mid-sweep s = T_c / 2, is

    f_0 tau(t + T_c / 2) + mu (s - T_c / 2) (tau + tau' f_0 / mu) + mu tau' (s - T_c / 2)^2,

so that the phase is that at the time t + T_c / 2, and the beat frequency that at a time later by f_0 / mu: range and
Doppler are coupled. Left out are the last term, mu tau' T_c^2 / 4 = 1.3e-3 cycles at the sweep's ends and 10 m/s, and
the delay's curvature over f_0 / mu (6.2 ms). Without range migration the beat frequency is that of mid-frame
throughout.
"""

from __future__ import annotations

from dataclasses import dataclass

from shared.radar import Radar
from shared.signal.sweep import reference_frequency_hz


@dataclass(frozen=True)
class WaveModel:
    """The default is eq. (1) and (2).

    :param range_migration: echoes move through range bins within the frame
    :param intra_chirp_motion: and within the chirp
    :param near_field: spherical waves over the input array, otherwise plane ones
    """

    range_migration: bool = True
    intra_chirp_motion: bool = False
    near_field: bool = True

    def phase_time_s(self, start_s: float, radar: Radar) -> float:
        """Time at which the scene has the phase of a chirp [s].

        :param start_s: start of the chirp [s]
        """
        return start_s + 0.5 * radar.waveform.chirp_duration_s if self.intra_chirp_motion else start_s

    def beat_time_s(self, start_s: float, radar: Radar) -> float:
        """Time at which the scene has the beat frequency of a chirp [s]; ``start_s`` as in :meth:`phase_time_s`."""
        start = start_s if self.range_migration else radar.waveform.mid_frame_s
        return self.phase_time_s(start, radar) + self.lead_s(radar)

    def lead_s(self, radar: Radar) -> float:
        """Time by which the beat frequency precedes the phase, f_0 / mu [s]."""
        return reference_frequency_hz(radar) / radar.waveform.slope_hz_per_s if self.intra_chirp_motion else 0.0


EQUATION_1 = WaveModel()
