"""What of this machine a run may use: all of it, or less in a container or a batch job.

Linux holds a process to the limits of its control group and of all groups above it (cgroups(7)): Docker, Kubernetes and
Slurm set them. ``psutil`` shows the machine's memory also within a container.
"""

from __future__ import annotations

import ctypes
import os
import sys
from multiprocessing import current_process
from pathlib import Path, PurePosixPath

MOUNTED = Path("/sys/fs/cgroup")
GROUPS_OF_THIS = Path("/proc/self/cgroup")
MMAP_THRESHOLD, TRIM_THRESHOLD = -3, -1
"""Numbers of ``mallopt`` (malloc.h): from which size an array has pages of its own, handed back when it is freed; and
how much free memory at the end of the heap is handed back."""
PAGES_OF_ITS_OWN = 32 * 2**20
"""Bytes; the library takes no more."""
KEPT = 2**30
"""Bytes."""


def usable_cores() -> int:
    """Cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def may_start_processes() -> bool:
    """Whether this process may have worker processes: a daemonic one, say of ``multiprocessing.Pool``, may not."""
    return not current_process().daemon


def usable_memory() -> int:
    """Bytes that all processes of a run together may take."""
    import psutil  # not at the top: `datafactory doctor` says what is missing

    return min([psutil.virtual_memory().total, *group_limits(_text(GROUPS_OF_THIS), MOUNTED)])


def group_limits(groups: str, mounted: Path) -> list[int]:
    """Limits [bytes] of the control groups, and of those above them; empty where there are none.

    :param groups: the text of ``/proc/self/cgroup``: a line ``ID:controllers:path`` for each hierarchy
    :param mounted: where the hierarchies are seen. A container may see its own group in place of the root.
    """
    found = []
    for line in groups.splitlines():
        _, controllers, path = line.split(":", 2)
        if controllers == "":  # version 2
            root, name = mounted, "memory.max"
        elif "memory" in controllers.split(","):  # version 1
            root, name = mounted / "memory", "memory.limit_in_bytes"
        else:
            continue
        group = PurePosixPath(path.lstrip("/"))
        for folder in (group, *group.parents):
            found.append(_text(root / folder / name).strip())
    # Of a group that is not limited version 2 has the word "max", version 1 a number near 2**63.
    return [int(text) for text in found if text.isdigit()]


def _text(path: Path) -> str:
    """Of a file of the system, "" where it is not seen from here: no Linux, or another container's."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""


def keep_freed_memory() -> None:
    """Let this process keep what it frees, where its C library is the GNU one; elsewhere nothing happens.

    A frame takes and frees gigabytes in arrays of megabytes. That library hands such memory back to the system at once,
    and the system clears every page anew: 2300 page faults a frame of munich, up to a tenth of a second. With these
    limits it keeps what was freed, and 150 are left. The largest size of a process hardly changes, because the next
    frame takes as much.
    """
    if not sys.platform.startswith("linux"):
        return
    set_limit = getattr(ctypes.CDLL(None), "mallopt", None)
    if set_limit is not None:
        set_limit(MMAP_THRESHOLD, PAGES_OF_ITS_OWN)
        set_limit(TRIM_THRESHOLD, KEPT)
