"""The dataset's format: schema, writing, reading, folders, locations."""

from shared.dataset.schema import (
    COMPLEX_ARRAYS,
    LATER,
    METADATA_KEY,
    SCALARS,
    STORES,
    VECTORS,
    VERSION,
    Box,
    Frame,
    Target,
    arrow_schema,
    description,
    row_bytes,
    to_record_batch,
)

__all__ = [
    "COMPLEX_ARRAYS",
    "LATER",
    "METADATA_KEY",
    "SCALARS",
    "STORES",
    "VECTORS",
    "VERSION",
    "Box",
    "Frame",
    "Target",
    "arrow_schema",
    "description",
    "row_bytes",
    "to_record_batch",
]
