"""``trainer export``: the network as ONNX, checked against the network in double precision."""

from __future__ import annotations

import io
import json
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
from numpy.typing import NDArray

from shared.dataset.writing import require_new_file, write_bytes
from shared.processes.declared import taking
from trainer.errors import Stopped
from trainer.networks.real_unrolled import RealUnrolledNetwork
from trainer.networks.unrolled import UnrolledNetwork
from trainer.run.export_check import ROUNDINGS, TOLERANCE, checked_rows, errors_of
from trainer.run.folder import load_imager
from trainer.run.imager import CHANNELS, UNITS, lay_out
from trainer.run.options import ExportOptions
from trainer.run.pretrained import run_or_pretrained

OPSET = 17
REPETITIONS = 5
TRACED_ROWS = 16
"""The tracer keeps what every operation makes: of all range bins of 48 channels tens of gigabytes."""
SNAPSHOT_PLANES = ("real parts", "imaginary parts", "noise power over the row's")
"""Of :func:`shared.signal.features.snapshot_features`, the first two of every channel."""


@dataclass(frozen=True)
class Export:
    """What was written.

    :param difference: of onnxruntime from the network in double precision, on noise and on targets
        (:mod:`trainer.run.export_check`), the largest relative to the largest value
    :param rounding: the same of torch in single precision
    :param torch_seconds, onnx_seconds: median latency of one image
    """

    path: Path
    difference: float
    rounding: float
    torch_seconds: float
    onnx_seconds: float


@taking(ExportOptions)
def export(asked: ExportOptions) -> Export:
    """Write the run's network as ONNX, float32, as ``trainer export`` does.

    Input ``features`` [1, F, R, U], of the "doa-cnn" [1, 3, R, C * C], of the "unrolled" network [1, 2 C + 1, R, 1]
    snapshots; output ``answer`` [1, 1 or 2, R, U]; any number R of range bins. The "unrolled" network is exported in
    real arithmetic (:mod:`trainer.networks.real_unrolled`), where the prior of the sensor's motion is flat and no
    input. :mod:`shared.signal.features`, NumPy alone, computes the features. The image follows from the answer by a
    power, the row's scale and the gain. The file's metadata hold array, axes, gain and both names under
    ``sparseradar``.

    :raises InputError: no whole run, an output that cannot be written
    :raises Stopped: onnxruntime errs by more than torch's own rounding explains; nothing is written
    """
    out = asked.out
    run, imager = load_imager(run_or_pretrained(asked.run))
    require_new_file(out, ".onnx")
    checked, power = checked_rows(run.radar), torch.ones(1)
    rows = {name: imager.features(torch.from_numpy(seen), power)[0] for name, seen in checked.items()}
    features, network = next(iter(rows.values())), imager.network
    lay_out(network, torch.contiguous_format)
    with torch.inference_mode():
        torch_seconds = _latency(lambda: network(features))
    exported = RealUnrolledNetwork(network) if isinstance(network, UnrolledNetwork) else network
    with warnings.catch_warnings():
        # The newer exporter needs another package and gives the same graph for these networks.
        warnings.simplefilter("ignore", DeprecationWarning)
        # Paddings, which it writes with a step of -1, are left to onnxruntime.
        warnings.filterwarnings("ignore", "Constant folding - Only steps=1", UserWarning)
        buffer = io.BytesIO()
        torch.onnx.export(
            exported,
            (features[:, :, :TRACED_ROWS],),
            buffer,  # type: ignore[arg-type]  # declared for the newer exporter alone
            dynamo=False,
            opset_version=OPSET,
            input_names=["features"],
            output_names=["answer"],
            dynamic_axes={"features": {2: "rows"}, "answer": {2: "rows"}},
        )
    model = onnx.load_model_from_string(buffer.getvalue())
    description = {
        "features": CHANNELS.get(run.config.features, SNAPSHOT_PLANES),
        "unit": UNITS[run.config.target],
        "gain": imager.gain,
        "config": run.config.model_dump(mode="json"),
        "chosen_array": run.array.model_dump(mode="json"),
        **run.radar.metadata(),
    }
    onnx.helper.set_model_props(model, {"sparseradar": json.dumps(description)})
    content = model.SerializeToString()
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])

    def answer(given: torch.Tensor) -> NDArray[np.float32]:
        return np.asarray(session.run(None, {"features": given.numpy()})[0])

    errors = [errors_of(name, given, network, answer) for name, given in rows.items()]
    for error in errors:
        if not error.agree:
            allowed = f"{ROUNDINGS:g} times that and {TOLERANCE:g}"
            raise Stopped(f"{out}: {error}, from double precision; at most {allowed} is right; nothing written")
    write_bytes(out, content)
    difference, rounding = max(error.onnx for error in errors), max(error.torch for error in errors)
    return Export(out, difference, rounding, torch_seconds, _latency(lambda: answer(features)))


def _latency(call: Callable[[], object]) -> float:
    seconds = []
    for _ in range(REPETITIONS):
        start = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds))
