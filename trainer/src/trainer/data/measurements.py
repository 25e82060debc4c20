"""What ``trainer predict`` images: the frames of a dataset, or a radar cube from a file; and the sensor's own velocity
that is told with them (docs/points.md)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat

from shared.dataset.documents import read_json
from shared.dataset.folder import MANIFEST, SPLITS, open_dataset
from shared.dataset.locations import Location, RemotePath, locate
from shared.dataset.reading import radar_of
from shared.dataset.schema import Frame
from shared.physics.errors import InputError
from shared.radar import Radar, validated
from shared.radar.validation import Described
from shared.signal.ego_motion import EgoMotion, StaticWorld
from shared.signal.model_error import NO_MODEL_ERROR_DB, UNCALIBRATED_DB
from shared.signal.spectrum import doppler_neighbours, range_doppler, select_doppler, unfold
from trainer.captures.cube_file import CubeFile, read_cube
from trainer.data.cfar import cfar_cells
from trainer.defaults import ALL, PEAKS

SUFFIX = ".motion.json"
LEAST_CHIRPS = 4
"""The main lobe of a Hann window: of no more chirps a cell's neighbours are no evidence of its velocity."""

Velocity = tuple[FiniteFloat, FiniteFloat]


class MotionFile(Described):
    """``NAME.motion.json`` beside ``NAME.npz`` or ``NAME.npy``.

    :param velocity: of the vehicle at the radar, forward and to the left [m/s]: of all frames, or of each
    :param mounting_yaw_deg: by how much the radar is turned to the left on it
    """

    velocity: Velocity | Annotated[tuple[Velocity, ...], Field(min_length=1)]
    mounting_yaw_deg: Annotated[FiniteFloat, Field(ge=-360, le=360)] = 0.0

    def motions(self, frames: int) -> list[EgoMotion] | None:
        """The motion of each of so many frames; None where the file has another number."""
        several = [one for one in self.velocity if isinstance(one, tuple)]
        each = several or [cast("Velocity", self.velocity)] * frames
        yaw = math.radians(self.mounting_yaw_deg)
        return [EgoMotion.of_vehicle(*one, yaw) for one in each] if len(each) == frames else None


def read_motion(cube: Path, frames: int) -> list[EgoMotion] | None:
    """The sensor's motion in each frame of a cube, of the file beside it; None where there is none.

    :raises InputError: a damaged file, or of another number of frames
    """
    path = cube.with_suffix(SUFFIX)
    if not path.is_file():
        return None
    content = validated(MotionFile, read_json(path, 'e.g. {"velocity": [8.3, 0.0]}'), path)
    if (motions := content.motions(frames)) is None:
        raise InputError(path, f"{len(content.velocity)} velocities", f"one, or one for each of {frames} frames")
    return motions


def known_world(frame: Mapping[str, Any], radar: Radar) -> StaticWorld:
    """What the sensor's motion says of the rows [D, R] of a frame of a dataset.

    :param frame: its arrays or tensors by name, the velocity among them
    """
    velocity, orientation = (np.asarray(frame[f"sensor_{name}"]).tolist() for name in ("velocity", "orientation"))
    return StaticWorld(EgoMotion.of_pose(velocity, orientation), np.asarray(frame["velocity"]), radar)


@dataclass(frozen=True, eq=False)
class Cells:
    """Range-Doppler cells of a frame, D of every range bin.

    :param range_channel: [D, R, C] [sqrt(W)]
    :param velocity: [D, R] of their centres [m/s]; one that repeats an earlier one of its range bin is none
    :param centre: [D, R] which are peaks and not the neighbours of one; None for all
    :param beside: [2, D, R, C] the Doppler cells below and above, of a cube; None where they are not kept
    """

    range_channel: NDArray[np.complex64]
    velocity: NDArray[np.float32]
    centre: NDArray[np.bool_] | None = None
    beside: NDArray[np.complex64] | None = None

    @property
    def new(self) -> NDArray[np.bool_]:
        """[D, R] which do not repeat an earlier one of their range bin."""
        velocity = self.velocity
        new = [(velocity[:d] != velocity[d]).all(axis=0) for d in range(len(velocity))]
        return np.array(new, dtype=bool).reshape(velocity.shape)

    def seen_by(self, channels: NDArray[np.intp]) -> Cells:
        """The same in these channels."""
        beside = None if self.beside is None else self.beside[..., channels]
        return replace(self, range_channel=self.range_channel[..., channels], beside=beside)


@dataclass(frozen=True, eq=False)
class Measurement:
    """One frame to be imaged.

    :param name: of its files
    :param frame_id: index in its dataset or cube
    :param cells: the strongest Doppler peaks of every range bin, or what passes the test
    :param noise_power: of one channel and cell [W]
    :param truth: [R, U] relative to its peak, if known
    :param model_error_db: power of a row that no plane wave explains, of the row's [dB]; -inf of simulated data
    :param motion: of the sensor, if known
    """

    name: str
    frame_id: int
    cells: Cells
    noise_power: float
    truth: NDArray[np.float32] | None
    model_error_db: float = NO_MODEL_ERROR_DB
    motion: EgoMotion | None = None


@dataclass(frozen=True, eq=False)
class Measurements:
    """The frames of one source, to be gone through once.

    :param dataset: of a dataset, whose truth is on its grid; of a cube otherwise
    :param dead_channels: channels without an echo
    :param remark: what a user should know of the source, if anything
    """

    frames: Iterator[Measurement]
    dataset: bool
    dead_channels: tuple[int, ...] = ()
    remark: str | None = None

    def __iter__(self) -> Iterator[Measurement]:
        return self.frames


def open_measurements(
    source: Location | str, radar: str | None, split: str, cells: str = PEAKS
) -> tuple[Radar, Measurements]:
    """The radar and the frames of a dataset's split, local or remote, or of a cube.

    A cube is a ``.npy`` with its radar named by ``radar``, or a ``.npz``, see :mod:`trainer.captures.cube_file`; a file
    beside it may state the sensor's motion, see :class:`MotionFile`.

    :param cells: of :data:`trainer.defaults.CELLS`
    :raises InputError: neither, or one that is damaged or does not fit its radar
    """
    source = locate(source)
    if isinstance(source, RemotePath) or source.is_dir():
        if radar is not None:
            raise InputError("--radar", f"{radar!r} beside a dataset", "no --radar: the dataset holds its own")
        dataset = open_dataset(source)
        chosen = SPLITS if split == "all" else (split,)
        description = dataset.description()
        if split != "all" and split not in dataset.splits:
            expected = f"--split {', '.join(dataset.splits)} or all"
            raise InputError(source, f"no frames in split {split!r}", expected)
        if cells == ALL and "cube" not in description["shapes"]:
            raise InputError(
                "--cells", f"'all' of {source}, which holds no cubes", "'peaks', or a dataset made with --store cube"
            )
        measuring = radar_of(description, source / MANIFEST)
        frames = (
            _of_frame(frame, measuring, cells)
            for name in chosen if name in dataset.splits
            for frame in dataset.frames(name, ("cube" if cells == ALL else "range_channel", "velocity", "image"))
        )  # fmt: skip
        return measuring, Measurements(frames, True)
    found = read_cube(source, radar)
    motions = read_motion(source, len(found.cube))
    cubes = (
        of_cube(source.stem, found, frame, None if motions is None else motions[frame], cells)
        for frame in range(len(found.cube))
    )
    dead = () if found.capture is None else found.capture.dead_channels
    remark = None if found.unit_remark is None else f"{source}: {found.unit_remark}"
    return found.radar, Measurements(cubes, False, dead, remark)


def _of_frame(frame: Frame, radar: Radar, cells: str) -> Measurement:
    motion = EgoMotion.of_pose(frame.sensor_velocity, frame.sensor_orientation)
    seen = Cells(frame.range_channel, frame.velocity)
    if cells == ALL:
        assert frame.cube is not None
        seen = _cells(frame.cube, radar, frame.noise_power, cells)
    name, truth = f"frame-{frame.frame_id:06d}", np.array(frame.image)
    return Measurement(name, frame.frame_id, seen, frame.noise_power, truth, motion=motion)


def _cells(cube: NDArray[np.complex64], radar: Radar, noise_power: float, cells: str) -> Cells:
    """Of a cube."""
    spectra = range_doppler(cube, radar)
    centre = None
    if cells == ALL:
        selection, centre = cfar_cells(spectra)
    else:
        selection = select_doppler(spectra, noise_power)
    selection = unfold(selection, radar)
    beside = doppler_neighbours(spectra, selection, radar) if radar.waveform.chirps > LEAST_CHIRPS else None
    velocity = selection.velocities_mps(radar.waveform).astype(np.float32)
    return Cells(selection.range_channel, velocity, centre, beside)


def of_cube(
    name: str, found: CubeFile, frame: int, motion: EgoMotion | None, cells: str, number: int | None = None
) -> Measurement:
    """A frame of a cube; of several the name says which.

    :param cells: of :data:`trainer.defaults.CELLS`; :param number: of the frame, where it is not its place in the cube
    """
    radar, capture = found.radar, found.capture
    # A cube that was simulated or written by hand has no model error, one whose calibration does not say a usual one.
    noise_power, error_db = found.noise_power, NO_MODEL_ERROR_DB
    if capture is not None:
        error_db = UNCALIBRATED_DB if capture.model_error_db is None else capture.model_error_db
    seen = _cells(found.cube[frame], radar, noise_power, cells)
    name = name if len(found.cube) == 1 else f"{name}-{frame:06d}"
    frame_id = frame if number is None else number
    return Measurement(name, frame_id, seen, noise_power, None, error_db, motion)
