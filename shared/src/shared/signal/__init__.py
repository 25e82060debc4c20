"""From echoes to images: eq. (1) and (2) of the paper, spectra, beamforming, features."""

from shared.signal.signal import chirp_times, if_signal, if_signal_of_delays, round_trip_delays, target_amplitudes

__all__ = ["chirp_times", "if_signal", "if_signal_of_delays", "round_trip_delays", "target_amplitudes"]
