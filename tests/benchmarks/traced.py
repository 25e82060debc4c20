"""Processor time of tracing drawn frames, by what is looked for, on one core.

python tests/benchmarks/traced.py --scene scenes/street.usda
python tests/benchmarks/traced.py --scene sionna:munich --populate cars=20,parked=0.6

The first frame finds the scene's shapes and compiles; it is shown and not in the mean.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np

from datafactory.api.asking import load_scene, order_of
from datafactory.api.options import OrderOptions
from datafactory.frame.chain import SceneSource
from datafactory.paths import trace
from datafactory.paths.backend import select_variant, set_threads
from datafactory.run.preparation import prepare
from datafactory.scenes.materials.table import load_materials

PARTS: tuple[tuple[Any, str, str], ...] = (
    (trace, "_listed", "candidates"),
    (trace.CornerEchoes, "seen", "edges of right angles"),
    (trace.CornerPointEchoes, "seen", "points of right angles"),
    (trace.TargetEchoes, "seen", "targets"),
    (trace.EdgeEchoes, "seen", "edges"),
    (trace, "single_mirrors", "mirrors"),
    (trace, "curved_mirrors", "curved mirrors"),
    (trace.Arrivals, "first", "first hits"),
    (trace, "SecondBounces", "second bounces, estimated"),
    (trace, "behind_panes", "scattered behind panes"),
    (trace, "solve", "solver"),
    (trace, "placed", "geometry"),
    (trace, "with_surfaces", "shares of mirrors, phases"),
)


def timed(spent: dict[str, float], name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(function)
    def with_clock(*arguments: Any, **options: Any) -> Any:
        start = time.process_time()
        try:
            return function(*arguments, **options)
        finally:
            spent[name] += time.process_time() - start

    return with_clock


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", required=True)
    parser.add_argument("--populate", default=None)
    parser.add_argument("--frames", type=int, default=6, help="beside the first")
    parser.add_argument("--rays", type=int, default=20_000)
    asked = parser.parse_args()
    select_variant()
    set_threads(1)
    scene = load_scene(asked.scene, populate=asked.populate)
    count = 2 * asked.frames + 2  # of every second frame, as in assets.py --city
    order = order_of(OrderOptions(scene, radar="avr-qdm-110", frames=count, rays=asked.rays, effects="all"))
    prepared = prepare(order, load_materials(), print)
    spent: dict[str, float] = defaultdict(float)
    for module, name, label in PARTS:
        setattr(module, name, timed(spent, label, getattr(module, name)))
    frames = []
    for frame_id in range(0, count, 2):
        dealt = prepared.deal.frame(frame_id)
        source = SceneSource(dealt, prepared.scenes[0], order.of_scenes)
        spent.clear()
        start = time.process_time()
        source.traced(order.radar)
        frames.append({"trace": time.process_time() - start, **spent})
        print(f"frame {frame_id}: {frames[-1]['trace']:.2f} s", flush=True)
    print(f"{'mean of all but the first':28s} [s]")
    for label in dict.fromkeys(label for frame in frames[1:] for label in frame):
        print(f"{label:28s} {np.mean([frame.get(label, 0.0) for frame in frames[1:]]):.3f}")


if __name__ == "__main__":
    main()
