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
from functools import partial
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


JOBS, KILLED = 3, 1
"""Of an array, and which of them is killed; the others are finished before."""


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
        every += of_an_array(work, factory, render(alone), render(killed))
    return [command for command in every if command.name in names]


def of_an_array(
    work: Path, factory: str, whole: Callable[[Path], list[str]], killed: Callable[[Path], list[str]]
) -> list[Command]:
    """Kills between and within the jobs of an array: the run in one piece, and the jobs that are not killed.

    ``job`` is one job of three. What is compared of it is the merge of all three. After each kill a merge is tried: as
    long as the job is not finished it has to be refused with the frames that are missing, and to leave nothing behind.
    ``merge`` is the merge itself, killed and resumed.

    :param whole: the run in one piece; :param killed: the same, of which a job is killed
    """
    one_piece, others, finished = (work / f"array-{name}" for name in ("whole", "others", "all"))
    run(whole(one_piece))
    expected = shards(one_piece)

    def job(number: int, of: Callable[[Path], list[str]], out: Path) -> list[str]:
        return [*of(out), "--shard", f"{number}/{JOBS}"]

    for number in range(JOBS):
        if number != KILLED:
            run(job(number, whole, others))
    shutil.copytree(others, finished)
    run(job(KILLED, whole, finished))

    def merge(jobs: list[Path], out: Path) -> list[str]:
        return [factory, "merge", *map(str, jobs), "--out", str(out)]

    def merge_with(out: Path, target: Path) -> subprocess.CompletedProcess[str]:
        """A merge of what is left of the killed job with the others."""
        jobs = [folder for folder in (others, out) if folder.is_dir() and any(folder.glob("job-*"))]
        return subprocess.run(merge(jobs, target), capture_output=True, text=True, check=False)

    def in_one_piece(folder: Path) -> dict[str, str]:
        if (found := shards(folder)) != expected:
            raise OSError(f"{folder} is not the run in one piece")
        return found

    def merged(out: Path) -> dict[str, str]:
        target = work / "array-merged"
        shutil.rmtree(target, ignore_errors=True)
        done = merge_with(out, target)
        if done.returncode:
            raise OSError(done.stderr[-800:])
        return in_one_piece(target)

    def fault(out: Path) -> str:
        """How a merge with the unfinished job behaves that should be refused; "" where it is."""
        if any(out.glob("job-*/manifest.json")):
            return ""  # killed after its last file
        target = work / "array-refused"
        done = merge_with(out, target)
        if done.returncode == 2 and " missing" in done.stderr and done.stderr.count("\n") == 1 and not target.exists():
            return ""
        return f"merge of an unfinished job: status {done.returncode}, {done.stderr[-400:]}"

    return [
        Command("job", partial(job, KILLED, killed), merged, partial(job, KILLED, whole), fault=fault),
        Command("merge", partial(merge, [finished]), in_one_piece),
    ]


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
