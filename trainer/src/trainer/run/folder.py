"""A run folder: what the run was made with and what came out, readable without executing anything that it holds.

RUN/run.json             configuration, radar, array, fingerprints of the datasets, versions, and the checksum of all
RUN/weights.safetensors  of the best validation, its metadata the gain and the checksum of both
RUN/metrics.csv          one line for each validation
RUN/last.ckpt            for --resume: plain tensors and numbers, loaded with weights_only
RUN/tensorboard/         curves and pictures
RUN/verdict.json         scores on the test split, beside RUN/pictures/test.png

It is held for one command, from before that reads any data until it ends, as the folder of every command is.
"""

from __future__ import annotations

import csv
import errno
import hashlib
import math
import platform
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import torch
from pydantic import BaseModel, ValidationError
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from shared.dataset.claims import claimed
from shared.dataset.documents import read_json, sealed, unsealed
from shared.dataset.folder import ShardRecord
from shared.dataset.locations import Location, folder_name, sha256_of
from shared.dataset.writing import write_bytes, write_json
from shared.physics.errors import InputError, Told
from shared.radar import Radar, validated
from trainer.data.arrays import ArrayChoice
from trainer.run.configuration import FitConfig, first_difference
from trainer.run.imager import Imager, lay_out

JOB = ".job"
"""Folder of the lock and of what worker processes are given; it is there only while a command is at work."""


class SceneRecord(BaseModel, frozen=True, extra="forbid"):
    """One scene of a dataset.

    :param name: as the frames' column ``scene`` has it
    :param content_sha256: over geometry, materials, motion and targets, what was put in included
    :param populate: what ``--populate`` put in, as it was asked for; None for a scene as its file has it
    """

    name: str
    content_sha256: str
    populate: str | None = None


def scene_records(manifest: Mapping[str, Any]) -> tuple[SceneRecord, ...] | None:
    """The scenes of a manifest in its order; None where it does not say them, as one of another maker may not.

    A dataset of close targets alone has none.
    """
    try:
        return tuple(
            SceneRecord(
                name=entry["name"],
                content_sha256=entry["content_sha256"],
                populate=entry["population"]["populate"] if "population" in entry else None,
            )
            for entry in manifest["scenes"]
        )
    except (KeyError, TypeError, ValidationError):
        return None


@contextmanager
def output_folder(out: Path, resume: bool, remedy: str = "an empty or new folder") -> Iterator[Path]:
    """Hold the folder for one command; yields the place for what worker processes are given.

    :param resume: the folder may hold something
    :param remedy: what to do about a folder that is not empty
    :raises InputError: a folder that cannot be written, that another process works in, or that is not empty
    """

    def check() -> None:
        if not resume and any(item.name != JOB for item in out.iterdir()):
            raise InputError("--out", f"{out} is not empty", remedy)

    with claimed(out, out / JOB, "--out", check):
        workers = out / JOB / "workers"
        shutil.rmtree(workers, ignore_errors=True)  # of a command that was killed
        try:
            yield workers
        except OSError as error:
            if error.filename is not None:
                raise
            # What a library writes, TensorBoard for one, does not say where.
            reason = error.strerror or " ".join(str(error).split())
            raise OSError(error.errno or errno.EIO, reason, str(out)) from error


RUN_VERSION = 1
RUN_FILE = "run.json"
WEIGHTS = "weights.safetensors"
CHECKPOINT = "last.ckpt"
METRICS = "metrics.csv"
LOSS, VALIDATION_GAIN = "validation_loss", "validation_gain"
METRICS_COLUMNS = ("step", "train_loss", LOSS, "validation_nmse", VALIDATION_GAIN, "das_nmse")
GAIN = "gain"
"""The one entry of the weights' metadata: what images are multiplied by, and the SHA-256 of that and of the weights. Of
two entries safetensors writes now this one, now that one first, and equal weights would differ."""
PACKAGES = ("sparseradar-trainer", "sparseradar-shared", "torch", "lightning", "numpy", "pyarrow")


class Fingerprint(BaseModel, frozen=True, extra="forbid"):
    """Which dataset a run has seen.

    :param sha256: over the shards' own hashes
    :param frames: by split, those that a run trains and validates with, and all of the test split
    :param scenes: that the frames to train and to validate with are of; None where the dataset did not say
    """

    name: str
    sha256: str
    frames: dict[str, int]
    scenes: tuple[SceneRecord, ...] | None = None

    def __str__(self) -> str:
        return f"{self.name} ({self.sha256[:8]})"

    @classmethod
    def of(
        cls,
        directory: Location,
        records: Iterable[ShardRecord],
        frames: Mapping[str, int],
        scenes: tuple[SceneRecord, ...] | None = None,
    ) -> Fingerprint:
        lines = "\n".join(f"{record.path} {record.sha256}" for record in records)
        sha256 = hashlib.sha256(lines.encode()).hexdigest()
        return cls(name=folder_name(directory), sha256=sha256, frames=dict(frames), scenes=scenes)


class Start(BaseModel, frozen=True, extra="forbid"):
    """Which weights a run began with, if not with random ones.

    :param sha256: of its weights' file
    :param trained_on: datasets that these weights have seen
    """

    name: str
    sha256: str
    trained_on: tuple[Fingerprint, ...]

    def __str__(self) -> str:
        return f"{self.name} ({self.sha256[:8]})"

    @classmethod
    def of(cls, directory: Path) -> Start:
        """:raises InputError: no weights there, or no run"""
        path = _weights(directory)
        return cls(name=directory.resolve().name, sha256=sha256_of(path), trained_on=read_run(directory).trained_on)


class Run(Told, BaseModel, frozen=True, extra="forbid"):
    """All that is needed to use a run's weights, and to say where they come from.

    :param processes: that trained together: a batch is that many times as large
    """

    version: int = RUN_VERSION
    config: FitConfig
    radar: Radar
    array: ArrayChoice
    datasets: tuple[Fingerprint, ...]
    weights: tuple[float, ...] | None = None
    versions: dict[str, str] = {}
    start: Start | None = None
    processes: int = 1

    def __str__(self) -> str:
        seen = "; ".join(
            f"{data.name} ({', '.join(f'{count} {split}' for split, count in data.frames.items())})"
            for data in self.datasets
        )
        return "\n".join([
            f"run of {self.config.model}, {self.config.steps} steps, seed {self.config.seed}",
            f"array {self.array.name}: RX {', '.join(map(str, self.array.rx))} of radar "
            f"{self.radar.name}, which has {len(self.radar.array.rx_m)}",
            f"datasets: {seen or 'none'}",
            f"began with {'random weights' if self.start is None else f'the weights of {self.start.name}'}",
        ])  # fmt: skip

    @property
    def trained_on(self) -> tuple[Fingerprint, ...]:
        """The datasets that its weights have seen: its own, and before them those of the run that it began with."""
        return (*(() if self.start is None else self.start.trained_on), *self.datasets)


def versions() -> dict[str, str]:
    """Of the packages that a run's weights depend on."""
    return {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}}


def write_run(directory: Path, run: Run) -> None:
    """Write ``run.json`` into an existing folder."""
    write_json(directory / RUN_FILE, sealed(run.model_dump(mode="json")), sort_keys=False)


def read_run(directory: Path) -> Run:
    """The run of a folder.

    :raises InputError: no run folder, not JSON, a newer version, entries that were changed, a value that no run has
    """
    path = directory / RUN_FILE
    if not path.is_file():
        raise InputError(directory, f"no {RUN_FILE}", "a run folder made by trainer fit")
    document = read_json(path, "a run made by trainer fit")
    found = document.get("version") if isinstance(document, dict) else None
    if found != RUN_VERSION:
        raise InputError(path, f"version = {found!r}", f"run version {RUN_VERSION}")
    return validated(Run, unsealed(path, document), path)


class Validation(NamedTuple):
    """A line of ``metrics.csv``.

    :param step: optimiser steps before it
    :param loss: the run keeps the weights of the first that has the least
    :param gain: of the linear image; 1 where that has no amplitudes
    """

    step: int
    loss: float
    gain: float


def read_validations(directory: Path) -> list[Validation]:
    """All of a run, the first of them before the first step.

    :raises InputError: none there, a line that is cut short
    """
    path = directory / METRICS
    try:
        with path.open(newline="", encoding="utf-8") as file:
            found = [
                Validation(int(row["step"]), float(row[LOSS]), float(row[VALIDATION_GAIN] or 1.0))
                for row in csv.DictReader(file)
            ]
    except (OSError, ValueError, TypeError, KeyError, csv.Error) as error:
        raise InputError(path, f"not readable: {error}", "the validations of a run") from error
    if not found:
        raise InputError(path, "no validation", "the validations of a run")
    return found


def save_weights(directory: Path, imager: Imager, gain: float = 1.0) -> None:
    """Write ``weights.safetensors``, whole or not at all; the gain stands in its metadata."""
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in imager.network.state_dict().items()}
    written = repr(float(gain))
    write_bytes(directory / WEIGHTS, save(tensors, metadata={GAIN: f"{written} {_digest(tensors, written)}"}))


def _digest(tensors: Mapping[str, torch.Tensor], gain: str) -> str:
    """SHA-256 of the gain and of all weights."""
    digest = hashlib.sha256(gain.encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(f"{name} {tensor.dtype} {list(tensor.shape)}".encode())
        digest.update(tensor.contiguous().view(-1).view(torch.uint8).numpy().data)
    return digest.hexdigest()


def _weights(directory: Path) -> Path:
    path = directory / WEIGHTS
    if not path.is_file():
        raise InputError(path, "no such file", "the weights of a run that has validated at least once")
    return path


def load_imager(directory: Path | str) -> tuple[Run, Imager]:
    """The run of a folder of ``trainer fit``, and its imager in evaluation mode, on the CPU.

    >>> run, imager = load_imager(pretrained_run("sparse6"))  # doctest: +SKIP
    >>> imager(example.input, torch.tensor(example.metadata["noise_power"]).expand(3))  # doctest: +SKIP

    An :class:`trainer.run.imager.Imager` takes all channels of its radar, [B, R, C] complex64 [sqrt(W)], and the noise
    power [B] [W] of each image, and returns [B, R, U] magnitudes [sqrt(W)]: one image for each Doppler peak.

    :raises InputError: no run, weights that are missing, cut short, not finite or of another network
    """
    directory = Path(directory)
    run, path = read_run(directory), _weights(directory)
    imager = Imager(run.config, run.radar, run.array)
    try:
        with safe_open(path, framework="pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - it is no mapping
            gain, digest = (file.metadata() or {}).get(GAIN, "").split()
            imager.gain = float(gain)
            if digest != _digest(tensors, gain):
                raise ValueError("its weights are not as they were written")
    except (SafetensorError, OSError, ValueError, AttributeError, MemoryError) as error:
        raise InputError(path, f"not readable as safetensors: {error}", "a whole weights file") from error
    if not math.isfinite(imager.gain):
        raise InputError(path, f"{GAIN} = {imager.gain}", "a finite number")
    expected = imager.network.state_dict()
    for name in sorted(expected.keys() | tensors.keys()):
        kinds = [_kind(state[name]) if name in state else "not there" for state in (tensors, expected)]
        if kinds[0] != kinds[1]:
            described = f"{run.config.model} of {RUN_FILE}"
            raise InputError(path, f"{name} is {kinds[0]}", f"{kinds[1]}, as the {described} has it")
        if not torch.isfinite(tensors[name]).all():
            raise InputError(path, f"{name} has values that are not finite", "the weights of a run that trained")
    imager.network.load_state_dict(tensors)
    lay_out(imager.network, torch.channels_last)
    return run, imager.eval()


def _kind(tensor: torch.Tensor) -> str:
    return f"{str(tensor.dtype).removeprefix('torch.')} {list(tensor.shape)}"


MEASURED = ("array", "grid", "waveform")
"""Parts of a radar that say what a measurement is of."""


def same_radar(
    one: Radar, one_source: str, other: Radar, other_source: str, parts: Sequence[str] = (*MEASURED, "virtual_sensor")
) -> None:
    """Refuse to mix data of different arrays, axes or truths.

    :param parts: of the radars, that are to be the same
    :raises InputError: the first field that differs, with both values and where they come from
    """
    for part in parts:
        first = getattr(one, part)
        if differing := first_difference(first, getattr(other, part), type(first).model_fields):
            name, *values = differing
            shown = [f"{len(v)} positions {v[0]} to {v[-1]}" if isinstance(v, tuple) else f"{v}" for v in values]
            problem = f"radar {other.name!r}, {part}.{name} = {shown[1]}"
            raise InputError(other_source, problem, f"{shown[0]}, as radar {one.name!r} of {one_source} has it")
