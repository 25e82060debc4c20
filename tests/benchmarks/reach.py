"""How much a plan can miss: effects on paths that a frame calls for and a look at a frame nearby did without.

    python tests/benchmarks/reach.py [--scene S ...] [--looks N] [--frames N]

Every look is at a pose drawn on free ground. The frames that it speaks for stand within its reach ahead of it, as a
drive goes, a little aside, and turned by no more than it reaches.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
import typer
from plans import SCENES
from threadpoolctl import threadpool_limits

from datafactory.effects.catalogue import ALL, PATH_EFFECTS
from datafactory.effects.evidence import gather
from datafactory.effects.plan import REACH_DEG, REACH_M, decide
from datafactory.frame.deal import DealtFrame
from datafactory.frame.prepared import Sample
from datafactory.paths.backend import select_variant, set_threads
from datafactory.run.order import Order
from datafactory.run.preparation import prepare
from datafactory.scenes.materials.table import load_materials
from shared.radar import load_radar

ASIDE = 0.2
"""Of the reach."""


def nearby(
    frame: DealtFrame, number: int, reach_m: float, reach_deg: float, generator: np.random.Generator
) -> DealtFrame:
    """A frame that this one speaks for."""
    pose = frame.where
    ahead, aside = generator.uniform(0.0, 1.0 - ASIDE), generator.uniform(-ASIDE, ASIDE)
    step = reach_m * (pose.rotation() @ [ahead, aside, 0.0])
    x, y, z = (float(value) for value in np.add(pose.position, step))
    turned = pose.yaw_deg + float(generator.uniform(-reach_deg, reach_deg))
    return replace(frame, seed=frame.seed ^ (number + 1), pose=replace(pose, position=(x, y, z), yaw_deg=turned))


def main(
    scene: Annotated[list[str] | None, typer.Option(help="Instead of the shipped ones; may be repeated.")] = None,
    looks: Annotated[int, typer.Option(help="Poses that are looked at, a scene.")] = 6,
    frames: Annotated[int, typer.Option(help="Frames that each look speaks for.")] = 3,
    reach_m: Annotated[float, typer.Option(help="How far they stand from it.")] = REACH_M,
    reach_deg: Annotated[float, typer.Option(help="How far they are turned.")] = REACH_DEG,
) -> None:
    """Print a Markdown table."""
    select_variant()
    set_threads(1)
    print("| scene | left out by looks | of these called for nearby | worst change [dB] | effect |")
    print("|---|---|---|---|---|")
    generator = np.random.default_rng(0)
    with threadpool_limits(limits=1):
        for name in scene or SCENES:
            order = Order(radar=load_radar("avr-qdm-110"), scenes=(name,), frames=looks, effects=ALL)
            prepared = prepare(order, load_materials())
            left_out, missed = 0, list[tuple[float, str]]()
            for index in range(looks):
                base = prepared.deal.frame(index)
                group = (base, *(nearby(base, number, reach_m, reach_deg, generator) for number in range(frames)))
                found = gather(Sample(prepared.scenes[0], group), order.radar, order.settings)
                needs = [decide(name, evidence, order.budget_db).effects for evidence in found.frames]
                for effect in PATH_EFFECTS:
                    if effect in found.absent or getattr(needs[0], effect):
                        continue
                    left_out += frames
                    missed += [
                        (evidence[effect].change_db, effect) for evidence, need in zip(found.frames[1:], needs[1:],
                                                                                      strict=True)
                        if getattr(need, effect)
                    ]  # fmt: skip
            worst = max(missed, default=(float("nan"), "none"))
            print(f"| {name} | {left_out} | {len(missed)} | {worst[0]:.1f} | {worst[1]} |", flush=True)


if __name__ == "__main__":
    typer.run(main)
