"""The commands that are killed and resumed: their arguments, what of their results has to be the same; a tally."""

from __future__ import annotations

import hashlib
import random
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from array_jobs import ArrayRun
from small_radar import write_small_radar

if TYPE_CHECKING:
    from ray_cluster import Nodes

ROOT = Path(__file__).resolve().parents[1]
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
