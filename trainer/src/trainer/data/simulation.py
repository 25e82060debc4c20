"""Resting point targets in front of the radar: what the simulated experiments look at.

Eq. (1) and (2) of the paper, by :mod:`shared.signal`. A resting target has the same echo in every chirp, and the
Doppler spectrum is divided by its window's sum, so that the zero-Doppler cell of the frame is the range spectrum of
one chirp, with noise of power k T0 F f_s sum(w^2) / sum(w)^2 in each of its samples: one chirp stands for the frame,
exactly.

Pairs of point targets for trials of resolution: many in one image, far enough apart in range not to meet. Every method
sees the same simulated range-channel matrices, with targets in the middle of a range bin, spherical waves, and receiver
noise; a method that images range bins one by one is given the bins with targets alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.physics.units import db_to_amplitude
from shared.processes.defaults import TRUTH_WINDOW
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.signal import if_signal
from shared.signal.imaging import DEFAULT_TERMS, near_field_images, sweep_moments, walk_terms
from shared.signal.spectrum import range_doppler
from shared.signal.windows import angle_window, cell_noise_power, hann_noise_share
from trainer.estimators.array import line_array

LEAST_BINS = 4
"""Angle bins that a lobe needs to have a width."""

CLOSE_UP_BINS = 7
"""Range bins shown on either side of a target."""


NEAREST_M = 12.0
"""Plane waves, which all estimators assume, are right over the input array from about 5 m."""
SPACING_BINS = 12
"""From one pair to the next: there the sidelobes of the range window are below -90 dB."""
SPREAD_U = 0.5
"""Pair centres are uniform in |u| below this: the second target stays in the image, the element pattern plays no
part."""


def in_plane(range_m: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
    """[K, 3] positions [m] at ranges [K] [m] and u [K] = sin(azimuth) in the plane z = 0."""
    return np.stack([range_m * np.sqrt(1.0 - u**2), range_m * u, np.zeros_like(u)], axis=-1)


def close_up(radar: Radar, range_m: float) -> tuple[NDArray[np.intp], int]:
    """(range bins around ``range_m``, the place of its own among them)."""
    row = round(range_m / radar.waveform.range_step_m)
    rows = np.arange(max(row - CLOSE_UP_BINS, 0), min(row + CLOSE_UP_BINS + 1, radar.waveform.range_bins))
    return rows, row - int(rows[0])


def out_of_sight(radar: Radar, range_m: float) -> str | None:
    """Why a target at ``range_m`` cannot be shown, None if it can."""
    if radar.grid.bins < LEAST_BINS:
        return f"{radar.grid.bins} angle bins show no target's lobe; {LEAST_BINS} do"
    farthest = (radar.waveform.range_bins - 1) * radar.waveform.range_step_m
    return f"the radar sees to {farthest:.1f} m, the targets stand at {range_m:g} m" if range_m > farthest else None


def snapshot(
    radar: Radar,
    positions_m: NDArray[np.float64],
    amplitudes: NDArray[np.complex128],
    generator: np.random.Generator | None,
) -> NDArray[np.complex64]:
    """[R, C] range-channel matrix of resting targets in the zero-Doppler cell [sqrt(W)].

    :param positions_m: [K, 3] radar frame
    :param amplitudes: [K] complex [sqrt(W)]
    :param generator: of the receiver noise; None for none
    """
    single = radar.of_one_chirp
    cube = if_signal(single, positions_m, np.zeros_like(positions_m), amplitudes)
    if generator is not None:
        power = radar.sample_noise_power_w * hann_noise_share(radar.waveform.chirps)
        noise = generator.standard_normal((*cube.shape, 2)) @ np.array([1.0, 1.0j])
        cube += np.sqrt(power / 2.0) * noise
    return range_doppler(cube.astype(np.complex64), single)[:, 0]


def truth_image(
    radar: Radar, positions_m: NDArray[np.float64], amplitudes: NDArray[np.complex128]
) -> NDArray[np.float32]:
    """[R, U] magnitude [sqrt(W)] that the virtual sensor sees of resting targets, noise free, as in the datasets."""
    sensor = radar.virtual_sensor
    virtual = radar.of_one_chirp.model_copy(update={"array": sensor})
    fast_time = if_signal(virtual, positions_m, np.zeros_like(positions_m), amplitudes)[0]  # (N, C)
    windowed = fast_time * angle_window(TRUTH_WINDOW, sensor.channels)
    moments = sweep_moments(windowed, radar, walk_terms(radar, DEFAULT_TERMS))
    return np.abs(near_field_images(moments[None].astype(np.complex64), radar, sensor)[0])


def amplitude_of(signal_to_noise_db: float, radar: Radar) -> float:
    """Amplitude [sqrt(W)] with this ratio of echo to noise power in one channel's range-Doppler cell [dB]."""
    return float(np.sqrt(cell_noise_power(radar) * 10.0 ** (signal_to_noise_db / 10.0)))


@dataclass(frozen=True)
class TrialCondition:
    """What a set of trials has in common.

    :param separation_cells: between the targets, in resolution cells of the full array; 0 for a single target
    :param snr_db: of the stronger target in one channel
    :param ratio_db: stronger over weaker target
    """

    separation_cells: float
    snr_db: float
    ratio_db: float = 0.0

    @property
    def named(self) -> dict[str, str]:
        """What was varied, by name, as the tables have it."""
        single = {"snr": f"{self.snr_db:g} dB"}
        if self.separation_cells == 0:
            return single
        return {"separation": f"{self.separation_cells:g} RL", **single, "ratio": f"{self.ratio_db:g} dB"}


@dataclass(frozen=True, eq=False)
class Trials:
    """Simulated images full of trials.

    :param snapshots: [I, R, C] range-channel matrices of I images [sqrt(W)]
    :param rows: [n] range bins with targets, the same in every image
    :param u: [I n, K] true angles, rising along K
    :param phase_rad: [I n] of the second target against the first at the middle of the array, -pi to pi; 0 for single
        ones
    """

    snapshots: NDArray[np.complex64]
    rows: NDArray[np.intp]
    u: NDArray[np.float64]
    phase_rad: NDArray[np.float64]


def trial_rows(radar: Radar) -> NDArray[np.intp]:
    """Range bins of the trials."""
    first = min(round(NEAREST_M / radar.waveform.range_step_m), radar.waveform.range_bins // 2)
    return np.arange(first, radar.waveform.range_bins - SPACING_BINS // 2, SPACING_BINS)


def no_room(radar: Radar, separation_cells: float) -> str | None:
    """Why trials of pairs up to this far apart cannot be simulated, None if they can."""
    if not len(trial_rows(radar)):
        return f"{radar.waveform.range_bins} range bins hold no trial; {SPACING_BINS} do"
    if radar.grid.bins < LEAST_BINS:
        return f"{radar.grid.bins} angle bins hold no two targets; {LEAST_BINS} do"
    gap, half = separation_cells * line_array(radar).resolution_cell, min(radar.grid.u_stop, -radar.grid.u_start)
    return None if half > gap else f"pairs {gap:.2g} apart in u leave an image from u = {-half:.2g} to {half:.2g}"


def simulate(
    radar: Radar,
    condition: TrialCondition,
    trials: int,
    seed: Sequence[int],
    arrays: Sequence[AntennaArray] | None = None,
) -> Trials:
    """At least ``trials`` trials, in whole images.

    :param arrays: one for each trial, where the elements really stand; where the radar has them, by default
    """
    generator = np.random.default_rng(seed)
    rows, grid = trial_rows(radar), radar.grid
    count = -(-trials // len(rows)) * len(rows)
    targets = 1 if condition.separation_cells == 0 else 2
    gap = condition.separation_cells * line_array(radar).resolution_cell
    reach = min(SPREAD_U, min(grid.u_stop, -grid.u_start) - gap)
    centre = generator.uniform(-reach, reach, count)
    phase = generator.uniform(-np.pi, np.pi, (count, 2))  # at the origin of the radar
    stronger = generator.integers(0, 2, count)
    u = centre[:, None] + gap * np.array([[-0.5, 0.5]]) if targets == 2 else centre[:, None]
    level_db = np.zeros((count, targets))
    if targets == 2:
        level_db[np.arange(count), 1 - stronger] = -condition.ratio_db
    amplitude = amplitude_of(condition.snr_db, radar) * db_to_amplitude(level_db) * np.exp(1j * phase[:, :targets])
    ranges = radar.waveform.range_step_m * np.repeat(rows, targets).astype(np.float64)
    images = []
    for part in np.split(np.arange(count), count // len(rows)):
        positions, echoes = in_plane(ranges, u[part].reshape(-1)), amplitude[part].reshape(-1)
        if arrays is None:
            images.append(snapshot(radar, positions, echoes, generator))
            continue
        image = snapshot(radar, positions[:0], echoes[:0], generator)
        for place, trial in enumerate(part):
            one = slice(place * targets, (place + 1) * targets)
            seen = radar.model_copy(update={"array": arrays[trial]})
            image += snapshot(seen, positions[one], echoes[one], None)
        images.append(image)
    return Trials(np.stack(images), rows, u, _phase_at_middle(radar, u, phase) if targets == 2 else np.zeros(count))


def _phase_at_middle(radar: Radar, u: NDArray[np.float64], phase: NDArray[np.float64]) -> NDArray[np.float64]:
    """[T] of the second of two echoes s_k exp(-j k u_k p) against the first, p the middle of the aperture."""
    line = line_array(radar)
    middle = 0.5 * (line.positions_m.min() + line.positions_m.max())
    there = phase - 2.0 * np.pi / line.wavelength_m * middle * u
    return np.angle(np.exp(1j * (there[:, 1] - there[:, 0])))
