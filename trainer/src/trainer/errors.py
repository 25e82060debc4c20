"""What stops a run that was started well."""

from __future__ import annotations


class Stopped(RuntimeError):
    """What cannot go on, in one line: a loss that is not finite with its frames, an export that is not the network."""


def out_of_memory(error: BaseException) -> bool:
    """Whether an error says that memory was not there; torch has no class of its own for that of the processor."""
    said = str(error).lower()
    return isinstance(error, MemoryError) or any(words in said for words in ("out of memory", "allocate memory"))
