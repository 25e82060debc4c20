"""The commands that are killed and resumed: their arguments, what of their results has to be the same; a tally."""

from __future__ import annotations

import hashlib
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from manual import ROOT
from small_radar import write_small_radar

if TYPE_CHECKING:
    from ray_cluster import Nodes

BIN = Path(sys.executable).parent
HANG_S = 300.0
"""No command here takes a tenth of this on a machine of its own. Where others take the processor it may: a command
hangs that has not ended by then and whose processes all sleep."""
FRAMES = "44"
ON_RAY = 0.8
"""Share of the starts of ``ray`` that are on the cluster; the others go on on this machine."""


@dataclass(frozen=True)
class Command:
    """A command that can be killed and resumed.

    :param arguments: for a folder
    :param result: what of a finished folder has to be the same, by name; an OSError where that cannot be said
    :param reference: arguments of what it is compared with; by default its own
    :param nodes: of a cluster that works for it
    :param fault: what is wrong with a folder after a kill, "" for nothing
    """

    name: str
    arguments: Callable[[Path], list[str]]
    result: Callable[[Path], dict[str, str]]
    reference: Callable[[Path], list[str]] | None = None
    nodes: Nodes | None = None
    fault: Callable[[Path], str] = lambda folder: ""

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


JOBS = 3
KILLED = f"1/{JOBS}"

Run = Callable[[list[str]], object]
Hashes = Callable[[Path], dict[str, str]]


class ArrayRun:
    """Kills between and within the jobs of an array: the run in one piece, and the jobs that are not killed.

    ``job`` is one job of three; the other two are finished before. What is compared of it is the merge of all three.
    After each kill a merge is tried: as long as the job is not finished it has to be refused with the frames that are
    missing, and to leave nothing behind. ``merge`` is the merge itself, killed and resumed.

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


def commands(work: Path, names: list[str]) -> list[Command]:
    """The commands of these names, on a tiny scene and a small radar; what they need is made first."""
    radar = write_small_radar(work)
    factory, trainer = str(BIN / "datafactory"), str(BIN / "trainer")
    scene = ["--scene", str(ROOT / "scenes" / "tiny.usda"), "--radar", str(radar), "--rays", "2000"]
    scene += ["--effects", "specular,diffuse,doppler,noise"]
    # What is never killed is made without workers, whose starts take longer than their frames.
    alone, killed = [*scene, "--workers", "1"], [*scene, "--workers", "2"]
    data = work / "data"
    if {"fit", "evaluate"} & set(names):
        run([factory, "render", *alone, "--frames", "24", "--out", str(data)])
    fit = ["--steps", "40", "--validate-every", "10", "--width", "4", "--seed", "1"]
    evaluate = ["--methods", "das,iaa,omp", "--experiments", "resolution,noise-only", "--arrays", "sparse6"]
    evaluate += ["--workers", "2"]

    def render(of: list[str]) -> Callable[[Path], list[str]]:
        return lambda out: [factory, "render", *of, "--frames", FRAMES, "--points", "4", "--out", str(out)]

    def trace(of: list[str]) -> Callable[[Path], list[str]]:
        return lambda out: [factory, "trace", *of, "--frames", "40", "--out", str(out)]

    every = [
        Command("render", render(killed), shards, render(alone)),
        Command("trace", trace(killed), shards, trace(alone)),
        Command("fit", lambda out: [trainer, "fit", str(data), *fit, "--out", str(out)], weights),
        Command("evaluate", lambda out: [trainer, "evaluate", str(data), *evaluate, "--out", str(out)], cells),
    ]
    if {"job", "merge"} & set(names):
        array = ArrayRun(factory, alone, killed, work, run, shards)
        every.append(Command("job", array.job, array.merged, array.reference, fault=array.fault))
        every.append(Command("merge", array.merge, array.whole))
    return [command for command in every if command.name in names]


def on_ray(work: Path, nodes: Nodes, chance: random.Random) -> Command:
    """Close targets, whose shards a cluster makes; what is left after the last kill, it or this machine."""
    radar = write_small_radar(work)
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
    from ray_cluster import Nodes, ray_cluster

    with ray_cluster(2) as cluster:
        yield Nodes(cluster, chance)


def run(arguments: list[str]) -> float:
    """Seconds of a command that has to succeed."""
    started = time.monotonic()
    done = subprocess.run(arguments, capture_output=True, text=True, check=False, timeout=HANG_S)
    if done.returncode:
        raise RuntimeError(f"{' '.join(arguments)}: {done.stderr[-800:]}")
    return time.monotonic() - started


KINDS = ("group", "parent", "worker", "node")
"""Of kills: a process group, the process alone, one of its workers, a node of its cluster."""


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


def table(tallies: dict[str, Tally]) -> str:
    """The tallies in Markdown."""
    heads = ["command", *(f"{kind} kills" for kind in KINDS), "runs compared", "differing", "hangs", "orphans",
             "leftovers", "tracebacks", "longest wait [s]"]  # fmt: skip
    rows = {
        name: [*tally.kills.values(), tally.finished, tally.differing, tally.hangs, tally.orphans, tally.leftovers,
               tally.tracebacks]
        for name, tally in tallies.items()
    }  # fmt: skip
    rows["all"] = [sum(column) for column in zip(*rows.values(), strict=True)]
    waited = {name: tally.waited_s for name, tally in tallies.items()}
    waited["all"] = max(waited.values())
    lines = [[name, *map(str, numbers), f"{waited[name]:.1f}"] for name, numbers in rows.items()]
    return "\n".join(f"| {' | '.join(line)} |" for line in (heads, ["---"] * len(heads), *lines))
