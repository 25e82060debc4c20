"""Cubes in files: what ``trainer import`` writes, and what ``predict`` and ``evaluate`` read (docs/captures.md).

The channels of a ``.npz``'s cube are rx-major, channel = TX count * rx + tx; its :class:`Capture` is sealed
(:mod:`shared.dataset.documents`), and there is none where the cube was simulated or written by hand. The samples follow
eq. (1) of the paper, exp(+j 2 pi (mu t tau + f_c tau)): a target on the left has u > 0, a receding one a positive
velocity (:mod:`shared.signal.signal`). A ``.npy`` holds the cube alone; its radar is named beside it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat

from shared.dataset.documents import sealed, unsealed
from shared.dataset.writing import atomic
from shared.physics.errors import InputError
from shared.physics.units import db_to_power, power_to_db
from shared.radar import Radar, load_radar, validated
from shared.radar.validation import Described
from shared.signal.spectrum import range_doppler
from shared.signal.windows import cell_noise_power
from trainer.captures.reading import read_arrays
from trainer.captures.samples import first_frame

LARGEST_SAMPLE = 1e12
"""Of a cube [sqrt(W), or counts of a converter]; powers of more, summed over a frame, leave single precision."""
OTHER_UNIT_DB = 30.0
"""Noise so far above the radar's thermal noise is that of samples in another unit: counts of a converter have 110 dB or
more. A street's echoes raise what is measured in simulated cubes by less than 2 dB, of one chirp too."""
SHA256 = r"^[0-9a-f]{64}$"

Sha256 = Annotated[str, Field(pattern=SHA256)]
Scale = Literal["sqrt(W)", "relative"]
Channel = Annotated[int, Field(ge=0)]


class Capture(Described):
    """Where an imported cube comes from, and what its numbers mean.

    :param source: name of the file that was imported
    :param source_sha256: of that file; of several files, of their digests one after the other
    :param board: name of the board, see :mod:`shared.radar.boards`
    :param frames: in the cube
    :param scale: "sqrt(W)" where the converter's full scale is known, else "relative": the samples are in units of the
        converter, and levels mean something only relative to each other
    :param noise_power: of one channel in one range-Doppler cell, in the square of the cube's unit, as measured
    :param calibration: SHA-256 of the calibration file that was applied; None without
    :param model_error_db: what calibration left of a reflector, power relative to the reflector's [dB]; None if unknown
    :param dead_channels: channels without an echo, which nothing should be concluded from
    """

    source: str
    source_sha256: Sha256
    board: str
    frames: Annotated[int, Field(ge=1)]
    scale: Scale
    noise_power: Annotated[FiniteFloat, Field(ge=0)]
    calibration: Sha256 | None = None
    model_error_db: FiniteFloat | None = None
    dead_channels: tuple[Channel, ...] = ()


@dataclass(frozen=True, eq=False)
class CubeFile:
    """A cube that was read.

    :param cube: [frame, chirp, sample, C] complex64
    :param capture: None for a cube that was not imported
    """

    cube: NDArray[np.complex64]
    radar: Radar
    capture: Capture | None

    @cached_property
    def noise_power(self) -> float:
        """Of one channel in one cell, in the square of the cube's unit: as the capture states it, else the thermal one.

        Measured in a cube without a capture that is not in sqrt(W).
        """
        if self.capture is not None:
            return self.capture.noise_power
        thermal, most = cell_noise_power(self.radar), float(db_to_power(OTHER_UNIT_DB))
        # There is no more noise than power: the frames of most cubes need no second transform.
        if np.mean(np.abs(self.cube[first_frame(self.cube)]) ** 2) <= most * self.radar.sample_noise_power_w:
            return thermal
        measured = measured_noise(self.cube, self.radar)
        return measured if measured > most * thermal else thermal

    @property
    def unit_remark(self) -> str | None:
        """What a user is told of a cube whose noise was measured here."""
        excess = power_to_db(self.noise_power / cell_noise_power(self.radar))
        if self.capture is not None or excess <= OTHER_UNIT_DB:
            return None
        return (
            f"noise as measured in the cube, {excess:.0f} dB above the radar's thermal noise: the samples are not in "
            "sqrt(W), and levels are relative"
        )


def measured_noise(cube: NDArray[np.complex64], radar: Radar, dead: tuple[int, ...] = ()) -> float:
    """Power of one channel in one range-Doppler cell that holds no echo: the median over the cells of the first
    frame that is not empty.

    Of complex Gaussian noise the median power is ln 2 of the mean. It is right while less than half of the cells hold
    an echo; where more do, it is too high.
    """
    alive = [channel for channel in range(cube.shape[3]) if channel not in dead] or list(range(cube.shape[3]))
    spectra = range_doppler(cube[first_frame(cube)], radar)[..., alive]
    return float(np.median(np.abs(spectra) ** 2) / np.log(2.0))


def write_cube(path: Path, cube: NDArray[np.complexfloating], radar: Radar, capture: Capture) -> None:
    """Write ``path`` in one step; the same content makes the same bytes.

    :param cube: [frame, chirp, sample, C]; of one frame that axis is left out in the file
    """
    stored = cube.astype(np.complex64, copy=False)
    text = json.dumps(sealed(capture.model_dump(mode="json")), sort_keys=True)
    with atomic(path) as partial, partial.open("wb") as handle:
        np.savez(
            handle,
            cube=stored[0] if capture.frames == 1 else stored,
            radar=np.asarray(radar.model_dump_json()),
            capture=np.asarray(text),
        )


def read_cube(path: Path, radar: str | None) -> CubeFile:
    """A cube with its radar, checked.

    :param radar: a preset or TOML file, of a ``.npy`` alone
    :raises InputError: a file that is missing, damaged or without what it needs, or that does not fit its radar
    """
    if not path.is_file() or path.suffix not in (".npy", ".npz"):
        raise InputError("INPUT", f"{path}", "the folder of a dataset, or a cube as .npy or .npz")
    if path.suffix == ".npz" and radar is not None:
        raise InputError("--radar", f"{radar!r} beside a .npz", f"no --radar: {path} holds its own")
    capture = None
    if path.suffix == ".npy":
        if radar is None:
            raise InputError("--radar", "not given", f"the radar that measured {path}")
        cube, found = read_arrays(path)["array"], load_radar(radar)
    else:
        content = read_arrays(path)
        if missing := {"cube", "radar"} - content.keys():
            raise InputError(path, f"no array {min(missing)!r}", "the arrays 'cube' and 'radar'")
        cube = content["cube"]
        named = {"name": path.stem, **_fields(path, "radar", str(content["radar"]))}
        found = validated(Radar, named, f"{path}: radar")
        if "capture" in content:
            entries = unsealed(path, _fields(path, "capture", str(content["capture"])))
            capture = validated(Capture, entries, f"{path}: capture")
    frames = checked_cube(path, cube, found)
    if capture is not None and capture.frames != len(frames):
        raise InputError(path, f"capture says {capture.frames} frames, cube has {len(frames)}", "one as it was written")
    if capture is not None and (beyond := [n for n in capture.dead_channels if n >= frames.shape[-1]]):
        problem = f"capture names the dead channel {beyond[0]}"
        raise InputError(path, problem, f"one of the {frames.shape[-1]} of the cube")
    if capture is not None and capture.noise_power == 0.0 and frames.any():
        problem = "capture says a noise of 0 beside samples that are not 0"
        raise InputError(path, problem, f"{capture.source} imported anew")
    return CubeFile(frames, found, capture)


def frame_shape(radar: Radar) -> tuple[int, int, int]:
    """(chirps, samples, channels) of a frame's cube."""
    return radar.waveform.chirps, radar.waveform.samples, radar.array.channels


def checked_cube(source: Path | str, cube: NDArray[Any], radar: Radar, several: bool = True) -> NDArray[np.complex64]:
    """[frame, chirp, sample, C] of one or several frames of a radar.

    :param several: whether there may be several
    :raises InputError: of another shape, not complex, not finite or beyond :data:`LARGEST_SAMPLE`
    """
    expected = frame_shape(radar)
    axes = (3, 4) if several else (3,)
    if cube.shape[-3:] != expected or cube.ndim not in axes or not cube.size or not np.iscomplexobj(cube):
        more = ", or several such frames" if several else ""
        shape = f"complex64 [chirp, sample, channel] = {list(expected)} of radar {radar.name!r}{more}"
        raise InputError(source, f"cube is {cube.dtype} {list(cube.shape)}", shape)
    if bad := int(np.count_nonzero(~np.isfinite(cube))):
        raise InputError(source, f"cube has {bad} values that are not finite", "finite samples")
    require_moderate(source, cube)
    return cube.reshape(-1, *expected).astype(np.complex64)


def require_moderate(source: Path | str, cube: NDArray[np.complexfloating]) -> None:
    """Refuse samples that are too large.

    :param cube: of any shape
    :raises InputError: a sample beyond :data:`LARGEST_SAMPLE`
    """
    if (largest := np.abs(cube).max()) > LARGEST_SAMPLE:
        raise InputError(source, f"cube has samples of {largest:.3g}", f"at most {LARGEST_SAMPLE:g}")


def _fields(path: Path, name: str, text: str) -> dict[str, Any]:
    """The JSON object that an array of text holds."""
    try:
        fields = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(path, f"{name} is not JSON: {error}", f"a {name}'s fields as JSON text") from error
    if not isinstance(fields, dict):
        raise InputError(path, f"{name} is {type(fields).__name__}", f"a {name}'s fields as JSON text")
    return fields
