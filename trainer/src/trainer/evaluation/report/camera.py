"""The picture of a camera at the sensor, small enough for a page of fifty."""

from __future__ import annotations

import io

from PIL import Image, UnidentifiedImageError

from shared.dataset.folder import Dataset, camera_path
from shared.physics.errors import InputError

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
