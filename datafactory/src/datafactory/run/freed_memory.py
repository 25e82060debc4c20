"""Memory that a frame frees stays with the process, which the next frame asks for as much again.

A frame takes and frees gigabytes in arrays of megabytes. The GNU C library hands such memory back to the system at
once, and the system clears every page anew: 2300 page faults a frame of munich, up to a tenth of a second. With these
limits it keeps what was freed, and 150 are left. The largest size of a process hardly changes, because the next frame
takes as much.
"""

from __future__ import annotations

import ctypes
import sys

MMAP_THRESHOLD, TRIM_THRESHOLD = -3, -1
"""Numbers of ``mallopt`` (malloc.h): from which size an array has pages of its own, handed back when it is freed; and
how much free memory at the end of the heap is handed back."""
PAGES_OF_ITS_OWN = 32 * 2**20
"""Bytes; the library takes no more."""
KEPT = 2**30
"""Bytes."""


def keep_freed_memory() -> None:
    """Let this process keep what it frees, where its C library is the GNU one; elsewhere nothing happens."""
    if not sys.platform.startswith("linux"):
        return
    set_limit = getattr(ctypes.CDLL(None), "mallopt", None)
    if set_limit is not None:
        set_limit(MMAP_THRESHOLD, PAGES_OF_ITS_OWN)
        set_limit(TRIM_THRESHOLD, KEPT)
