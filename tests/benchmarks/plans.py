"""What planning costs and saves on a whole run: processor time of frames as planned and with every effect, in turn.

    python tests/benchmarks/plans.py [--scene S ...] [--rays N] [--repeats N]

For each scene: what a look at a frame for the plan takes, and a frame of each kind, the radar standing or driving, as
planned and with every effect; of repeats the least. From these follow whole runs, planning included: of drawn poses,
none near another; of a drive of 8 m/s; and of one whose radar stands in every second frame.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Annotated

import typer
from threadpoolctl import threadpool_limits

from datafactory.effects.catalogue import ALL
from datafactory.effects.evidence import gather
from datafactory.effects.plan import plan_by_frame
from datafactory.effects.timing import frame_seconds
from datafactory.frame.chain import ChainSettings
from datafactory.frame.prepared import Sample
from datafactory.paths.backend import select_variant, set_threads
from datafactory.paths.solver import TraceSettings
from datafactory.run.order import Order
from datafactory.run.preparation import prepare
from datafactory.scenes.materials.table import load_materials
from shared.radar import load_radar

SCENES = (
    "scenes/tiny.usda",
    "scenes/street.usda",
    "sionna:simple_street_canyon_with_cars",
    "sionna:munich",
    "sionna:san_francisco",
)
SPEED_MPS = 8.0
RUNS = (20, 150)


@dataclass(frozen=True)
class Prices:
    """Processor seconds: of a look for the plan, and of frames by how they are made, standing and driving.

    :param far: with all paths that the scene has something for, as frames out of a look's reach are made
    """

    look: float
    planned: tuple[float, float]
    far: tuple[float, float]
    every: tuple[float, float]

    def run(self, frames: int, standing: float, looks: int, near: bool) -> float:
        """Time with every effect over the time as planned, of a whole run.

        :param standing: share of the frames in which the radar stands
        :param near: whether the looks reach its frames
        """
        still, moving = self.planned if near else self.far
        planned = looks * self.look + frames * (standing * still + (1.0 - standing) * moving)
        return frames * (standing * self.every[0] + (1.0 - standing) * self.every[1]) / planned


def measured(scene: str, rays: int, repeats: int) -> tuple[Prices, str]:
    """The prices on one scene, and the effects on paths that its frame does without."""
    settings = ChainSettings(trace=TraceSettings(rays=rays))
    order = Order(radar=load_radar("avr-qdm-110"), scenes=(scene,), frames=1, settings=settings, effects=ALL)
    prepared = prepare(order, load_materials())
    (there,), drawn = prepared.scenes, prepared.deal.frame(0)
    ahead = drawn.where.rotation() @ [SPEED_MPS, 0.0, 0.0]
    velocities = ((0.0, 0.0, 0.0), (float(ahead[0]), float(ahead[1]), float(ahead[2])))
    frames = [replace(drawn, pose=replace(drawn.where, velocity=velocity)) for velocity in velocities]
    looks = []
    for _ in range(repeats + 1):
        started = time.process_time()
        found = gather(Sample(there, (frames[1],)), order.radar, settings)
        looks.append(time.process_time() - started)
    plan = plan_by_frame(there.name, found, (frames[1],), order.budget_db, there.merged.fastest_mps)
    assert plan.by_frame is not None
    elsewhere = replace(plan, by_frame=replace(plan.by_frame, looks=()))
    kinds = [plan.settings(settings, drawn.pose), elsewhere.settings(settings, drawn.pose), ALL.settings(settings)]
    times: dict[tuple[int, int], list[float]] = {}
    for repeat in range(repeats + 1):
        for number, kind in enumerate(kinds):
            for index, frame in enumerate(frames):
                seconds = frame_seconds(frame, there, order.radar, kind)
                if repeat:  # the first compiles
                    times.setdefault((number, index), []).append(seconds)
    planned, far, every = ((min(times[number, 0]), min(times[number, 1])) for number in range(len(kinds)))
    left_out = sorted(set(plan.by_frame.elsewhere) - set(plan.by_frame.looks[0].paths))
    return Prices(min(looks[1:]), planned, far, every), ", ".join(left_out) or "nothing"


def main(
    scene: Annotated[list[str] | None, typer.Option(help="Instead of the shipped ones; may be repeated.")] = None,
    rays: Annotated[int, typer.Option(help="A frame.")] = 200_000,
    repeats: Annotated[int, typer.Option(help="Of each frame; the least counts.")] = 2,
) -> None:
    """Print a Markdown table."""
    select_variant()
    set_threads(1)
    heads = ["scene", "look [frames]", "standing: all / planned [s]", "driving", "left out near a look"]
    heads += [f"{kind}, {frames}" for kind in ("drawn", "drive", "half standing") for frames in RUNS]
    print("|", " | ".join(heads), "|")
    print("|---" * len(heads) + "|")
    with threadpool_limits(limits=1):
        for name in scene or SCENES:
            prices, left_out = measured(name, rays, repeats)
            ratios = [prices.run(frames, 0.0, 1, near=False) for frames in RUNS]
            ratios += [prices.run(frames, 0.0, 3, near=True) for frames in RUNS]
            ratios += [prices.run(frames, 0.5, 3, near=True) for frames in RUNS]
            pairs = [f"{prices.every[i]:.2f} / {prices.planned[i]:.2f}" for i in (0, 1)]
            cells = [name, f"{prices.look / prices.every[1]:.2f}", *pairs, left_out, *(f"{x:.2f}" for x in ratios)]
            print("|", " | ".join(cells), "|", flush=True)


if __name__ == "__main__":
    typer.run(main)
