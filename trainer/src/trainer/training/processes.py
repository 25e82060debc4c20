"""Several training processes: the first one writes and speaks, the others end with it, and it says which has ended."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from lightning import Trainer
from torch.distributed import is_torchelastic_launched

from shared.physics.errors import InputError
from shared.processes.pool import PARENT_CHECK_S, end_with_parent
from trainer.training.callbacks import Interrupts


def is_first() -> bool:
    """Whether this process is the first or the only one; launchers tell the others their number."""
    return int(os.environ.get("RANK", os.environ.get("LOCAL_RANK", "0"))) == 0


def launched(devices: int) -> tuple[int, int]:
    """(processes of this machine, machines) that train together; torchrun says both.

    :param devices: that were asked for; 1 for what torchrun says
    :raises InputError: torchrun has started another number
    """
    if not is_torchelastic_launched():
        return devices, 1
    here = int(os.environ["LOCAL_WORLD_SIZE"])
    if devices not in (1, here):
        raise InputError("--devices", f"{devices}, but torchrun has started {here} on this machine", f"{here}, or none")
    return here, int(os.environ["WORLD_SIZE"]) // here


@contextmanager
def follower() -> Iterator[None]:
    """A process that is not the first: Ctrl-C and the end of the first one are for the first one to answer."""
    end_with_parent(os.getppid())
    try:
        with Interrupts(first=False):
            yield
    except Exception:
        # Where the first process is gone the connection to it is lost, and this process ends within that time.
        time.sleep(2.0 * PARENT_CHECK_S)
        raise


def ended_process(trainer: Trainer) -> str:
    """After an error of the first process: which other one has ended, in a line; empty where none has.

    Where one ends, the first process loses the connection to it, and that is the error.
    """
    processes: Sequence[subprocess.Popen[bytes]] = getattr(trainer.strategy.launcher, "procs", ())
    end = time.monotonic() + PARENT_CHECK_S
    while processes and time.monotonic() < end:
        for process in processes:
            if (status := process.poll()) is not None:
                how = signal.Signals(-status).name if status < 0 else f"status {status}"
                wanted = f"{1 + len(processes)} that go on; --resume goes on from the last checkpoint"
                return f"--devices: a training process ended by {how}; expected {wanted}"
        time.sleep(0.02)
    return ""
