"""One frame from its paths: cube, noise, Doppler choice, truth, targets. The method, in its order.

Frames are imaged in batches, which share the matrices of the image; a frame has the same bytes in every batch.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from datafactory.frame.points import target_list
from datafactory.paths.table import PathTable
from datafactory.synthesis.cube import cube_of_paths
from datafactory.synthesis.truth import truth_moments
from datafactory.synthesis.wave_model import WaveModel
from shared.dataset import Frame, Target
from shared.physics.units import amplitude_to_db
from shared.radar import Radar
from shared.radar.receiver import received
from shared.signal.imaging import DEFAULT_TERMS, near_field_images
from shared.signal.spectrum import range_doppler, select_doppler
from shared.signal.windows import angle_window, cell_noise_power

IMAGE_BATCH = 16
"""Frames imaged together: twice as many would save a tenth of the time, for 200 MB more."""
MAXIMUM_TARGETS = 256
CELL_SPAN_DB = 60.0
"""Truth cells further below the image's peak than this are not listed where no noise sets the limit."""


@dataclass(frozen=True)
class Processing:
    """What turns paths into frames, beside the radar.

    :param peaks: Doppler cells kept of every range bin, D
    :param noise: add receiver noise
    :param store: "range-channel", "range-doppler" or "cube"
    :param truth_window: over the virtual sensor's elements, see :func:`shared.signal.windows.angle_window`
    :param tolerance: of the cube's synthesis, relative L2
    :param truth_terms: polynomial terms of the truth's range walk
    :param doppler, range_migration, intra_chirp_motion, near_field: effects, see
        :mod:`datafactory.effects.catalogue`; by default those of eq. (1) and (2)
    """

    peaks: int = 3
    noise: bool = True
    store: str = "range-channel"
    truth_window: str = "taylor-30"
    tolerance: float = 1e-6
    truth_terms: int = DEFAULT_TERMS
    doppler: bool = True
    range_migration: bool = True
    intra_chirp_motion: bool = False
    near_field: bool = True


@dataclass(frozen=True)
class Setting:
    """What a frame knows of itself before any signal is made: the columns that identify it."""

    frame_id: int
    kind: str
    scene: str
    seed: int
    sensor_position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sensor_velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sensor_orientation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Measurement:
    """A frame before its truth is imaged.

    :param moments: [terms, R, C] of the virtual sensor
    :param targets: known beforehand: point targets and RCS objects
    :param list_cells: whether the truth's cells join the list of targets
    :param saturated: samples (I or Q) that left the converter's range
    """

    setting: Setting
    range_channel: NDArray[np.complex64]
    velocity: NDArray[np.float32]
    magnitude: NDArray[np.float32]
    noise_power: float
    moments: NDArray[np.complex64]
    targets: tuple[Target, ...]
    list_cells: bool
    cube: NDArray[np.complex64] | None
    saturated: int = 0


def measure(
    setting: Setting,
    paths: PathTable,
    targets: tuple[Target, ...],
    radar: Radar,
    processing: Processing,
    generator: np.random.Generator,
) -> Measurement:
    """Input and sweep moments of one frame from its illuminated paths."""
    if not processing.doppler:
        paths = paths.at_rest(radar.waveform.mid_frame_s)
    model = WaveModel(processing.range_migration, processing.intra_chirp_motion, processing.near_field)
    cube = cube_of_paths(paths, radar, processing.tolerance, model=model).astype(np.complex64, copy=False)
    cube, saturated = received(cube, radar, generator if processing.noise else None)
    noise_power = cell_noise_power(radar) if processing.noise else 0.0
    selection = select_doppler(range_doppler(cube, radar), noise_power, processing.peaks)
    moments = truth_moments(paths, radar, selection.cells[0], processing.truth_terms, model)
    return Measurement(
        setting=setting,
        range_channel=selection.range_channel,
        velocity=radar.waveform.velocities_mps[selection.cells].astype(np.float32),
        magnitude=selection.magnitude,
        noise_power=noise_power,
        moments=moments * angle_window(processing.truth_window, moments.shape[-1]).astype(np.float32),
        targets=targets,
        list_cells=setting.kind == "scene",
        cube=cube if processing.store == "cube" else None,
        saturated=saturated,
    )


def image(measurements: Sequence[Measurement], radar: Radar, store: str) -> Iterator[tuple[Frame, dict[str, int]]]:
    """Frames of at most IMAGE_BATCH measurements, with what was left out of each."""
    moments = np.stack([measurement.moments for measurement in measurements])
    images = near_field_images(moments, radar, radar.virtual_sensor)
    for measurement, picture in zip(measurements, images, strict=True):
        magnitude = np.abs(picture)
        peak = float(magnitude.max())
        targets = measurement.targets
        if measurement.list_cells:
            cells = _cells(magnitude, measurement, radar)
            targets = tuple(sorted((*targets, *cells), key=lambda target: -target.amplitude_db))
        frame = Frame(
            **vars(measurement.setting),
            range_channel=measurement.range_channel,
            velocity=measurement.velocity,
            image=(magnitude / peak if peak > 0.0 else magnitude).astype(np.float32),
            image_peak=peak,
            noise_power=measurement.noise_power,
            targets=targets[:MAXIMUM_TARGETS],
            range_doppler=measurement.magnitude if store == "range-doppler" else None,
            cube=measurement.cube,
        )
        counts = {"targets_left_out": max(0, len(targets) - MAXIMUM_TARGETS)}
        if radar.front_end.converter is not None:
            counts["converter_saturated"] = measurement.saturated
        yield frame, counts


def object_targets(paths: PathTable, first_object: int, radar: Radar) -> tuple[Target, ...]:
    """The point targets among illuminated paths: those that scatter off objects from ``first_object`` on."""
    scattered = paths.scattered
    chosen = scattered.take((scattered.object_index >= first_object) & (scattered.depth == 1))
    return target_list(
        chosen.rx_point,
        chosen.rx_velocity,
        amplitude_to_db(chosen.amplitude),
        [paths.objects[index] for index in chosen.object_index],
        radar,
    )


def detected_cells(magnitude: NDArray[np.float32], noise_power: float) -> NDArray[np.bool_]:
    """[R, U] local maxima of a truth image [sqrt(W)] above the noise."""
    peak = float(magnitude.max())
    floor = max(float(np.sqrt(noise_power)), peak * 10.0 ** (-CELL_SPAN_DB / 20.0))
    return (magnitude == maximum_filter(magnitude, size=3)) & (magnitude > floor)


def _cells(magnitude: NDArray[np.float32], measurement: Measurement, radar: Radar) -> list[Target]:
    """The detected cells as targets."""
    rows, columns = np.nonzero(detected_cells(magnitude, measurement.noise_power))
    ranges, u, velocity = radar.waveform.ranges_m, radar.grid.u, measurement.velocity[0]
    level_db = amplitude_to_db(magnitude[rows, columns])
    return [
        Target(float(ranges[row]), float(u[column]), float(velocity[row]), float(level))
        for row, column, level in zip(rows, columns, level_db, strict=True)
    ]
