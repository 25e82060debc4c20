"""What a stored trace saves: processor seconds of a frame traced and rendered, and rendered from its stored paths.

``python tests/benchmarks/trace_once.py --scene scenes/street.usda --frames 4 --rays 50000`` prints a Markdown table, a
row for each radar. Both ways take turns in one process, after a first round that is not counted; what is compiled and
planned once is in neither. The bytes of a stored frame and of a path stand below.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from datafactory import trace
from datafactory.api.asking import materials_of, order_of
from datafactory.api.options import OrderOptions
from datafactory.frame.chain import SceneSource, Source, StoredSource, make_frames
from datafactory.paths.backend import select_variant, set_threads
from datafactory.paths.storage import read_paths
from datafactory.run.preparation import prepare
from shared.radar import Radar, load_radar

RADARS = {
    "avr-qdm-110, as it was traced": load_radar("avr-qdm-110"),
    "half the bandwidth and samples": load_radar("avr-qdm-110").model_copy(
        update={
            "waveform": load_radar("avr-qdm-110").waveform.model_copy(
                update={"bandwidth_hz": 0.5e9, "samples": 512, "range_bins": 315}
            )
        }
    ),
    "iwr1443, another array": load_radar("iwr1443"),
}


def seconds(sources: Sequence[Source], radar: Radar) -> float:
    """Processor seconds of a frame, images and all."""
    started = time.process_time()
    for _ in make_frames(sources, radar):
        pass
    return (time.process_time() - started) / len(sources)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="scenes/street.usda")
    parser.add_argument("--frames", type=int, default=4)
    parser.add_argument("--rays", type=int, default=50_000)
    parser.add_argument("--rounds", type=int, default=3)
    asked = parser.parse_args()
    select_variant()
    set_threads(1)
    with tempfile.TemporaryDirectory() as name, threadpool_limits(limits=1):
        folder = Path(name)
        trace(asked.scene, folder / "traced", frames=asked.frames, rays=asked.rays, effects="all")
        order = order_of(
            OrderOptions(asked.scene, radar="avr-qdm-110", frames=asked.frames, rays=asked.rays, effects="all")
        )
        prepared = prepare(order, materials_of(None))
        frames = [prepared.deal.frame(number) for number in range(asked.frames)]
        now = [SceneSource(frame, prepared.scenes[0], order.of_scenes) for frame in frames]
        shards = sorted((folder / "traced" / "paths").iterdir())
        rows = [(shard, row) for shard in shards for row in range(len(list(read_paths(shard))))]
        later = [StoredSource(*place, source.settings) for place, source in zip(rows, now, strict=True)]
        print(f"{asked.scene}, {asked.rays} rays, {asked.frames} frames, {asked.rounds} rounds\n")
        print("| radar | traced and rendered [s] | from stored paths [s] | times as fast |\n|---|---|---|---|")
        for name, radar in RADARS.items():
            taken = [(seconds(now, radar), seconds(later, radar)) for _ in range(1 + asked.rounds)][1:]
            both, stored = (statistics.median(column) for column in zip(*taken, strict=True))
            print(f"| {name} | {both:.2f} | {stored:.2f} | {both / stored:.1f} |", flush=True)
        size = sum(shard.stat().st_size for shard in shards)
        paths = [len(frame.table) for shard in shards for frame in read_paths(shard)]
        per_frame = f"{size / len(paths) / 1e6:.2f} MB a frame, {np.mean(paths):.0f} paths"
        print(f"\n{per_frame}, {size / sum(paths):.0f} bytes each")


if __name__ == "__main__":
    main()
