"""``trainer predict``: images of frames that the network has never seen, or by an estimator that has seen none.

Of frames one by one, as they come, each an image, and the list of points:

predictor = Predictor.load("sparse6", radar)
for number, cube in enumerate(stream):  # [chirp, sample, channel]
    seen = predictor.cube(cube, number)
    print(seen.points.range_m, seen.points.u)
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from shared.dataset import METADATA_KEY
from shared.dataset.writing import atomic
from shared.physics.compiled import is_kept
from shared.physics.errors import InputError
from shared.processes.declared import taking
from shared.radar import Radar
from shared.signal.ego_motion import EgoMotion
from shared.signal.tdm import statement
from trainer.captures.cube_file import CubeFile, checked_cube
from trainer.data.arrays import FULL, choose_array
from trainer.data.measurements import Measurement, Measurements, of_cube, open_measurements
from trainer.defaults import PEAKS
from trainer.estimators.base import ESTIMATORS
from trainer.estimators.fitting import MODEL_ERROR_DB
from trainer.estimators.groups import fit_in_turn
from trainer.run.answers import Answer, NetworkAnswer, estimator_answer, network_answer
from trainer.run.detection_files import (
    COLUMN,
    CSV_FILE,
    MOTION,
    MOTION_UNITS,
    column,
    motion_column,
    plain_array,
    write_csv,
    write_pcd,
)
from trainer.run.detection_files import UNITS as DETECTION_UNITS
from trainer.run.detections import Detections, Sought, find_detections, with_moving
from trainer.run.folder import MEASURED, Run, load_imager, output_folder, same_radar
from trainer.run.imager import Imager, precision_remark
from trainer.run.options import PointsRequest, PredictRequest
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
        """Of the samples [chirp, sample, channel] [sqrt(W)] of the radar that was named to :meth:`load`.

        :raises InputError: of another shape, not complex, not finite or too large
        """
        radar = self.answer.radar
        found = CubeFile(checked_cube("cube", np.asarray(cube), radar, several=False), radar, None)
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


IMAGES = "images.parquet"


@taking(PredictRequest)
def predict(request: PredictRequest) -> int:
    """Image every frame, as ``trainer predict`` does: ``images.parquet``, and what else is asked for.

    >>> predict("build/dataset", "build/images", pretrained="sparse6", points=True)  # doctest: +SKIP

    :returns: frames imaged
    :raises InputError: a run or input that cannot be read, an array or axes that the run was not trained for
    """
    out, points_format, announce = request.out, request.points_format, request.announce
    with output_folder(out, resume=False):
        answer, measurements = _open(request)
        if request.velocity is not None and not (request.points or answer.uses_motion):
            problem = f"without --points, and {answer.name!r} uses no velocity"
            raise InputError("--velocity", problem, "--points beside it, or --method likes-view-ego")
        listed = request.listed if request.points else None
        motions = Motions(request.velocity, request.mounting_yaw_deg, request.points or answer.uses_motion)
        predictor = Predictor(answer, motions, listed)
        schema, count = _schema(answer, listed), 0
        if request.points and not is_kept(fit_in_turn):
            announce("the line fit is compiled for this machine, once; that takes about half a minute")
        for said in (statement(answer.radar), measurements.remark):
            if said:
                announce(said)
        lists: list[tuple[int, Detections]] = []
        drawn: Future[None] | None = None
        with (
            atomic(out / IMAGES) as partial,
            pq.ParquetWriter(partial, schema, compression="lz4") as writer,
            ThreadPoolExecutor(1) as drawing,  # a picture, while the next frame is computed
        ):
            for seen in measurements:
                found = predictor(seen)
                row = {
                    "frame_id": plain_array(np.array([seen.frame_id])),
                    "image": _row(found.image, schema.field("image").type),
                    "velocity": _row(found.velocity, schema.field("velocity").type),
                }
                if found.points is not None:
                    row["detections"] = column(found.points)
                    row["motion"] = motion_column(found.measurement.motion)
                    if points_format == "pcd":
                        write_pcd(out / f"{seen.name}.pcd", found.points)
                    elif points_format == "csv":
                        lists.append((seen.frame_id, found.points))
                writer.write_table(pa.table(row, schema=schema))
                if drawn is not None:
                    drawn.result()
                if request.pictures:
                    drawn = drawing.submit(_picture, out, answer, found)
                count += 1
            if drawn is not None:
                drawn.result()
        if points_format == "csv":
            write_csv(out / CSV_FILE, lists)
        if request.animation:
            from trainer.run.pictures import ANIMATION, save_animation

            save_animation(out / IMAGES, out / ANIMATION)
    if motions.estimated:
        announce(str(motions))
    remark = precision_remark([answer.imager.config] if isinstance(answer, NetworkAnswer) else [])
    announce(f"{count} frames of {request.source} in {out}" + (f"; {remark}" if remark else ""))
    return count


def _open(request: PredictRequest) -> tuple[Answer, Measurements]:
    """Who answers, and what is asked."""
    loaded = None if request.run is None else load_imager(request.run)
    source, split = request.source, request.split
    found, measurements = open_measurements(source, request.radar, split or "test", request.listed.cells)
    if split is not None and not measurements.dataset:
        raise InputError("--split", f"{split!r} beside a cube", f"no --split: all frames of {source} are imaged")
    if loaded is None:
        assert request.method is not None
        if said := choose_array(FULL, found).left_out(found):
            request.announce(said)
        return estimator_answer(request.method, found, measurements.dead_channels), measurements
    if not measurements.dataset:
        about = str(request.source), measurements.dead_channels
        return answer_for_cubes(*loaded, str(request.run), found, request.announce, *about), measurements
    run, imager = loaded
    same_radar(run.radar, str(request.run), found, str(request.source), MEASURED)
    if said := run.array.left_out(found):
        request.announce(said)
    return network_answer(run, imager, None, found), measurements


def _picture(out: Path, answer: Answer, found: Prediction) -> None:
    from trainer.run.pictures import save_picture

    measurement = found.measurement
    images = {f"delay and sum, {answer.array.name}": answer.baseline(measurement), answer.name: found.image}
    if measurement.truth is not None:
        images["truth (strongest peaks)"] = measurement.truth
    save_picture(out / f"{measurement.name}.png", images, answer.radar, measurement.name, found.points)


def _row(values: NDArray[np.float32], kind: pa.DataType) -> pa.Array:
    return pa.FixedSizeListArray.from_arrays(plain_array(values), type=kind)


def _schema(answer: Answer, points: PointsRequest | None) -> pa.Schema:
    """The dataset's own way to write arrays: plain fixed-size lists, their shapes and axes in the metadata."""
    shape = [answer.radar.waveform.range_bins, answer.radar.grid.bins]
    values = pa.list_(pa.field("element", pa.float32(), nullable=False), shape[0] * shape[1])
    fields = [pa.field(name, kind, nullable=False) for name, kind in (("image", values), ("velocity", values))]
    if points:
        fields += [COLUMN, MOTION]
    units: dict[str, object] = {"image": answer.unit, "velocity": "m/s"}
    if points:
        units |= {"detections": DETECTION_UNITS, "motion": MOTION_UNITS}
    said = statement(answer.radar)
    text = json.dumps(
        {
            **({"conventions": {"velocity": said}} if said else {}),
            "shapes": {"image": shape, "velocity": shape},
            "axes": answer.radar.metadata()["axes"],
            "units": units,
            "chosen_array": answer.array.model_dump(mode="json"),
            "model": answer.name,
            **({} if points is None else {"points": asdict(points)}),
        },
        sort_keys=True,
    )
    return pa.schema(
        [pa.field("frame_id", pa.int64(), nullable=False), *fields], metadata={METADATA_KEY: text.encode()}
    )
