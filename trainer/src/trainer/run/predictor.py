"""Frames one by one, as they come: of each an image, and the list of points.

predictor = Predictor.load("sparse6", radar)
for number, cube in enumerate(stream):  # [chirp, sample, channel]
    seen = predictor.cube(cube, number)
    print(seen.points.range_m, seen.points.u)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shared.physics.errors import InputError
from shared.radar import Radar
from shared.signal.ego_motion import EgoMotion
from trainer.captures.cube_file import CubeFile
from trainer.data.measurements import Measurement, of_cube
from trainer.defaults import PEAKS
from trainer.estimators.base import ESTIMATORS
from trainer.estimators.fitting import MODEL_ERROR_DB
from trainer.run.answers import Answer, NetworkAnswer, estimator_answer, network_answer
from trainer.run.detections import Detections, Sought, find_detections, with_moving
from trainer.run.folder import Run, load_imager
from trainer.run.imager import Imager
from trainer.run.options import PointsRequest
from trainer.run.other_radars import fitted_imager
from trainer.run.pretrained import pretrained_names, pretrained_run


@dataclass(frozen=True, eq=False)
class Prediction:
    """What is made of one frame.

    :param measurement: the frame, with the sensor's motion as well as it is known
    :param image: [R, U] the maximum over its Doppler peaks
    :param velocity: [R, U] of the peak that has it [m/s]
    :param points: None where none were asked for
    """

    measurement: Measurement
    image: NDArray[np.float32]
    velocity: NDArray[np.float32]
    points: Detections | None


@dataclass
class Motions:
    """Which velocity the sensor has in the frames of one command: told with it, by the source, or seen in the frame
    itself.

    :param velocity: of the vehicle, forward and to the left [m/s], where the command says it
    :param yaw_deg: of the radar on it, with ``velocity``
    :param wanted: whether anything asks for the motion: without that none is estimated
    :ivar estimated: frames in which it was looked for
    :ivar unknown: of these, where too few echoes agree
    :ivar largest_std_mps: of those estimated
    """

    velocity: tuple[float, float] | None
    yaw_deg: float
    wanted: bool
    estimated: int = 0
    unknown: int = 0
    largest_std_mps: float = 0.0

    def told(self, measurement: Measurement, answer: Answer) -> Measurement:
        """The frame with the sensor's motion as well as it is known."""
        if self.velocity is not None:
            told = EgoMotion.of_vehicle(*self.velocity, math.radians(self.yaw_deg))
            measurement = replace(measurement, motion=told)
        if measurement.motion is not None or not self.wanted:
            return measurement
        motion = answer.seen_motion(measurement)
        self.estimated += 1
        if motion is None:
            self.unknown += 1
        else:
            self.largest_std_mps = max(self.largest_std_mps, *motion.std_mps)
        return replace(measurement, motion=motion)

    def __str__(self) -> str:
        found = self.estimated - self.unknown
        spread = f", standard deviation at most {self.largest_std_mps:.2g} m/s" if found else ""
        none = f"; in {self.unknown} too few echoes agree, and it is not known" if self.unknown else ""
        return f"the sensor's velocity was estimated in {found} of {self.estimated} frames{spread}{none}"


@dataclass(frozen=True, eq=False)
class Predictor:
    """A network or an estimator, asked frame by frame.

    :param answer: which
    :param motions: how the sensor's motion is known
    :param listed: which points; None for images alone
    """

    answer: Answer
    motions: Motions
    listed: PointsRequest | None = None

    @classmethod
    def load(
        cls,
        model: str | Path,
        radar: Radar,
        listed: PointsRequest | None = PointsRequest(),
        velocity: tuple[float, float] | None = None,
        mounting_yaw_deg: float = 0.0,
    ) -> Predictor:
        """For the cubes of ``radar``.

        :param model: a run's folder, or a name of :func:`pretrained_names` or of :data:`ESTIMATORS`
        :param velocity: of the vehicle at the radar, forward and to the left [m/s]; None to see it in the frames
        :raises InputError: no such model, or one that does not fit the radar
        """
        if model in ESTIMATORS:
            answer: Answer = estimator_answer(str(model), radar, ())
        elif Path(model).is_dir() or model in pretrained_names():
            folder = Path(model) if Path(model).is_dir() else pretrained_run(str(model))
            answer = answer_for_cubes(*load_imager(folder), str(folder), radar, lambda _: None)
        else:
            known = [*pretrained_names(), *ESTIMATORS]
            raise InputError("model", f"{str(model)!r}", f"the folder of a run, or one of {', '.join(known)}")
        wanted = listed is not None or answer.uses_motion
        return cls(answer, Motions(velocity, mounting_yaw_deg, wanted), listed)

    def cube(self, cube: NDArray[np.complexfloating], frame: int = 0) -> Prediction:
        """Of the samples [chirp, sample, channel] [sqrt(W)] of the radar that was named to :meth:`load`."""
        found = CubeFile(np.asarray(cube, dtype=np.complex64)[None], self.answer.radar, None)
        return self(of_cube("cube", found, 0, None, PEAKS if self.listed is None else self.listed.cells, frame))

    def __call__(self, seen: Measurement) -> Prediction:
        measurement = self.motions.told(seen, self.answer)
        images, probability = self.answer.peaks(measurement)
        points = None
        if self.listed is not None:
            level = max(MODEL_ERROR_DB, measurement.model_error_db)
            points = find_detections(
                images,
                probability,
                measurement.cells.seen_by(self.answer.channels),
                self.answer.radar,
                self.answer.line,
                Sought(measurement.noise_power, level, self.listed.false_alarms),
            )
            points = with_moving(points, measurement.motion, self.answer.radar)
        return Prediction(measurement, *merge_peaks(images, measurement.cells.velocity), points)


def merge_peaks(
    images: NDArray[np.float32], velocity: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """([R, U] maximum of the peaks' images [D, R, U], [R, U] velocity [m/s] of the peak that has it)."""
    return images.max(axis=0), np.take_along_axis(velocity.T, images.argmax(axis=0), axis=1)


def answer_for_cubes(
    run: Run,
    imager: Imager,
    name: str,
    radar: Radar,
    announce: Callable[[str], object],
    source: str = "the cube",
    dead: tuple[int, ...] = (),
) -> NetworkAnswer:
    """The network of a run, for cubes.

    :param name, source: of run and cubes, for messages
    :param dead: channels without an echo
    :raises InputError: an array without its elements
    """
    fitted, channels, remarks = fitted_imager(run, imager, name, radar, source)
    for remark in remarks:
        announce(remark)
    if blind := sorted(set(channels.tolist()) & set(dead)):
        announce(f"the network looks at channels {blind} of {source}, which are dead")
    return network_answer(run, fitted, channels, radar)
