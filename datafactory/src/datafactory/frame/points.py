"""Point targets: the paper's close-target sets, and exactly the targets that a file names.

The paper adds 5500 synthetic frames of closely spaced point targets to its ray-traced ones (section III-B), because
street scenes seldom challenge the resolution. It states no distributions; ours are the fields of :class:`CloseTargets`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, TypeAdapter, ValidationError

from datafactory.paths.table import PathTable, ScatteredPaths
from shared.dataset import Target
from shared.physics.errors import InputError
from shared.physics.units import FARTHEST_M, FASTEST_MPS, amplitude_to_db, power_to_db
from shared.radar import Radar, first_validation_error
from shared.signal import target_amplitudes
from shared.signal.windows import cell_noise_power


@dataclass(frozen=True)
class CloseTargets:
    """Distributions of a close-target frame. Uniform between the two numbers unless said otherwise.

    :param groups: number of groups of targets a frame, whole numbers, both ends included
    :param targets: number of targets in a group, likewise
    :param range_m: range of a group [m]; its targets lie within one range bin
    :param u: centre of a group
    :param separation_rl: between neighbours in u, in Rayleigh lengths lambda / (span + spacing), log-uniform
    :param snr_db: of the strongest target of a group in a range-Doppler cell of one channel [dB]
    :param level_db: of the others relative to the strongest [dB]
    """

    groups: tuple[int, int] = (4, 24)
    targets: tuple[int, int] = (1, 4)
    range_m: tuple[float, float] = (2.0, 92.0)
    u: tuple[float, float] = (-0.75, 0.75)
    separation_rl: tuple[float, float] = (0.1, 3.0)
    snr_db: tuple[float, float] = (10.0, 40.0)
    level_db: tuple[float, float] = (-20.0, 0.0)


@dataclass(frozen=True)
class PointTargets:
    """K targets in the radar frame at t = 0.

    :param position: [K, 3] [m]; :param velocity: [K, 3] [m/s]
    :param rcs_dbsm: [K] [dBsm]; :param phase_rad: [K] [rad]
    """

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    rcs_dbsm: NDArray[np.float64]
    phase_rad: NDArray[np.float64]

    def path_table(self, radar: Radar) -> PathTable:
        """Their echoes, illuminated: amplitudes in sqrt(W) by the radar equation."""
        amplitude = target_amplitudes(radar, self.position, self.rcs_dbsm, self.phase_rad)
        scattered = ScatteredPaths.of_points(self.position, self.velocity, amplitude)
        beyond = int((scattered.range_m() >= radar.waveform.unambiguous_range_m).sum())
        return PathTable(scattered=scattered, counts={"traced": len(scattered), "folded_beyond_range": beyond})

    def truth(self, radar: Radar) -> tuple[Target, ...]:
        """What stands in the ``targets`` column: geometry at mid-frame, strongest first."""
        level = amplitude_to_db(target_amplitudes(radar, self.position, self.rcs_dbsm, self.phase_rad))
        return target_list(self.position, self.velocity, level, [""] * len(level), radar)


def target_list(
    position: NDArray[np.float64],
    velocity: NDArray[np.float64],
    level_db: NDArray[np.float64],
    names: list[str],
    radar: Radar,
) -> tuple[Target, ...]:
    """Targets as seen from the origin at mid-frame, strongest first.

    :param position: [K, 3] at t = 0 [m]; :param velocity: [K, 3] [m/s]; :param level_db: [K] 20 log10 of sqrt(W)
    """
    middle = position + velocity * radar.waveform.mid_frame_s
    range_m = np.linalg.norm(middle, axis=1)
    rate = np.einsum("ki,ki->k", middle, velocity) / range_m
    order = np.argsort(-level_db, kind="stable")
    return tuple(
        Target(float(range_m[k]), float(middle[k, 1] / range_m[k]), float(rate[k]), float(level_db[k]), names[k])
        for k in order
    )


def rayleigh_length(radar: Radar) -> float:
    """Resolution in u of the full array: lambda / (span + spacing) of its virtual elements along y."""
    y = np.unique(np.round(radar.array.virtual[:, 1], 9))
    if len(y) < 2:
        return 1.0
    return radar.waveform.wavelength_m / (float(y[-1] - y[0]) + float(np.diff(y).min()))


LEAST_RANGE_BINS = 3
"""The farthest group stands two bins before the last one."""


def draw_close_targets(radar: Radar, settings: CloseTargets, generator: np.random.Generator) -> PointTargets:
    """One frame of static close targets; the same generator state gives the same frame."""
    positions, rcs, noise_db = [], [], float(power_to_db(cell_noise_power(radar)))
    if radar.waveform.range_bins < LEAST_RANGE_BINS:
        problem = f"waveform.range_bins = {radar.waveform.range_bins} leaves no room for random close targets"
        raise InputError("--radar", problem, f"at least {LEAST_RANGE_BINS}, or --targets")
    resolution, step = rayleigh_length(radar), radar.waveform.range_step_m
    farthest = min(settings.range_m[1], step * (radar.waveform.range_bins - 2))
    nearest = min(settings.range_m[0], 0.5 * farthest)
    lowest, highest = np.log(settings.separation_rl)
    for _ in range(generator.integers(settings.groups[0], settings.groups[1], endpoint=True)):
        count = int(generator.integers(settings.targets[0], settings.targets[1], endpoint=True))
        separation = resolution * np.exp(generator.uniform(float(lowest), float(highest), count - 1))
        u = np.concatenate([[0.0], np.cumsum(separation)])
        u = np.clip(u - u.mean() + generator.uniform(*settings.u), -0.95, 0.95)
        range_m = generator.uniform(nearest, farthest) + step * generator.uniform(-0.5, 0.5, count)
        level_db = generator.uniform(*settings.level_db, count)
        level_db += generator.uniform(*settings.snr_db) - level_db.max() + noise_db
        place = np.stack([range_m * np.sqrt(1.0 - u**2), range_m * u, np.zeros(count)], axis=1)
        # The radar equation turned round: the cross section that gives this level from there.
        unit_level_db = amplitude_to_db(target_amplitudes(radar, place, np.zeros(count), np.zeros(count)))
        positions.append(place)
        rcs.append(level_db - unit_level_db)
    position = np.concatenate(positions)
    phase = generator.uniform(0.0, 2.0 * np.pi, len(position))
    return PointTargets(position, np.zeros_like(position), np.concatenate(rcs), phase)


Coordinate = Annotated[FiniteFloat, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
Speed = Annotated[FiniteFloat, Field(ge=-FASTEST_MPS, le=FASTEST_MPS)]


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid")

    x: Coordinate
    y: Coordinate
    z: Coordinate = 0.0
    vx: Speed = 0.0
    vy: Speed = 0.0
    vz: Speed = 0.0
    rcs_dbsm: Annotated[FiniteFloat, Field(ge=-200, le=200)]
    phase: FiniteFloat = 0.0


def read_targets(path: Path) -> tuple[PointTargets, ...]:
    """Frames of ``--targets``: ``[[{"x": m, "y": m, "z": m, "vx": m/s, ..., "rcs_dbsm": dB, "phase": rad}, ...],
    ...]``.

    :raises InputError: an unreadable file, another shape, a field or value that does not belong, a target at the origin
    """
    expected = 'a list of frames, each a list of targets {"x", "y", "rcs_dbsm", ...}'
    try:
        document: Any = json.loads(path.read_text(encoding="utf-8"))
        frames = TypeAdapter(list[list[_Entry]]).validate_python(document)
    except (OSError, ValueError, RecursionError) as error:
        if isinstance(error, ValidationError):
            raise InputError(path, *first_validation_error(error)) from error
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(path, f"not readable as JSON: {reason}", expected) from error
    if not frames:
        raise InputError(path, "no frames", expected)
    for number, frame in enumerate(frames):
        for index, entry in enumerate(frame):
            if np.hypot(np.hypot(entry.x, entry.y), entry.z) < 0.01:
                fault = f"frame {number}, target {index} stands within 1 cm of the radar"
                raise InputError(path, fault, "a place further away")
    return tuple(_as_arrays(frame) for frame in frames)


def _as_arrays(frame: list[_Entry]) -> PointTargets:
    return PointTargets(
        position=np.array([[entry.x, entry.y, entry.z] for entry in frame]).reshape(-1, 3),
        velocity=np.array([[entry.vx, entry.vy, entry.vz] for entry in frame]).reshape(-1, 3),
        rcs_dbsm=np.array([entry.rcs_dbsm for entry in frame], dtype=float),
        phase_rad=np.array([entry.phase for entry in frame], dtype=float),
    )
