"""How converged a frame's speckle is, and what its trace costs: the table of docs/notes/speckle.md.

    python tests/benchmarks/speckle.py --scene scenes/street.usda --frame 1 --rays 600000

Seed 0, every effect. Prints paths before and after pruning, the share of lit cells within 30 m that fewer than five
paths light, the error of the power in a resolution cell (two realisations against the mean of two others with
``--reference`` rays; amplitude over its peak), and the processor time of one trace.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

from datafactory.accuracy.knobs import DEFAULT, Effort, Sample
from datafactory.accuracy.power import level_db, power_error
from datafactory.effects.catalogue import ALL
from datafactory.paths.density import lit_cells
from datafactory.paths.table import PathTable
from datafactory.paths.thinning import pruned
from datafactory.run.order import Order
from datafactory.run.preparation import prepare
from datafactory.scenes.materials.table import load_materials
from shared.physics.units import power_to_db
from shared.radar import Radar, load_radar

NEAR_M = 30.0


def share_of_few(paths: PathTable, radar: Radar) -> str:
    """Lit cells within ``NEAR_M`` and the share of them with fewer than five paths."""
    near = replace(paths, scattered=paths.scattered.take(paths.scattered.range_m() < NEAR_M))
    lit, few = lit_cells(near, radar).values()
    return f"{lit} cells, {few / max(lit, 1):.2f} of them with few"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", required=True)
    parser.add_argument("--frame", type=int, default=1)
    parser.add_argument("--rays", type=int, default=600_000)
    parser.add_argument("--reference", type=int, default=800_000)
    arguments = parser.parse_args()
    radar = load_radar("avr-qdm-110")
    order = Order(radar=radar, scenes=(arguments.scene,), frames=3, effects=ALL)
    prepared = prepare(order, load_materials())
    sample = Sample(prepared.deal.frame(arguments.frame), prepared.scenes[0], order)
    settings = replace(DEFAULT, rays=arguments.rays)
    sample.lit_paths(settings)  # compiles
    start = time.process_time()
    paths = sample.lit_paths(settings)
    print(f"{time.process_time() - start:.2f} s of processor time")
    kept = pruned(paths, radar, settings.prune_db)
    for name, table in (("traced", paths), ("pruned", kept)):
        print(f"{name}: {len(table)} paths, {len(table) / arguments.rays:.2f} a ray; {share_of_few(table, radar)}")
    effort = Effort(arguments.reference, realisations=2, reference_realisations=2)
    against = replace(settings, rays=arguments.reference)
    error = power_error(sample, settings, sample, against, effort, {})
    print(f"power in a cell {level_db(error.peak):.1f} dB of the peak, total {float(power_to_db(error.total)):+.3f} dB")


if __name__ == "__main__":
    main()
