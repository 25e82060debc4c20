"""How fast the trainer reads a dataset: frames a second on one core, read and decoded into tensors.

    python tests/benchmarks/reader.py DATASET [--split train] [--repeats N]

Cold: every frame from its shard (the operating system may hold the file in memory), in shuffled order. Warm: from the
reader's own memory, as far as it reaches. Processor time, least of the repeats; beside it what the same core copies in
a second, since a loaded machine slows both alike.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import numpy as np
import pyarrow as pa
import torch
import typer
from rich.console import Console
from rich.table import Table

from trainer.data.shards import ShardDataset

COPY_BYTES = 64 << 20


def least_seconds(call: Callable[[], object], repeats: int) -> float:
    """Processor time of the quickest of several calls."""
    seconds = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        seconds.append(time.process_time() - start)
    return min(seconds)


def measure(directory: Path, split: str, columns: tuple[str, ...], repeats: int) -> dict[str, float]:
    """Frames a second, cold and warm, and bytes of one frame's tensors."""
    order = np.random.default_rng(0).permutation(len(ShardDataset(directory, split, columns))).tolist()

    def read(data: ShardDataset) -> None:
        for index in order:
            data[index]

    cold = least_seconds(lambda: read(ShardDataset(directory, split, columns, cache_bytes=0)), repeats)
    kept = ShardDataset(directory, split, columns)
    read(kept)
    size = sum(tensor.nbytes for tensor in kept[0].values())
    return {"cold": len(order) / cold, "warm": len(order) / least_seconds(lambda: read(kept), repeats), "bytes": size}


def main(
    directory: Annotated[Path, typer.Argument(help="A dataset.")],
    split: Annotated[str, typer.Option()] = "train",
    repeats: Annotated[int, typer.Option(min=1)] = 5,
) -> None:
    """Measure and print."""
    pa.set_cpu_count(1)
    torch.set_num_threads(1)
    table = Table("columns", "MB a frame", "cold [frames/s]", "warm [frames/s]")
    for columns in (("range_channel", "image"), ("range_channel",), ("image",), ("range_channel", "velocity", "image")):
        found = measure(directory, split, columns, repeats)
        cells = (f"{found['bytes'] / 1e6:.2f}", f"{found['cold']:.0f}", f"{found['warm']:.0f}")
        table.add_row(", ".join(columns), *cells)
    source = np.ones(COPY_BYTES, np.uint8)
    target = np.empty_like(source)
    copied = COPY_BYTES / least_seconds(lambda: np.copyto(target, source), repeats)
    console = Console()
    console.print(table)
    console.print(f"one core copies {copied / 1e9:.1f} GB/s")


if __name__ == "__main__":
    typer.run(main)
