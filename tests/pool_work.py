"""What the workers of the pool's tests do; a module, so that worker processes can import it."""

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Squares:
    """Squares a number; some numbers are deadly.

    :param folder: gets a file ``began-PID`` of each process, which names the signals that it does not hear
    :param deaths: number -> processes that die of it before one does not
    :param seconds: that each number takes
    """

    folder: Path
    deaths: dict[int, int]
    seconds: float = 0.0
    dies_at_the_start: int = 0

    def begin(self) -> None:
        """Note the process; the first ones may die of that alone."""
        begun = len(list(self.folder.glob("began-*")))
        blocked = " ".join(signal.Signals(number).name for number in signal.pthread_sigmask(signal.SIG_BLOCK, ()))
        unfinished = self.folder / f"new-{os.getpid()}"
        unfinished.write_text(blocked, encoding="utf-8")
        unfinished.rename(self.folder / f"began-{os.getpid()}")
        if begun < self.dies_at_the_start:
            os.kill(os.getpid(), signal.SIGKILL)

    def __call__(self, item: int) -> tuple[int, bytes]:
        time.sleep(self.seconds)
        if item < 0:
            raise ValueError(f"{item} has no square here; expected a positive number")
        died = list(self.folder.glob(f"died-{item}-*"))
        if len(died) < self.deaths.get(item, 0):
            (self.folder / f"died-{item}-{len(died)}").touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return item * item, bytes(300_000)  # more than a pipe takes at a time


def note_process(folder: Path) -> None:
    """What a process does that does not know its work yet."""
    (folder / f"ready-{os.getpid()}").touch()
