"""``trainer predict``: images of frames that the network has never seen, or by an estimator that has seen none."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from numpy.typing import NDArray

from shared.dataset import METADATA_KEY
from shared.dataset.locations import Location
from shared.dataset.writing import atomic
from shared.physics.errors import InputError
from shared.signal.tdm import statement
from trainer.data.measurements import CELLS, PEAKS, Measurement, Measurements, open_measurements
from trainer.estimators.fitting import MODEL_ERROR_DB
from trainer.run.answers import Answer, NetworkAnswer, check_method, estimator_answer, network_answer
from trainer.run.detection_files import (
    COLUMN,
    CSV_FILE,
    MOTION,
    MOTION_UNITS,
    check_format,
    column,
    motion_column,
    write_csv,
    write_pcd,
)
from trainer.run.detection_files import UNITS as DETECTION_UNITS
from trainer.run.detections import FALSE_ALARMS, Detections, Sought, find_detections, with_moving
from trainer.run.ego_motion import Motions
from trainer.run.folder import load_imager, output_folder, same_radar
from trainer.run.other_radars import fitted_imager
from trainer.run.pictures import ANIMATION, save_animation, save_picture
from trainer.run.precision import precision_remark

IMAGES = "images.parquet"


@dataclass(frozen=True)
class PointsRequest:
    """Which points are listed.

    :param false_alarms: expected lines of a frame of noise alone, at most
    :param cells: "peaks", the three Doppler peaks of every range bin, or "all", of a cube: see :mod:`trainer.data.cfar`
    :raises InputError: values out of range
    """

    false_alarms: float = FALSE_ALARMS
    cells: str = PEAKS

    def __post_init__(self) -> None:
        if not (np.isfinite(self.false_alarms) and self.false_alarms > 0.0):
            raise InputError("--false-alarms", f"{self.false_alarms}", "a finite number above 0, of lines a frame")
        if self.cells not in CELLS:
            raise InputError("--cells", repr(self.cells), " or ".join(CELLS))


@dataclass(frozen=True)
class PredictRequest:
    """Which frames are imaged, by what, and what is written.

    :param out: a folder, new or empty
    :param run: folder of the network; None with ``method``
    :param method: a classical estimator in place of a network, see :data:`trainer.estimators.base.ESTIMATORS`
    :param radar: of a .npy cube: a preset or a TOML file
    :param split: of a dataset, or "all"
    :param pictures: a PNG for each frame, with DaS beside it
    :param points: a column ``detections`` as well
    :param listed: which
    :param points_format: with "csv" also ``detections.csv``, with "pcd" a cloud of each frame
    :param animation: also ``animation.gif``
    :param velocity: of the vehicle at the radar, forward and to the left [m/s], in every frame; else what the source
        says, else what the frame shows
    :param mounting_yaw_deg: by how much the radar is turned to the left on it
    :raises InputError: options that do not go together
    """

    source: Location | str
    out: Path
    run: Path | None = None
    method: str | None = None
    radar: str | None = None
    split: str = "test"
    pictures: bool = True
    points: bool = False
    listed: PointsRequest = PointsRequest()
    points_format: str = "parquet"
    animation: bool = False
    velocity: tuple[float, float] | None = None
    mounting_yaw_deg: float = 0.0

    def __post_init__(self) -> None:
        check_format(self.points_format)
        if self.points_format != "parquet" and not self.points:
            raise InputError("--points-format", f"{self.points_format!r} without --points", "--points beside it")
        if self.listed != PointsRequest() and not self.points:
            raise InputError("--cells, --false-alarms", "without --points", "--points beside them")
        if self.animation and not self.points:
            raise InputError("--animation", "without --points", "--points beside it")
        if not np.isfinite([*(self.velocity or ()), self.mounting_yaw_deg]).all():
            raise InputError("--velocity", f"{self.velocity}, yaw {self.mounting_yaw_deg}", "finite numbers")
        if self.mounting_yaw_deg and self.velocity is None:
            raise InputError("--mounting-yaw", "without --velocity", "--velocity beside it")
        if (self.run is None) == (self.method is None):
            problem = "a run and --method" if self.method else "neither a run nor --method"
            raise InputError("arguments", problem, "one of both")
        if self.method is not None:
            check_method(self.method)


def predict(request: PredictRequest, announce: Callable[[str], object] = print) -> int:
    """Image every frame: ``images.parquet``, and what else is asked for; returns the frames imaged.

    :raises InputError: a run or input that cannot be read, an array or axes that the run was not trained for
    """
    out, points_format = request.out, request.points_format
    with output_folder(out, resume=False):
        answer, measurements = _open(request, announce)
        schema, count = _schema(answer, request.listed if request.points else None), 0
        if said := statement(answer.radar):
            announce(said)
        listed: list[tuple[int, Detections]] = []
        motions = Motions(request.velocity, request.mounting_yaw_deg, request.points or answer.uses_motion)
        headless = False
        with atomic(out / IMAGES) as partial, pq.ParquetWriter(partial, schema, compression="lz4") as writer:
            for seen in measurements:
                measurement = motions.told(seen, answer)
                images, probability = answer.peaks(measurement)
                image, velocity = merge_peaks(images, measurement.velocity)
                row = {
                    "frame_id": pa.array([measurement.frame_id], pa.int64()),
                    "image": _row(image, schema.field("image").type),
                    "velocity": _row(velocity, schema.field("velocity").type),
                }
                if request.points:
                    targets = _detections(answer, images, probability, measurement, request.listed.false_alarms)
                    row["detections"] = column(targets)
                    row["motion"] = motion_column(measurement.motion)
                    headless = probability is None and request.method is None
                    if points_format == "pcd":
                        write_pcd(out / f"{measurement.name}.pcd", targets)
                    elif points_format == "csv":
                        listed.append((measurement.frame_id, targets))
                writer.write_table(pa.table(row, schema=schema))
                if request.pictures:
                    _picture(out, answer, measurement, image)
                count += 1
        if points_format == "csv":
            write_csv(out / CSV_FILE, listed)
        if request.animation:
            save_animation(out / IMAGES, out / ANIMATION)
    if headless:
        announce(f"{request.run} has no detection head: the detections' probability is null")
    if motions.estimated:
        announce(str(motions))
    remark = precision_remark([answer.imager.config] if isinstance(answer, NetworkAnswer) else [])
    announce(f"{count} frames of {request.source} in {out}" + (f"; {remark}" if remark else ""))
    return count


def _open(request: PredictRequest, announce: Callable[[str], object]) -> tuple[Answer, Measurements]:
    """Who answers, and what is asked."""
    run_and_imager = None if request.run is None else load_imager(request.run)
    found, measurements = open_measurements(request.source, request.radar, request.split, request.listed.cells)
    if run_and_imager is None:
        assert request.method is not None
        return estimator_answer(request.method, found, measurements.dead_channels), measurements
    run, imager = run_and_imager
    channels = run.array.channels(run.radar)
    if measurements.dataset:
        same_radar(run.radar, str(request.run), found, str(request.source))
    else:
        fitted = fitted_imager(run, imager, str(request.run), found, str(request.source))
        imager, channels = fitted.imager, fitted.channels
        for remark in fitted.remarks:
            announce(remark)
        if dead := sorted(set(channels.tolist()) & set(measurements.dead_channels)):
            announce(f"the network looks at channels {dead} of {request.source}, which are dead")
    imager.to("cuda" if torch.cuda.is_available() else "cpu")
    return network_answer(run, imager, channels, found), measurements


def merge_peaks(
    images: NDArray[np.float32], velocity: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """([R, U] maximum of the peaks' images [D, R, U], [R, U] velocity [m/s] of the peak that has it)."""
    return images.max(axis=0), np.take_along_axis(velocity.T, images.argmax(axis=0), axis=1)


def _detections(
    answer: Answer,
    images: NDArray[np.float32],
    probability: NDArray[np.float32] | None,
    measurement: Measurement,
    false_alarms: float,
) -> Detections:
    found = find_detections(
        images,
        probability,
        measurement.range_channel[..., answer.channels],
        measurement.velocity,
        answer.radar,
        answer.line,
        Sought(measurement.noise_power, max(MODEL_ERROR_DB, measurement.model_error_db), false_alarms),
        measurement.centre,
    )
    return with_moving(found, measurement.motion, answer.radar)


def _picture(out: Path, answer: Answer, measurement: Measurement, image: NDArray[np.float32]) -> None:
    images = {f"delay and sum, {answer.array.name}": answer.baseline(measurement), answer.name: image}
    if measurement.truth is not None:
        images["truth (strongest peaks)"] = measurement.truth
    save_picture(out / f"{measurement.name}.png", images, answer.radar, measurement.name)


def _row(values: NDArray[np.float32], kind: pa.DataType) -> pa.Array:
    return pa.FixedSizeListArray.from_arrays(pa.array(np.ascontiguousarray(values).reshape(-1)), type=kind)


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
