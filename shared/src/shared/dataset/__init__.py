"""The dataset's format: schema, writing, reading, folders, locations."""

from shared.dataset.schema import COMPLEX_ARRAYS as COMPLEX_ARRAYS
from shared.dataset.schema import LATER as LATER
from shared.dataset.schema import METADATA_KEY as METADATA_KEY
from shared.dataset.schema import SCALARS as SCALARS
from shared.dataset.schema import STORES as STORES
from shared.dataset.schema import VECTORS as VECTORS
from shared.dataset.schema import VERSION as VERSION
from shared.dataset.schema import Box as Box
from shared.dataset.schema import Frame as Frame
from shared.dataset.schema import Target as Target
from shared.dataset.schema import arrow_schema as arrow_schema
from shared.dataset.schema import description as description
from shared.dataset.schema import row_bytes as row_bytes
from shared.dataset.schema import to_record_batch as to_record_batch
