"""Arrays as the bytes of NumPy's files."""

import io
import zipfile
from typing import Any

import numpy as np


def of_array(values: Any) -> bytes:
    """A ``.npy`` file."""
    buffer = io.BytesIO()
    np.save(buffer, np.asarray(values))
    return buffer.getvalue()


def npz(**members: bytes) -> bytes:
    """A ``.npz`` file of ``.npy`` files, whatever they hold."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return buffer.getvalue()
