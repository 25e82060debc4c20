"""Kill runs at random points, resume them, and compare what they end in: ``make soak``.

Each round starts a command, kills its whole process group, the process alone or one of its workers after a random time,
and goes on with ``--resume``. After a few kills the run is left to finish, and its files are compared with those of a
run that was never killed. What is counted stands in ``soak_commands.Tally``. The command ``ray`` makes its shards on
a Ray cluster of this machine, whose nodes are killed as well.
"""

import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Annotated

import psutil
import typer

sys.path.append(str(Path(__file__).resolve().parents[1]))  # where this is run as a script

from soak_commands import HANG_S, ROOT, Command, Tally, cluster_for, commands, on_ray, run, table

LOOKS, LOOK_S = 20, 0.25
"""How often, and how far apart, the processes of a command that takes long are looked at."""
ORPHAN_S = 10.0
"""Within this a worker notices that its parent is gone; it looks every half second."""
LONGEST_CHAIN = 8
"""Kills of one run before it is left to finish: what finishes takes as long as two that are killed."""


class Soak:
    """Kills of one command.

    :param work: folder to work in
    :param chance: source of all randomness
    """

    def __init__(self, command: Command, work: Path, chance: random.Random) -> None:
        self.command, self.work, self.chance, self.tally = command, work, chance, Tally()
        reference = work / f"{command.name}-reference"
        self.seconds = run((command.reference or command.arguments)(reference))
        self.expected = command.result(reference)
        self.files = {path.relative_to(reference) for path in reference.rglob("*") if path.is_file()}
        self.runs = 0

    def chain(self, kills: int) -> None:
        """Kill one run up to this many times, then let it finish and compare."""
        out = self.work / f"{self.command.name}-{self.runs}"
        self.runs += 1
        for _ in range(kills):
            if self._killed(out):
                break
        else:
            self._ended(self._start(out), killed=False)
        self._compare(out)
        shutil.rmtree(out, ignore_errors=True)

    def _start(self, out: Path) -> subprocess.Popen[str]:
        resume = ["--resume"] if self._begun(out) else []
        return subprocess.Popen(
            [*self.command.arguments(out), *resume], text=True, start_new_session=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        )  # fmt: skip

    def _begun(self, out: Path) -> bool:
        return out.is_dir() and any(out.iterdir())

    def _killed(self, out: Path) -> bool:
        """Whether the run finished all the same, after one kill."""
        kind = self.chance.choice(self.command.kinds)
        process = self._start(out)
        end = time.monotonic() + self.chance.uniform(0.05, 1.05) * self.seconds
        while time.monotonic() < end and process.poll() is None:
            time.sleep(0.02)
        nodes, family = self.command.nodes, _family(process.pid)
        if process.poll() is not None:
            return self._ended(process, killed=False)
        workers = [item for item in family if item.pid != process.pid and _works(item)]
        if nodes:
            workers = nodes.at_work()
            family += workers
        if kind == "worker" and not workers:
            kind = "parent"
        self.tally.kills[kind] += 1
        if kind == "worker":
            _kill(self.chance.choice(workers).pid, signal.SIGKILL)
            return self._ended(process, killed=False)
        if nodes and kind == "node":
            nodes.lose_one()
            return self._ended(process, killed=False)
        if kind == "group":
            os.killpg(process.pid, signal.SIGKILL)
        else:
            _kill(process.pid, self.chance.choice([signal.SIGKILL, signal.SIGTERM]))
        self._ended(process, killed=True)
        self._count_orphans(family)
        if fault := self.command.fault(out):
            self.tally.differing += 1
            print(f"{out}: {fault}", file=sys.stderr)
        return False

    def _ended(self, process: subprocess.Popen[str], killed: bool) -> bool:
        """Wait for the end; whether the command succeeded."""
        started = time.monotonic()
        while True:
            try:
                _, said = process.communicate(timeout=HANG_S)
                break
            except subprocess.TimeoutExpired:
                if wants_the_processor(process.pid):
                    continue
                self.tally.hangs += 1
                os.killpg(process.pid, signal.SIGKILL)
                process.communicate()
                return False
        if killed:
            self.tally.waited_s = max(self.tally.waited_s, time.monotonic() - started)
        if "Traceback" in said:
            self.tally.tracebacks += 1
            print(said[-2000:], file=sys.stderr)
        return process.returncode == 0

    def _count_orphans(self, family: list[psutil.Process]) -> None:
        _, alive = psutil.wait_procs(family, timeout=ORPHAN_S)
        self.tally.orphans += len(alive)
        for item in alive:
            _kill(item.pid, signal.SIGKILL)

    def _compare(self, out: Path) -> None:
        self.tally.finished += 1
        try:
            got = self.command.result(out)
        except OSError as error:
            got = {"missing": str(error)}
        if got != self.expected:
            self.tally.differing += 1
            print(f"{out}: {got} instead of {self.expected}", file=sys.stderr)
        files = {path.relative_to(out) for path in out.rglob("*") if path.is_file()}
        left = {path for path in files - self.files if path.parts[0] != "tensorboard"}
        if left:
            self.tally.leftovers += len(left)
            print(f"{out}: left over {sorted(map(str, left))}", file=sys.stderr)


def _family(pid: int) -> list[psutil.Process]:
    try:
        parent = psutil.Process(pid)
        return [parent, *parent.children(recursive=True)]
    except psutil.NoSuchProcess:
        return []


def wants_the_processor(pid: int) -> bool:
    """Whether any process of the command runs, or would if it were let."""
    for _ in range(LOOKS):
        for item in _family(pid):
            with contextlib.suppress(psutil.NoSuchProcess):
                if item.status() in (psutil.STATUS_RUNNING, psutil.STATUS_DISK_SLEEP):
                    return True
        time.sleep(LOOK_S)
    return False


def _works(process: psutil.Process) -> bool:
    """Whether a process is a worker, not a helper that tracks resources."""
    try:
        return "tracker" not in " ".join(process.cmdline())
    except psutil.NoSuchProcess:
        return False


def _kill(pid: int, how: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, how)


def soak(kills: int, names: list[str], work: Path, seed: int = 0, minutes: float = float("inf")) -> dict[str, Tally]:
    """Kill until this many kills were made or the time is over, the commands in turn; a tally by command."""
    chance, end = random.Random(seed), time.monotonic() + 60.0 * minutes
    with cluster_for(names, chance) as nodes:
        wanted = commands(work, names) + ([on_ray(work, nodes, chance)] if nodes else [])
        running = [Soak(command, work, chance) for command in wanted]
        tallies = {item.command.name: item.tally for item in running}
        while (done := sum(sum(tally.kills.values()) for tally in tallies.values())) < kills and time.monotonic() < end:
            item = running[sum(tally.finished for tally in tallies.values()) % len(running)]
            item.chain(min(chance.randint(1, LONGEST_CHAIN), kills - done))
            print(f"{done} of {kills} kills", file=sys.stderr, flush=True)
    return tallies


def main(
    kills: int = 200,
    names: Annotated[str, typer.Option("--commands", help="or ray")] = "render,trace,job,merge,fit,evaluate",
    minutes: Annotated[float, typer.Option(help="stop after this time, the kills done or not")] = float("inf"),
    seed: int = 0,
    work: Path = ROOT / "build" / "soak",
) -> None:
    """Prints the table; exit status 1 where anything went wrong."""
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    started = time.monotonic()
    tallies = soak(kills, names.split(","), work, seed, minutes)
    print(table(tallies))
    print(f"\n{(time.monotonic() - started) / 60.0:.0f} minutes, seed {seed}")
    sys.exit(not all(tally.clean for tally in tallies.values()))


if __name__ == "__main__":
    typer.run(main)
