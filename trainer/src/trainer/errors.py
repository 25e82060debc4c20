"""What stops a run that was started well."""

from __future__ import annotations


class TrainingStopped(RuntimeError):
    """A run that cannot go on, in one line: a loss that is not finite, with the frames that caused it."""
