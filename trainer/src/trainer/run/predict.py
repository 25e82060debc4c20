"""``trainer predict``: images of frames that the network has never seen, or by an estimator that has seen none."""

from __future__ import annotations

import json
from collections.abc import Callable
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
from trainer.data.measurements import Measurement, Measurements, open_measurements
from trainer.estimators.fitting import MODEL_ERROR_DB
from trainer.run.answers import Answer, check_method, estimator_answer, network_answer
from trainer.run.claim import output_folder
from trainer.run.detection_files import COLUMN, CSV_FILE, check_format, column, write_csv, write_pcd
from trainer.run.detection_files import UNITS as DETECTION_UNITS
from trainer.run.detections import Detections, find_detections
from trainer.run.folder import load_imager, same_radar
from trainer.run.other_radars import fitted_imager
from trainer.run.pictures import save_picture

IMAGES = "images.parquet"


def predict(
    run_directory: Path | None,
    source: Location | str,
    out: Path,
    radar: str | None = None,
    split: str = "test",
    pictures: bool = True,
    announce: Callable[[str], object] = print,
    points: bool = False,
    points_format: str = "parquet",
    method: str | None = None,
) -> int:
    """Image every frame into ``out``: ``images.parquet``, and a PNG with DaS beside it; returns the frames imaged.

    :param run_directory: of the network; None with ``method``
    :param split: of a dataset, or "all"
    :param points: a column ``detections`` as well
    :param points_format: with "csv" also ``detections.csv``, with "pcd" a cloud of each frame
    :param method: a classical estimator in place of a network, see :data:`trainer.estimators.base.ESTIMATORS`
    :raises InputError: a run or input that cannot be read, an array or axes that the run was not trained for
    """
    check_format(points_format)
    if points_format != "parquet" and not points:
        raise InputError("--points-format", f"{points_format!r} without --points", "--points beside it")
    if (run_directory is None) == (method is None):
        raise InputError("arguments", "a run and --method" if method else "neither a run nor --method", "one of both")
    if method is not None:
        check_method(method)
    with output_folder(out, resume=False):
        answer, measurements = _open(run_directory, method, source, radar, split, announce)
        schema, count = _schema(answer, points), 0
        if said := statement(answer.radar):
            announce(said)
        listed: list[tuple[int, Detections]] = []
        headless = False
        with atomic(out / IMAGES) as partial, pq.ParquetWriter(partial, schema, compression="lz4") as writer:
            for measurement in measurements:
                images, probability = answer.peaks(measurement)
                image, velocity = merge_peaks(images, measurement.velocity)
                row = {
                    "frame_id": pa.array([measurement.frame_id], pa.int64()),
                    "image": _row(image, schema.field("image").type),
                    "velocity": _row(velocity, schema.field("velocity").type),
                }
                if points:
                    targets = _detections(answer, images, probability, measurement)
                    row["detections"] = column(targets)
                    headless = probability is None and method is None
                    if points_format == "pcd":
                        write_pcd(out / f"{measurement.name}.pcd", targets)
                    elif points_format == "csv":
                        listed.append((measurement.frame_id, targets))
                writer.write_table(pa.table(row, schema=schema))
                if pictures:
                    _picture(out, answer, measurement, image)
                count += 1
        if points_format == "csv":
            write_csv(out / CSV_FILE, listed)
    if headless:
        announce(f"{run_directory} has no detection head: the detections' probability is null")
    announce(f"{count} frames of {source} in {out}")
    return count


def _open(
    run_directory: Path | None,
    method: str | None,
    source: Location | str,
    radar: str | None,
    split: str,
    announce: Callable[[str], object],
) -> tuple[Answer, Measurements]:
    """Who answers, and what is asked."""
    run_and_imager = None if run_directory is None else load_imager(run_directory)
    found, measurements = open_measurements(source, radar, split)
    if run_and_imager is None:
        assert method is not None
        return estimator_answer(method, found, measurements.dead_channels), measurements
    run, imager = run_and_imager
    channels = run.array.channels(run.radar)
    if measurements.dataset:
        same_radar(run.radar, str(run_directory), found, str(source))
    else:
        fitted = fitted_imager(run, imager, str(run_directory), found, str(source))
        imager, channels = fitted.imager, fitted.channels
        for remark in fitted.remarks:
            announce(remark)
        if dead := sorted(set(channels.tolist()) & set(measurements.dead_channels)):
            announce(f"the network looks at channels {dead} of {source}, which are dead")
    imager.to("cuda" if torch.cuda.is_available() else "cpu")
    return network_answer(run, imager, channels, found), measurements


def merge_peaks(
    images: NDArray[np.float32], velocity: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """([R, U] maximum of the peaks' images [D, R, U], [R, U] velocity [m/s] of the peak that has it)."""
    return images.max(axis=0), np.take_along_axis(velocity.T, images.argmax(axis=0), axis=1)


def _detections(
    answer: Answer, images: NDArray[np.float32], probability: NDArray[np.float32] | None, measurement: Measurement
) -> Detections:
    return find_detections(
        images,
        probability,
        measurement.range_channel[..., answer.channels],
        measurement.velocity,
        answer.radar,
        answer.line,
        measurement.noise_power,
        max(MODEL_ERROR_DB, measurement.model_error_db),
    )


def _picture(out: Path, answer: Answer, measurement: Measurement, image: NDArray[np.float32]) -> None:
    images = {f"delay and sum, {answer.array.name}": answer.baseline(measurement), answer.name: image}
    if measurement.truth is not None:
        images["truth (strongest peaks)"] = measurement.truth
    save_picture(out / f"{measurement.name}.png", images, answer.radar, measurement.name)


def _row(values: NDArray[np.float32], kind: pa.DataType) -> pa.Array:
    return pa.FixedSizeListArray.from_arrays(pa.array(np.ascontiguousarray(values).reshape(-1)), type=kind)


def _schema(answer: Answer, points: bool) -> pa.Schema:
    """The dataset's own way to write arrays: plain fixed-size lists, their shapes and axes in the metadata."""
    shape = [answer.radar.waveform.range_bins, answer.radar.grid.bins]
    values = pa.list_(pa.field("element", pa.float32(), nullable=False), shape[0] * shape[1])
    fields = [pa.field(name, kind, nullable=False) for name, kind in (("image", values), ("velocity", values))]
    if points:
        fields.append(COLUMN)
    units: dict[str, object] = {"image": answer.unit, "velocity": "m/s"}
    if points:
        units["detections"] = DETECTION_UNITS
    said = statement(answer.radar)
    text = json.dumps(
        {
            **({"conventions": {"velocity": said}} if said else {}),
            "shapes": {"image": shape, "velocity": shape},
            "axes": answer.radar.metadata()["axes"],
            "units": units,
            "chosen_array": answer.array.model_dump(mode="json"),
            "model": answer.name,
        },
        sort_keys=True,
    )
    return pa.schema(
        [pa.field("frame_id", pa.int64(), nullable=False), *fields], metadata={METADATA_KEY: text.encode()}
    )
