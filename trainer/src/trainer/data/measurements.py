"""What ``trainer predict`` images: the frames of a dataset, or a radar cube from a file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from shared.dataset.folder import MANIFEST, SPLITS, open_dataset
from shared.dataset.locations import Location, RemotePath, locate
from shared.dataset.reading import radar_of
from shared.physics.errors import InputError
from shared.radar import Radar, first_validation_error, load_radar
from shared.signal.spectrum import range_doppler, select_doppler, unfold
from shared.signal.windows import cell_noise_power
from trainer.data.numpy_files import read_npy, read_npz

LARGEST_SAMPLE = 1e12
"""Of a cube [sqrt(W), or counts of a converter]; powers of more, summed over a frame, leave single precision."""


@dataclass(frozen=True, eq=False)
class Measurement:
    """One frame to be imaged.

    :param name: of its files
    :param frame_id: index in its dataset, 0 for a cube
    :param range_channel: [D, R, C] complex64 at the D strongest Doppler peaks of every range bin [sqrt(W)]
    :param velocity: [D, R] of those peaks [m/s]
    :param noise_power: of one channel and cell [W]
    :param truth: [R, U] relative to its peak, if known
    """

    name: str
    frame_id: int
    range_channel: NDArray[np.complex64]
    velocity: NDArray[np.float32]
    noise_power: float
    truth: NDArray[np.float32] | None


def open_measurements(source: Location | str, radar: str | None, split: str) -> tuple[Radar, Iterator[Measurement]]:
    """The radar and the frames of a dataset's split, local or remote, or of a cube.

    A cube is complex64 [chirp, sample, C]: a ``.npy`` with its radar named by ``radar``, or a ``.npz`` with ``cube``
    and ``radar``, the fields of a radar file as JSON text.

    :raises InputError: neither, or one that is damaged or does not fit its radar
    """
    source = locate(source)
    if isinstance(source, RemotePath) or source.is_dir():
        if radar is not None:
            raise InputError("--radar", f"{radar!r} beside a dataset", "no --radar: the dataset holds its own")
        dataset = open_dataset(source)
        chosen = SPLITS if split == "all" else (split,)
        if split != "all":
            dataset.shards(split)
        columns = ("range_channel", "velocity", "image")
        frames = (
            Measurement(
                f"frame-{f.frame_id:06d}", f.frame_id, f.range_channel, f.velocity, f.noise_power, np.array(f.image)
            )
            for name in chosen if name in dataset.splits
            for f in dataset.frames(name, columns)
        )  # fmt: skip
        return radar_of(dataset.description(), source / MANIFEST), frames
    cube, found = _read_cube(source, radar)
    expected = (found.waveform.chirps, found.waveform.samples, found.array.channels)
    if cube.shape != expected or not np.iscomplexobj(cube):
        raise InputError(
            source, f"cube is {cube.dtype} {list(cube.shape)}",
            f"complex64 [chirp, sample, channel] = {list(expected)} of radar {found.name!r}",
        )  # fmt: skip
    if bad := int(np.count_nonzero(~np.isfinite(cube))):
        raise InputError(source, f"cube has {bad} values that are not finite", "finite samples")
    if (largest := np.abs(cube).max()) > LARGEST_SAMPLE:
        raise InputError(source, f"cube has samples of {largest:.3g}", f"at most {LARGEST_SAMPLE:g}")
    noise_power = cell_noise_power(found)
    selection = unfold(select_doppler(range_doppler(cube.astype(np.complex64), found), noise_power), found)
    velocity = selection.velocities_mps(found.waveform).astype(np.float32)
    measurement = Measurement(source.stem, 0, selection.range_channel, velocity, noise_power, None)
    return found, iter((measurement,))


def _read_cube(source: Path, radar: str | None) -> tuple[NDArray, Radar]:
    if not source.is_file() or source.suffix not in (".npy", ".npz"):
        raise InputError("INPUT", f"{source}", "the folder of a dataset, or a cube as .npy or .npz")
    if source.suffix == ".npy":
        if radar is None:
            raise InputError("--radar", "not given", f"the radar that measured {source}")
        return read_npy(source), load_radar(radar)
    content = read_npz(source)
    if missing := {"cube", "radar"} - content.keys():
        raise InputError(source, f"no array {min(missing)!r}", "the arrays 'cube' and 'radar'")
    cube, text = content["cube"], str(content["radar"])
    if radar is not None:
        return cube, load_radar(radar)
    try:
        return cube, Radar.model_validate({"name": source.stem, **json.loads(text)})
    except ValidationError as error:
        raise InputError(f"{source}: radar", *first_validation_error(error)) from error
    except (ValueError, TypeError, RecursionError) as error:
        raise InputError(source, f"radar is not JSON: {error}", "a radar's fields as JSON text") from error
