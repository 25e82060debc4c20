"""What the page shows of a frame: images of different units on one dB scale, the range-Doppler map or the peaks that
its shard has of it, and the picture of a camera at the sensor."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from shared.dataset import Frame
from shared.dataset.folder import Dataset, camera_path
from shared.physics.errors import InputError
from shared.pictures import level_db, range_weighted
from shared.radar import Radar
from shared.signal.spectrum import range_doppler
from trainer.run.targets import AMPLITUDE, PROBABILITY

REPORT_SPAN_DB = 60.0
"""Levels that the report keeps below 0 dB."""
STEPS = 255
"""A level is kept as a byte, 0 for the floor: steps of 0.24 dB."""


def scene_levels(
    image: NDArray[np.floating], unit: str, truth: NDArray[np.floating] | None, span_db: float = REPORT_SPAN_DB
) -> NDArray[np.float64]:
    """[R, U] levels [dB] of a scene, at most 0.

    Amplitudes are weighted by range first: an echo falls with R^2, and a picture has 40 dB. Images in sqrt(W) stand
    under the maximum of the truth, where there is one, so that too weak and too strong ones show; others under their
    own.

    :param truth: [R, U] magnitude [sqrt(W)] or None
    """
    shown = image if unit == PROBABILITY else range_weighted(image)
    reference = float(shown.max())
    if unit == AMPLITUDE and truth is not None and truth.any():
        reference = float(range_weighted(truth).max())
    return level_db(shown, reference, span_db)


def own_levels(image: NDArray[np.floating], span_db: float = REPORT_SPAN_DB) -> NDArray[np.float64]:
    """Levels [dB] below the image's own maximum, for point targets."""
    return level_db(image, float(image.max()), span_db)


def to_bytes(levels_db: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Levels [dB] from -:data:`REPORT_SPAN_DB` to 0 as 0 to 255."""
    return np.rint(STEPS * (1.0 + np.maximum(levels_db / REPORT_SPAN_DB, -1.0))).astype(np.uint8)


def from_bytes(levels: NDArray[np.uint8]) -> NDArray[np.float64]:
    """[dB], the inverse of :func:`to_bytes` within half a step."""
    return REPORT_SPAN_DB * (levels / STEPS - 1.0)


WHOLE, PEAKS = "range-Doppler map", "strongest Doppler peaks"


def doppler_map(frame: Frame, radar: Radar) -> tuple[str, NDArray[np.float64]]:
    """(:data:`WHOLE` or :data:`PEAKS`, [R, chirps] mean magnitude over channels on the rising velocity axis [sqrt(W)]).

    Of peaks alone the other cells are 0. An unfolded velocity stands in the cell that it folds to.
    """
    if frame.range_doppler is not None:
        return WHOLE, np.asarray(frame.range_doppler, dtype=np.float64)
    if frame.cube is not None:
        return WHOLE, np.abs(range_doppler(frame.cube, radar)).mean(axis=2).astype(np.float64)
    waveform = radar.waveform
    cells = np.rint((frame.velocity - waveform.velocities_mps[0]) / waveform.velocity_step_mps).astype(np.int64)
    magnitude = np.zeros((waveform.range_bins, waveform.chirps))
    rows = np.broadcast_to(np.arange(waveform.range_bins), cells.shape)
    magnitude[rows, cells % waveform.chirps] = np.abs(frame.range_channel).mean(axis=2)
    return PEAKS, magnitude


WIDTH = 800
QUALITY = 85


def small_picture(dataset: Dataset, frame_id: int) -> bytes:
    """JPEG of a frame's camera picture, at most :data:`WIDTH` pixels wide; empty where the dataset has none.

    :raises InputError: a file that is no picture
    """
    picture = dataset.camera(frame_id)
    if picture is None:
        return b""
    buffer = io.BytesIO()
    try:
        with Image.open(io.BytesIO(picture)) as image:
            image.thumbnail((WIDTH, WIDTH))
            image.convert("RGB").save(buffer, format="jpeg", quality=QUALITY)
    except (UnidentifiedImageError, OSError, SyntaxError) as error:
        raise InputError(
            camera_path(dataset.path, frame_id), f"no picture: {error}", "the file as render --camera wrote it"
        ) from error
    return buffer.getvalue()
