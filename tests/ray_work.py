"""What processes of the cluster do in tests; a module, so that they can import it."""

import os
import signal
from collections import Counter
from collections.abc import Iterator, Sequence

import pyarrow as pa

from datafactory.frame.measurement import Hook
from datafactory.run.portions import Job

DEADLY = 7
"""A frame."""


class DeadlyJob(Job):
    """One frame kills the process that makes it."""

    def rows(self, frame_ids: Sequence[int], at: Hook) -> Iterator[tuple[pa.RecordBatch, Counter[str]]]:
        """As it is, but for the deadly frame."""
        if DEADLY in frame_ids:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().rows(frame_ids, at)
