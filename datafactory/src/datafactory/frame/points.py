"""Point targets: the paper's close-target sets, and exactly the targets that a file names.

The paper adds 5500 synthetic frames of closely spaced point targets to its ray-traced ones (section III-B), because
street scenes seldom challenge the resolution. It states no distributions; ours are the fields of :class:`CloseTargets`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat, TypeAdapter, model_validator

from datafactory.paths.echo_points import Seen, all_echo_points
from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.scenes.poses import Coordinate, Speed, read_entries
from datafactory.scenes.scene import LARGEST_RCS_DBSM, PointTarget
from datafactory.scenes.targets.models import OPTIONS, SIZES, RcsModel, target_model
from shared.dataset import Target
from shared.physics.errors import InputError
from shared.physics.units import amplitude_to_db, power_to_db
from shared.physics.vectors import Real, dots
from shared.radar import Radar
from shared.radar.validation import Described
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
    """K targets in the radar frame at t = 0, and those that have a model.

    :param position: [K, 3] [m]; :param velocity: [K, 3] [m/s]
    :param rcs_dbsm: [K] [dBsm]; :param phase_rad: [K] [rad]
    :param models: targets whose echo points follow from a model, in the radar frame
    """

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    rcs_dbsm: NDArray[np.float64]
    phase_rad: NDArray[np.float64]
    models: tuple[PointTarget, ...] = ()

    def echo_points(self, radar: Radar, seed: int) -> PointTargets:
        """The same targets, the echo points of those with a model in their place.

        :param seed: of where in their cycle moving parts are at t = 0
        """
        if not self.models:
            return self
        crossed = radar.front_end.tx_polarization != radar.front_end.rx_polarization
        seen = Seen(radar.waveform.wavelength_m, 0.0, crossed, seed)
        points = all_echo_points(self.models, (0.0, 0.0, 0.0), seen).heard()
        return PointTargets(
            position=np.concatenate([self.position, points.position]),
            velocity=np.concatenate([self.velocity, points.velocity]),
            rcs_dbsm=np.concatenate([self.rcs_dbsm, power_to_db(points.rcs_m2)]),
            phase_rad=np.concatenate([self.phase_rad, np.zeros(len(points.rcs_m2))]),
        )

    def path_table(self, radar: Radar) -> PathTable:
        """Their echoes, illuminated: amplitudes in sqrt(W) by the radar equation."""
        amplitude = target_amplitudes(radar, self.position, self.rcs_dbsm, self.phase_rad)
        scattered = ScatteredPaths.of_points(self.position, self.velocity, amplitude)
        beyond = int((scattered.range_m() >= radar.waveform.unambiguous_range_m).sum())
        counts = {
            "close_targets": len(scattered),
            "folded_beyond_range": beyond,
            "targets_out_of_view": int((~in_view(self.position, radar)).sum()),
        }
        return PathTable(scattered=scattered, counts=counts)

    def truth(self, radar: Radar) -> tuple[Target, ...]:
        """What stands in the ``targets`` column: those that the image shows, geometry at mid-frame, strongest first."""
        level = amplitude_to_db(target_amplitudes(radar, self.position, self.rcs_dbsm, self.phase_rad))
        seen = in_view(self.position, radar)
        return target_list(self.position[seen], self.velocity[seen], level[seen], [""] * int(seen.sum()), radar)


def in_view(places: Real, radar: Radar) -> NDArray[np.bool_]:
    """[n] which of [n, 3] places [m] are ahead, within the range and between the first and the last bin of u."""
    range_m = np.linalg.norm(places, axis=1)
    u = places[:, 1] / np.maximum(range_m, 1e-9)
    waveform, bins = radar.waveform, radar.grid.u
    ahead = (places[:, 0] > 0.0) & (range_m <= waveform.ranges_m[-1])
    within: NDArray[np.bool_] = ahead & (u >= bins[0]) & (u <= bins[-1])
    return within


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
    rate = dots(middle, velocity) / range_m
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


def require_close_targets(radar: Radar) -> None:
    """:raises InputError: a radar whose range axis has no room for them"""
    if radar.waveform.range_bins < LEAST_RANGE_BINS:
        problem = f"waveform.range_bins = {radar.waveform.range_bins} leaves no room for random close targets"
        raise InputError("--radar", problem, f"at least {LEAST_RANGE_BINS}, or --targets")


def draw_close_targets(radar: Radar, settings: CloseTargets, generator: np.random.Generator) -> PointTargets:
    """One frame of static close targets, all in view and within 0.95 of u; the same generator state gives the same
    frame."""
    positions, rcs, noise_db = [], [], float(power_to_db(cell_noise_power(radar)))
    require_close_targets(radar)
    resolution, step = rayleigh_length(radar), radar.waveform.range_step_m
    farthest = min(settings.range_m[1], step * (radar.waveform.range_bins - 2))
    nearest = min(settings.range_m[0], 0.5 * farthest)
    lowest, highest = np.log(settings.separation_rl)
    left, right = max(radar.grid.u[0], -0.95), min(radar.grid.u[-1], 0.95)
    for _ in range(generator.integers(settings.groups[0], settings.groups[1], endpoint=True)):
        count = int(generator.integers(settings.targets[0], settings.targets[1], endpoint=True))
        separation = resolution * np.exp(generator.uniform(float(lowest), float(highest), count - 1))
        u = np.concatenate([[0.0], np.cumsum(separation)])
        u = u - u.mean() + generator.uniform(*settings.u)
        # A small board's cells are wide: a group takes so much of the view that its place may still be drawn.
        u *= min(1.0, 0.9 * (right - left) / max(float(np.ptp(u)), 1e-9))
        if u.min() < left or u.max() > right:
            u += left + (right - left - np.ptp(u)) * generator.random() - u.min()
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


class _Entry(Described):
    x: Coordinate
    y: Coordinate
    z: Coordinate = 0.0
    vx: Speed = 0.0
    vy: Speed = 0.0
    vz: Speed = 0.0
    rcs_dbsm: Annotated[FiniteFloat, Field(ge=-LARGEST_RCS_DBSM, le=LARGEST_RCS_DBSM)] | None = None
    phase: FiniteFloat = 0.0
    model: str | None = None
    heading_deg: FiniteFloat | None = None
    sizes: dict[str, FiniteFloat] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _sizes_apart(cls, entry: Any) -> Any:
        """Sizes and options of models stand beside the other fields."""
        if not isinstance(entry, dict) or "sizes" in entry:
            return entry if not isinstance(entry, dict) else {**entry, "sizes": "no field of a target"}
        sizes = {name: entry[name] for name in (*SIZES, *OPTIONS) if name in entry}
        return {name: value for name, value in entry.items() if name not in sizes} | ({"sizes": sizes} if sizes else {})

    @model_validator(mode="after")
    def _one_level(self) -> Self:
        if self.model is None:
            if self.rcs_dbsm is None:
                raise ValueError("no rcs_dbsm; expected one, or a model")
            if self.sizes or self.heading_deg is not None:
                stated = [*self.sizes, *(["heading_deg"] if self.heading_deg is not None else [])]
                raise ValueError(f'{stated[0]} without a model; expected "model" beside it')
            return self
        if self.rcs_dbsm is not None or self.phase:
            raise ValueError("a model beside rcs_dbsm or phase; expected one of the two: a model has its own level")
        if problem := self.rcs_model().unfit(float(np.dot(self.axes()[0], self.velocity()))):
            raise ValueError(problem)
        return self

    def rcs_model(self) -> RcsModel:
        """:raises ValueError: no such model, or sizes that it does not have"""
        return target_model(self.model or "", self.sizes)

    def velocity(self) -> tuple[float, float, float]:
        return self.vx, self.vy, self.vz

    def axes(self) -> tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]:
        """The model's x, y and z: level, x where it heads for, or else where it moves to, or else ahead."""
        heading = np.arctan2(self.vy, self.vx) if self.heading_deg is None else np.radians(self.heading_deg)
        cosine, sine = float(np.cos(heading)), float(np.sin(heading))
        return (cosine, sine, 0.0), (-sine, cosine, 0.0), (0.0, 0.0, 1.0)


def read_targets(path: Path) -> tuple[PointTargets, ...]:
    """Frames of ``--targets``: ``[[{"x": m, "y": m, "z": m, "vx": m/s, ..., "rcs_dbsm": dB, "phase": rad}, ...],
    ...]``.

    In place of a level and a phase a target may have a model, with its sizes and options beside it and a heading:
    ``{"x": 9, "y": 1, "z": -0.5, "vx": -1.4, "model": "pedestrian", "stature_m": 1.75, "heading_deg": 180}``.

    :raises InputError: an unreadable file, another shape, a field or value that does not belong, a target at the origin
    """
    expected = 'a list of frames, each a list of targets {"x", "y", "rcs_dbsm", ...}'
    frames = read_entries(path, TypeAdapter(list[list[_Entry]]), expected, _Entry.model_fields)
    for number, frame in enumerate(frames):
        for index, entry in enumerate(frame):
            if np.hypot(np.hypot(entry.x, entry.y), entry.z) < 0.01:
                fault = f"frame {number}, target {index} stands within 1 cm of the radar"
                raise InputError(path, fault, "a place further away")
    return tuple(_as_arrays(frame) for frame in frames)


def _as_arrays(frame: list[_Entry]) -> PointTargets:
    models = tuple(_as_target(f"target {index}", entry) for index, entry in enumerate(frame) if entry.model is not None)
    frame = [entry for entry in frame if entry.model is None]
    return PointTargets(
        position=np.array([[entry.x, entry.y, entry.z] for entry in frame]).reshape(-1, 3),
        velocity=np.array([[entry.vx, entry.vy, entry.vz] for entry in frame]).reshape(-1, 3),
        rcs_dbsm=np.array([entry.rcs_dbsm for entry in frame], dtype=float),
        phase_rad=np.array([entry.phase for entry in frame], dtype=float),
        models=models,
    )


def _as_target(name: str, entry: _Entry) -> PointTarget:
    model = entry.rcs_model()
    place = (entry.x, entry.y, entry.z)
    return PointTarget(name, place, model.nominal_rcs_dbsm, entry.velocity(), model, entry.axes())
