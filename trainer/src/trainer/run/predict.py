"""``trainer predict``: images of frames that the network has never seen, or by an estimator that has seen none."""

from __future__ import annotations

import json
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict
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
from shared.signal.tdm import statement
from trainer.data.measurements import Measurements, open_measurements
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
from trainer.run.detections import Detections
from trainer.run.folder import load_imager, output_folder, same_radar
from trainer.run.imager import precision_remark
from trainer.run.options import PointsRequest, PredictRequest
from trainer.run.predictor import Motions, Prediction, Predictor, answer_for_cubes

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
        _require_use(request, answer)
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


def _require_use(request: PredictRequest, answer: Answer) -> None:
    """Refuse a velocity that nothing asks for.

    :raises InputError: without points, and images that depend on no motion
    """
    if request.velocity is not None and not (request.points or answer.uses_motion):
        problem = f"without --points, and {answer.name!r} uses no velocity"
        raise InputError("--velocity", problem, "--points beside it, or --method likes-view-ego")


def _open(request: PredictRequest) -> tuple[Answer, Measurements]:
    """Who answers, and what is asked."""
    loaded = None if request.run is None else load_imager(request.run)
    found, measurements = open_measurements(request.source, request.radar, request.split, request.listed.cells)
    if loaded is None:
        assert request.method is not None
        return estimator_answer(request.method, found, measurements.dead_channels), measurements
    if not measurements.dataset:
        about = str(request.source), measurements.dead_channels
        return answer_for_cubes(*loaded, str(request.run), found, request.announce, *about), measurements
    run, imager = loaded
    same_radar(run.radar, str(request.run), found, str(request.source))
    return network_answer(run, imager, None, found), measurements


def _picture(out: Path, answer: Answer, found: Prediction) -> None:
    from trainer.run.pictures import save_picture

    measurement = found.measurement
    images = {f"delay and sum, {answer.array.name}": answer.baseline(measurement), answer.name: found.image}
    if measurement.truth is not None:
        images["truth (strongest peaks)"] = measurement.truth
    save_picture(out / f"{measurement.name}.png", images, answer.radar, measurement.name)


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
