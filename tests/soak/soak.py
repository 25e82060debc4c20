"""Kill runs at random points, resume them, and compare what they end in: ``make soak``.

Each round starts a command, kills its whole process group, the process alone or one of its workers after a random time,
and goes on with ``--resume``. After a few kills the run is left to finish, and its files are compared with those of a
run that was never killed. What is counted stands in :class:`Tally`. The command ``ray`` makes its shards on a Ray
cluster of this machine, whose nodes are killed as well.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import psutil

if TYPE_CHECKING:
    from ray_nodes import Nodes

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent
KINDS = ("group", "parent", "worker", "node")
HANG_S = 300.0
"""No command here takes a tenth of this on a machine of its own. Where others take the processor it may: a command
hangs that has not ended by then and whose processes all sleep."""
LOOKS, LOOK_S = 20, 0.25
"""How often, and how far apart, the processes of a command that takes long are looked at."""
ORPHAN_S = 10.0
"""Within this a worker notices that its parent is gone; it looks every half second."""
ON_RAY = 0.8
"""Share of the starts of ``ray`` that are on the cluster; the others go on on this machine."""
LONGEST_CHAIN = 8
"""Kills of one run before it is left to finish: what finishes takes as long as two that are killed."""

RADAR = """
[waveform]
chirps = 8
samples = 128
range_bins = 100
bandwidth_hz = 400e6
[grid]
bins = 32
"""


@dataclass
class Tally:
    """What happened to the runs of one command.

    :param kills: by kind
    :param finished: runs that were compared
    :param differing: of them, those whose files were not the reference's: a frame lost, doubled or changed
    :param hangs: commands that did not end in time
    :param orphans: processes that outlived the one that started them
    :param leftovers: files of a finished run that the reference does not have
    :param tracebacks: runs that showed one
    :param waited_s: longest time from a kill to the end of all processes
    """

    kills: dict[str, int] = field(default_factory=lambda: dict.fromkeys(KINDS, 0))
    finished: int = 0
    differing: int = 0
    hangs: int = 0
    orphans: int = 0
    leftovers: int = 0
    tracebacks: int = 0
    waited_s: float = 0.0

    @property
    def clean(self) -> bool:
        """Whether nothing went wrong."""
        return not (self.differing or self.hangs or self.orphans or self.leftovers or self.tracebacks)


@dataclass(frozen=True)
class Command:
    """A command that can be killed and resumed.

    :param arguments: for a folder
    :param result: what of a finished folder has to be the same, by name
    :param reference: arguments of what it is compared with; by default its own
    :param nodes: of a cluster that works for it
    """

    name: str
    arguments: Callable[[Path], list[str]]
    result: Callable[[Path], dict[str, str]]
    reference: Callable[[Path], list[str]] | None = None
    nodes: Nodes | None = None

    @property
    def kinds(self) -> tuple[str, ...]:
        """Of kills that there are of it."""
        return tuple(kind for kind in KINDS if kind != "node" or self.nodes)


def shards(folder: Path) -> dict[str, str]:
    """Hashes of a dataset's shards."""
    return _hashes(folder, folder.glob("*/*.parquet"))


def weights(folder: Path) -> dict[str, str]:
    """Hashes of a run's weights."""
    return _hashes(folder, folder.glob("weights.safetensors"))


def cells(folder: Path) -> dict[str, str]:
    """The numbers of an evaluation; seconds differ from run to run."""
    import pyarrow.parquet as pq

    table = pq.read_table(folder / "metrics.parquet")
    rows = [row for row in table.to_pylist() if "second" not in str(row)]
    return {"metrics": hashlib.sha256(repr(sorted(map(str, rows))).encode()).hexdigest()}


def _hashes(folder: Path, paths: Iterable[Path]) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(paths)
    }


def commands(work: Path, names: list[str]) -> list[Command]:
    """The commands of these names, on a tiny scene and a small radar; what they need is made first."""
    radar = work / "radar.toml"
    radar.write_text(RADAR, encoding="utf-8")
    factory, trainer = str(BIN / "datafactory"), str(BIN / "trainer")
    scene = ["--scene", str(ROOT / "scenes" / "tiny.usda"), "--radar", str(radar), "--rays", "2000"]
    scene += ["--effects", "specular,diffuse,doppler,noise", "--workers", "2"]
    data = work / "data"
    if {"fit", "evaluate"} & set(names):
        _run([factory, "render", *scene, "--frames", "24", "--out", str(data)])
    fit = ["--steps", "40", "--validate-every", "10", "--width", "4", "--seed", "1"]
    evaluate = ["--methods", "das,iaa,omp", "--experiments", "resolution,noise-only", "--arrays", "sparse6"]
    evaluate += ["--workers", "2"]
    every = [
        Command(
            "render",
            lambda out: [factory, "render", *scene, "--frames", "44", "--points", "4", "--out", str(out)],
            shards,
        ),
        Command("trace", lambda out: [factory, "trace", *scene, "--frames", "40", "--out", str(out)], shards),
        Command("fit", lambda out: [trainer, "fit", str(data), *fit, "--out", str(out)], weights),
        Command("evaluate", lambda out: [trainer, "evaluate", str(data), *evaluate, "--out", str(out)], cells),
    ]
    return [command for command in every if command.name in names]


def on_ray(work: Path, nodes: Nodes, chance: random.Random) -> Command:
    """Close targets, whose shards a cluster makes; what is left after the last kill, it or this machine."""
    radar = work / "radar.toml"
    radar.write_text(RADAR, encoding="utf-8")
    points = [str(BIN / "datafactory"), "points", "--frames", "120", "--radar", str(radar)]
    cluster = ["--engine", "ray", "--address", nodes.address]

    def anywhere(out: Path) -> list[str]:
        return [*points, *(cluster if chance.random() < ON_RAY else []), "--out", str(out)]

    return Command("ray", anywhere, shards, lambda out: [*points, "--workers", "2", "--out", str(out)], nodes)


@contextmanager
def cluster_for(names: list[str], chance: random.Random) -> Iterator[Nodes | None]:
    """Two nodes of a core each, if the command that needs them is among these."""
    if "ray" not in names:
        yield None
        return
    sys.path.append(str(ROOT / "tests"))
    from ray_cluster import ray_cluster
    from ray_nodes import Nodes

    with ray_cluster(2) as cluster:
        yield Nodes(cluster, chance)


def _run(arguments: list[str]) -> float:
    """Seconds of a command that has to succeed."""
    started = time.monotonic()
    done = subprocess.run(arguments, capture_output=True, text=True, check=False, timeout=HANG_S)
    if done.returncode:
        raise RuntimeError(f"{' '.join(arguments)}: {done.stderr[-800:]}")
    return time.monotonic() - started


class Soak:
    """Kills of one command.

    :param work: folder to work in
    :param chance: source of all randomness
    """

    def __init__(self, command: Command, work: Path, chance: random.Random) -> None:
        self.command, self.work, self.chance, self.tally = command, work, chance, Tally()
        reference = work / f"{command.name}-reference"
        self.seconds = _run((command.reference or command.arguments)(reference))
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


def table(tallies: dict[str, Tally]) -> str:
    """The tallies in Markdown."""
    heads = ["command", *(f"{kind} kills" for kind in KINDS), "runs compared", "differing", "hangs", "orphans",
             "leftovers", "tracebacks", "longest wait [s]"]  # fmt: skip
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    totals: dict[str, float] = defaultdict(float)
    for name, tally in tallies.items():
        numbers = [*tally.kills.values(), tally.finished, tally.differing, tally.hangs, tally.orphans, tally.leftovers,
                   tally.tracebacks]  # fmt: skip
        for head, number in zip(heads[1:], numbers, strict=False):
            totals[head] += number
        lines.append("| " + " | ".join([name, *map(str, numbers), f"{tally.waited_s:.1f}"]) + " |")
    longest = max(tally.waited_s for tally in tallies.values())
    sums = [f"{totals[head]:.0f}" for head in heads[1:-1]]
    return "\n".join([*lines, "| " + " | ".join(["all", *sums, f"{longest:.1f}"]) + " |"])


def main() -> None:
    """``python tests/soak/soak.py --kills 200``: prints the table; exit status 1 where anything went wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--commands", default="render,trace,fit,evaluate", help="or ray")
    parser.add_argument(
        "--minutes", type=float, default=float("inf"), help="stop after this time, the kills done or not"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "soak")
    arguments = parser.parse_args()
    shutil.rmtree(arguments.work, ignore_errors=True)
    arguments.work.mkdir(parents=True)
    started = time.monotonic()
    names = arguments.commands.split(",")
    tallies = soak(arguments.kills, names, arguments.work, arguments.seed, arguments.minutes)
    print(table(tallies))
    print(f"\n{(time.monotonic() - started) / 60.0:.0f} minutes, seed {arguments.seed}")
    sys.exit(not all(tally.clean for tally in tallies.values()))


if __name__ == "__main__":
    main()
