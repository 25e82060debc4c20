"""Kills between and within the jobs of an array: ``render --shard`` and ``merge``.

``job`` is one job of three; the other two are finished before. What is compared of it is the merge of all three. After
each kill a merge is tried: as long as the job is not finished it has to be refused with the frames that are missing,
and to leave nothing behind. ``merge`` is the merge itself, killed and resumed. Both have to end in the files of the run
in one piece.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

JOBS = 3
KILLED = f"1/{JOBS}"

Run = Callable[[list[str]], object]
Hashes = Callable[[Path], dict[str, str]]


class ArrayRun:
    """The run in one piece, and the jobs that are not killed.

    :param factory: the command; :param scene: what every job is given
    :param killed: the same, for the job that is killed
    :param run: runs a command that has to succeed; :param hashes: of a dataset's shards
    """

    def __init__(self, factory: str, scene: list[str], killed: list[str], work: Path, run: Run, hashes: Hashes) -> None:
        self._factory, self._work, self._hashes = factory, work, hashes
        frames = ["--frames", "44", "--points", "4"]
        self._render, self._killed = [factory, "render", *scene, *frames], [factory, "render", *killed, *frames]
        self._others = work / "array-others"
        run([*self._render, "--out", str(work / "array-whole")])
        self.expected = hashes(work / "array-whole")
        for number in (0, 2):
            run([*self._render, "--out", str(self._others), "--shard", f"{number}/{JOBS}"])
        self._all = work / "array-all"
        shutil.copytree(self._others, self._all)
        run([*self._render, "--out", str(self._all), "--shard", KILLED])

    def job(self, out: Path) -> list[str]:
        """The command of the job that is killed."""
        return [*self._killed, "--out", str(out), "--shard", KILLED]

    def reference(self, out: Path) -> list[str]:
        """The command of the same job where it is not killed."""
        return [*self._render, "--out", str(out), "--shard", KILLED]

    def merge(self, out: Path) -> list[str]:
        """The command of a merge that is killed."""
        return [self._factory, "merge", str(self._all), "--out", str(out)]

    def merged(self, out: Path) -> dict[str, str]:
        """Hashes of what the finished job and the others merge to.

        :raises OSError: the merge is refused, or is not the run in one piece
        """
        target = self._work / "array-merged"
        shutil.rmtree(target, ignore_errors=True)
        done = self._merge(out, target)
        if done.returncode:
            raise OSError(done.stderr[-800:])
        return self.whole(target)

    def whole(self, folder: Path) -> dict[str, str]:
        """Hashes of a merged dataset.

        :raises OSError: it is not the run in one piece
        """
        found = self._hashes(folder)
        if found != self.expected:
            raise OSError(f"{folder} is not the run in one piece")
        return found

    def fault(self, out: Path) -> str:
        """How a merge with the unfinished job behaves that should be refused; "" where it is."""
        if any(out.glob("job-*/manifest.json")):
            return ""  # killed after its last file
        target = self._work / "array-refused"
        done = self._merge(out, target)
        if done.returncode == 2 and " missing" in done.stderr and done.stderr.count("\n") == 1 and not target.exists():
            return ""
        return f"merge of an unfinished job: status {done.returncode}, {done.stderr[-400:]}"

    def _merge(self, out: Path, target: Path) -> subprocess.CompletedProcess[str]:
        jobs = [str(folder) for folder in (self._others, out) if folder.is_dir() and any(folder.glob("job-*"))]
        command = [self._factory, "merge", *jobs, "--out", str(target)]
        return subprocess.run(command, capture_output=True, text=True, check=False)
