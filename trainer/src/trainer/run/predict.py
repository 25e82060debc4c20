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
from trainer.data.measurements import Measurement, open_measurements
from trainer.run.claim import output_folder
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
) -> int:
    """Image every frame into ``out``: ``images.parquet``, and a PNG with DaS beside it; returns the frames imaged.

    :param split: of a dataset, or "all"
    :raises InputError: a run or input that cannot be read, an array or axes that the run was not trained for
    """
    with output_folder(out, resume=False):
        run, imager = load_imager(run_directory)
        found, measurements = open_measurements(source, radar, split)
        same_radar(run.radar, str(run_directory), found, str(source))
        imager.to("cuda" if torch.cuda.is_available() else "cpu")
        schema, count = _schema(run), 0
        with atomic(out / IMAGES) as partial, pq.ParquetWriter(partial, schema, compression="lz4") as writer:
            for measurement in measurements:
                image, velocity = image_peaks(imager, measurement)
                row = {
                    "frame_id": pa.array([measurement.frame_id], pa.int64()),
                    "image": _row(image, schema.field("image").type),
                    "velocity": _row(velocity, schema.field("velocity").type),
                }
                writer.write_table(pa.table(row, schema=schema))
                if pictures:
                    _picture(out, run, imager, measurement, image)
                count += 1
    announce(f"{count} frames of {source} in {out}")
    return count


def image_peaks(imager: Imager, measurement: Measurement) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """([R, U] image, [R, U] radial velocity [m/s]) of all Doppler peaks of a frame (paper, section II-E).

    The network images the strongest peaks of all range bins, then the second strongest and so on, the strongest again
    where there is none; the images are merged by their maximum, which also says whose velocity a pixel has.
    """
    device = imager.weights.device
    with torch.inference_mode():
        snapshots = torch.from_numpy(np.array(measurement.range_channel)).to(device)
        noise = torch.full((len(snapshots),), measurement.noise_power, dtype=torch.float64, device=device)
        images = imager(snapshots, noise).cpu().numpy()  # (D, R, U)
    strongest = images.argmax(axis=0)
    velocity = np.take_along_axis(measurement.velocity.T, strongest, axis=1)
    return images.max(axis=0), velocity


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


def _schema(run: Run) -> pa.Schema:
    """The dataset's own way to write arrays: plain fixed-size lists, their shapes and axes in the metadata."""
    shape = [run.radar.waveform.range_bins, run.radar.grid.bins]
    values = pa.list_(pa.field("element", pa.float32(), nullable=False), shape[0] * shape[1])
    fields = [pa.field(name, kind, nullable=False) for name, kind in (("image", values), ("velocity", values))]
    text = json.dumps(
        {
            "shapes": {"image": shape, "velocity": shape},
            "axes": run.radar.metadata()["axes"],
            "units": {"image": UNITS[run.config.target], "velocity": "m/s"},
            "chosen_array": run.array.model_dump(mode="json"),
            "model": run.config.model,
        },
        sort_keys=True,
    )
    return pa.schema(
        [pa.field("frame_id", pa.int64(), nullable=False), *fields], metadata={METADATA_KEY: text.encode()}
    )
