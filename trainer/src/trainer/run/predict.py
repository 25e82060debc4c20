"""``trainer predict``: images of frames that the network has never seen."""

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
from trainer.data.measurements import Measurement, open_measurements
from trainer.estimators.base import line_array
from trainer.run.claim import output_folder
from trainer.run.detection_files import COLUMN, CSV_FILE, check_format, column, write_csv, write_pcd
from trainer.run.detection_files import UNITS as DETECTION_UNITS
from trainer.run.detections import Detections, find_detections
from trainer.run.folder import Run, load_imager, same_radar
from trainer.run.imager import Imager
from trainer.run.pictures import save_picture
from trainer.run.targets import UNITS

IMAGES = "images.parquet"


def predict(
    run_directory: Path,
    source: Location | str,
    out: Path,
    radar: str | None = None,
    split: str = "test",
    pictures: bool = True,
    announce: Callable[[str], object] = print,
    points: bool = False,
    points_format: str = "parquet",
) -> int:
    """Image every frame into ``out``: ``images.parquet``, and a PNG with DaS beside it; returns the frames imaged.

    :param split: of a dataset, or "all"
    :param points: a column ``detections`` as well
    :param points_format: with "csv" also ``detections.csv``, with "pcd" a cloud of each frame
    :raises InputError: a run or input that cannot be read, an array or axes that the run was not trained for
    """
    check_format(points_format)
    if points_format != "parquet" and not points:
        raise InputError("--points-format", f"{points_format!r} without --points", "--points beside it")
    with output_folder(out, resume=False):
        run, imager = load_imager(run_directory)
        found, measurements = open_measurements(source, radar, split)
        same_radar(run.radar, str(run_directory), found, str(source))
        imager.to("cuda" if torch.cuda.is_available() else "cpu")
        schema, count = _schema(run, points), 0
        if said := statement(found):
            announce(said)
        listed: list[tuple[int, Detections]] = []
        headless = False
        with atomic(out / IMAGES) as partial, pq.ParquetWriter(partial, schema, compression="lz4") as writer:
            for measurement in measurements:
                images, probability = answer_peaks(imager, measurement)
                image, velocity = merge_peaks(images, measurement.velocity)
                row = {
                    "frame_id": pa.array([measurement.frame_id], pa.int64()),
                    "image": _row(image, schema.field("image").type),
                    "velocity": _row(velocity, schema.field("velocity").type),
                }
                if points:
                    targets = _detections(run, images, probability, measurement)
                    row["detections"] = column(targets)
                    headless = probability is None
                    if points_format == "pcd":
                        write_pcd(out / f"{measurement.name}.pcd", targets)
                    elif points_format == "csv":
                        listed.append((measurement.frame_id, targets))
                writer.write_table(pa.table(row, schema=schema))
                if pictures:
                    _picture(out, run, imager, measurement, image)
                count += 1
        if points_format == "csv":
            write_csv(out / CSV_FILE, listed)
    if headless:
        announce(f"{run_directory} has no detection head: the detections' probability is null")
    announce(f"{count} frames of {source} in {out}")
    return count


def answer_peaks(imager: Imager, measurement: Measurement) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    """([D, R, U] image, [D, R, U] probability or None) of each Doppler peak of a frame (paper, section II-E).

    The network images the strongest peaks of all range bins, then the second strongest and so on, the strongest again
    where there is none.
    """
    device = imager.weights.device
    with torch.inference_mode():
        snapshots = torch.from_numpy(np.array(measurement.range_channel)).to(device)
        noise = torch.full((len(snapshots),), measurement.noise_power, dtype=torch.float64, device=device)
        images, probability = imager.detect(snapshots, noise)
        return images.cpu().numpy(), None if probability is None else probability.float().cpu().numpy()


def merge_peaks(
    images: NDArray[np.float32], velocity: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """([R, U] maximum of the peaks' images [D, R, U], [R, U] velocity [m/s] of the peak that has it)."""
    return images.max(axis=0), np.take_along_axis(velocity.T, images.argmax(axis=0), axis=1)


def _detections(
    run: Run, images: NDArray[np.float32], probability: NDArray[np.float32] | None, measurement: Measurement
) -> Detections:
    channels = run.array.channels(run.radar)
    return find_detections(
        images,
        probability,
        measurement.range_channel[..., channels],
        measurement.velocity,
        run.radar,
        line_array(run.radar, channels),
        measurement.noise_power,
    )


def _picture(out: Path, run: Run, imager: Imager, measurement: Measurement, image: NDArray[np.float32]) -> None:
    with torch.inference_mode():
        snapshots = torch.from_numpy(np.array(measurement.range_channel)).to(imager.weights.device)
        das = imager.das(snapshots).amax(dim=0).cpu().numpy()
    images = {f"delay and sum, {run.array.name}": das, run.config.model: image}
    if measurement.truth is not None:
        images["truth (strongest peaks)"] = measurement.truth
    save_picture(out / f"{measurement.name}.png", images, run.radar, measurement.name)


def _row(values: NDArray[np.float32], kind: pa.DataType) -> pa.Array:
    return pa.FixedSizeListArray.from_arrays(pa.array(np.ascontiguousarray(values).reshape(-1)), type=kind)


def _schema(run: Run, points: bool) -> pa.Schema:
    """The dataset's own way to write arrays: plain fixed-size lists, their shapes and axes in the metadata."""
    shape = [run.radar.waveform.range_bins, run.radar.grid.bins]
    values = pa.list_(pa.field("element", pa.float32(), nullable=False), shape[0] * shape[1])
    fields = [pa.field(name, kind, nullable=False) for name, kind in (("image", values), ("velocity", values))]
    if points:
        fields.append(COLUMN)
    units: dict[str, object] = {"image": UNITS[run.config.target], "velocity": "m/s"}
    if points:
        units["detections"] = DETECTION_UNITS
    said = statement(run.radar)
    text = json.dumps(
        {
            **({"conventions": {"velocity": said}} if said else {}),
            "shapes": {"image": shape, "velocity": shape},
            "axes": run.radar.metadata()["axes"],
            "units": units,
            "chosen_array": run.array.model_dump(mode="json"),
            "model": run.config.model,
        },
        sort_keys=True,
    )
    return pa.schema(
        [pa.field("frame_id", pa.int64(), nullable=False), *fields], metadata={METADATA_KEY: text.encode()}
    )
