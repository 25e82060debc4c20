"""What stops a run that was started well."""

from __future__ import annotations


class TrainingStopped(RuntimeError):
    """What cannot go on, in one line: a loss that is not finite with its frames, an export that is not the network."""
