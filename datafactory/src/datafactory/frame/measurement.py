"""From a frame's illuminated paths to its columns: cube, noise, Doppler choice, truth, targets, boxes.

A frame's motions are those of its start, for all of its duration (:mod:`datafactory.paths.table`). A box is carried to
mid-frame by its velocity relative to the radar, as the places in the column ``targets`` are. A hook may look in between
the steps, see :mod:`datafactory.frame.chain`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from datafactory.frame.draws import generator
from datafactory.frame.points import in_view, target_list
from datafactory.frame.truth_cells import listed_cells
from datafactory.paths.candidates import TARGET_SEEN, Candidates
from datafactory.paths.table import PathTable
from datafactory.scenes.boxes import SeenThing
from datafactory.scenes.motion import triple
from datafactory.synthesis.cube import ON_CPU, Kernels
from datafactory.synthesis.motion import Recording
from datafactory.synthesis.sorting import sorted_paths
from shared.dataset import Box, Frame, Target
from shared.physics.units import amplitude_to_db
from shared.physics.vectors import Real
from shared.processes.defaults import TRUTH_WINDOW
from shared.radar import Radar
from shared.radar.receiver import received
from shared.signal.imaging import DEFAULT_TERMS, near_field_images, walk_terms
from shared.signal.spectrum import range_doppler, select_doppler, unfold
from shared.signal.windows import angle_window, power_in_cell

MAXIMUM_TARGETS = 256

Value = TypeVar("Value")


class Hook(Protocol):
    """What is called at every step of the chain, in place of the step's function."""

    def __call__(self, step: str, function: Callable[..., Value], *arguments: object) -> Value:
        """The step's value: ``function(*arguments)``, or what stands for it."""


def plainly(step: str, function: Callable[..., Value], *arguments: object) -> Value:
    """The hook that looks at nothing."""
    return function(*arguments)


@dataclass(frozen=True)
class Processing:
    """What turns paths into frames, beside the radar.

    :param peaks: Doppler cells kept of every range bin, D
    :param noise: add receiver noise
    :param store: "range-channel", "range-doppler" or "cube"
    :param truth_window: over the virtual sensor's elements, see :func:`shared.signal.windows.angle_window`
    :param tolerance: of the cube's synthesis, relative L2; 30 dB below the default error budget
    :param truth_terms: polynomial terms of the truth's range walk, of a band of 1 GHz; wider ones take as many as keep
        the same error (:func:`shared.signal.imaging.walk_terms`)
    :param doppler: an effect, see :mod:`datafactory.effects.catalogue`
    :param intra_chirp_motion: motion within the chirp, which every scene has; close targets are those of eq. (1)
    """

    peaks: int = 3
    noise: bool = True
    store: str = "range-channel"
    truth_window: str = TRUTH_WINDOW
    tolerance: float = 1e-3
    truth_terms: int = DEFAULT_TERMS
    doppler: bool = True
    intra_chirp_motion: bool = False


@dataclass(frozen=True, eq=False)
class Measurement:
    """A frame before its truth is imaged.

    :param frame: its columns, but for the image; of the targets those that are known beforehand
    :param moments: [terms, R, C] of the virtual sensor
    :param counts: what the frame adds to the manifest's counts
    :param processing: that made them
    """

    frame: Frame
    moments: NDArray[np.complex64]
    counts: Mapping[str, int]
    processing: Processing


def measure(
    frame: Frame, paths: PathTable, radar: Radar, processing: Processing, at: Hook = plainly, kernels: Kernels = ON_CPU
) -> Measurement:
    """Input and sweep moments of one frame from its illuminated paths.

    :param frame: the columns that are known before any signal is made
    :param kernels: of the device that makes the signals
    """
    intra_chirp = processing.intra_chirp_motion
    paths = at("motion", _as_it_moves, paths, radar, processing)
    recording = Recording(radar, processing.tolerance, intra_chirp)
    by_kernel = at("sorting", sorted_paths, paths, recording)
    cube = at("cube", kernels.cube, by_kernel, recording, 1)
    noise = generator(frame.seed, "noise") if processing.noise else None
    recorded = at("receiver", received, cube.astype(np.complex64, copy=False), radar, noise)
    white = (radar.sample_noise_power_w if processing.noise else 0.0) + recorded.conversion_w
    noise_power = power_in_cell(white, radar.waveform)
    spectra = at("range-Doppler", range_doppler, recorded.cube, radar)
    selection = at("Doppler choice", select_doppler, spectra, noise_power, processing.peaks)
    selection = at("velocity interval", unfold, selection, radar)
    terms = walk_terms(radar, processing.truth_terms)
    moments = at("truth", kernels.truth, paths, radar, selection.cells[0], terms, intra_chirp)
    frame = replace(
        frame,
        range_channel=selection.range_channel,
        velocity=selection.velocities_mps(radar.waveform).astype(np.float32),
        noise_power=noise_power,
        range_doppler=selection.magnitude if processing.store == "range-doppler" else None,
        cube=recorded.cube if processing.store == "cube" else None,
    )
    counts = by_kernel.counts()
    if radar.front_end.converter is not None:
        counts["converter_saturated"] = recorded.saturated
    moments = moments * angle_window(processing.truth_window, moments.shape[-1]).astype(np.float32)
    return Measurement(frame, moments, counts, processing)


def _as_it_moves(paths: PathTable, radar: Radar, processing: Processing) -> PathTable:
    """The paths as they move, or as they stand at mid-frame where motion is left out."""
    return paths if processing.doppler else paths.at_rest(radar.waveform.mid_frame_s)


def image(
    measurements: Sequence[Measurement], radar: Radar, at: Hook = plainly
) -> Iterator[tuple[Frame, Counter[str]]]:
    """Frames of measurements, with the counts of each."""
    moments = np.stack([measurement.moments for measurement in measurements])
    images = at("image", near_field_images, moments, radar, radar.virtual_sensor)
    for measurement, picture in zip(measurements, images, strict=True):
        frame, magnitude = measurement.frame, np.abs(picture)
        peak, of_scene = float(magnitude.max()), frame.kind == "scene"
        cells = listed_cells(magnitude, frame, radar, measurement.processing) if of_scene else []
        # What is known beforehand is listed before the strongest cells: a walker is weaker than a street's facades.
        every = (*frame.targets, *cells)
        targets = tuple(sorted(every[:MAXIMUM_TARGETS], key=lambda target: -target.amplitude_db))
        counts = Counter(measurement.counts)
        counts["frames_empty"] += of_scene and not targets
        counts["targets_left_out"] += len(every) - len(targets)
        truth = (magnitude / peak if peak > 0.0 else magnitude).astype(np.float32)
        yield replace(frame, image=truth, image_peak=peak, targets=targets), counts


def object_targets(paths: PathTable, first_object: int, radar: Radar) -> tuple[tuple[Target, ...], dict[str, int]]:
    """The point targets among illuminated paths: the direct echoes off objects from ``first_object`` on, those in the
    radar's range and field of view, and how many there are without."""
    scattered = paths.scattered
    direct = (scattered.object_index >= first_object) & (scattered.depth == 1)
    shown = direct & in_view(scattered.rx_point, radar)
    chosen = scattered.take(shown)
    targets = target_list(
        chosen.rx_point,
        chosen.rx_velocity,
        amplitude_to_db(chosen.amplitude),
        [paths.objects[index] for index in chosen.object_index],
        radar,
    )
    return targets, {"targets_out_of_view": int(np.count_nonzero(direct & ~shown))}


def targets_beyond(candidates: Candidates, radar: Radar) -> int:
    """How many echo points of point targets, in sight or not, lie beyond the unambiguous range."""
    echo_point = (candidates.family == TARGET_SEEN) & (candidates.power > 0.0)
    return int(np.count_nonzero(echo_point & (candidates.range_m >= radar.waveform.unambiguous_range_m)))


def boxes_of(things: Sequence[SeenThing], paths: PathTable, radar: Radar) -> tuple[tuple[Box, ...], dict[str, int]]:
    """The boxes in a radar's range and field of view, and how many there are within and without.

    A box counts as within where its middle or a corner is.

    :param paths: illuminated, for the boxes' power
    """
    index, power = paths.every("object_index"), np.abs(paths.every("amplitude")) ** 2
    known = index >= 0
    by_object = np.bincount(index[known], power[known], minlength=len(paths.objects))
    boxes, outside = [], 0
    for thing in things:
        center = np.array(thing.center) + np.array(thing.velocity) * radar.waveform.mid_frame_s
        if not in_view(_outline(thing, center), radar).any():
            outside += 1
            continue
        yaw = float(np.arctan2(thing.forward[1], thing.forward[0]))
        total = float(by_object[list(thing.indices)].sum())
        boxes.append(Box(triple(center), thing.size, yaw, thing.velocity, thing.class_name, thing.name, total))
    return tuple(boxes), {"boxes": len(boxes), "boxes_out_of_view": outside}


def _outline(thing: SeenThing, center: Real) -> Real:
    """[9, 3] the middle and the corners of a box [m]."""
    corners = np.array([(0.0, 0.0, 0.0), *product((-0.5, 0.5), repeat=3)])
    return center + corners * np.array(thing.size) @ np.array([thing.forward, thing.left, thing.up])
