"""What right-angled corners add to a street: ``.venv/bin/python tests/benchmarks/corners.py [--out docs/corners.png]``.

Two frames of each scene from the same rays, with the effect and without it: Sionna's street canyon, which has no inner
corner but the feet of its walls, and the shipped street, which has kerbs, steps and window reveals. Printed are the
number of echoes and the strongest ones; drawn are the truth images around those and the strongest cell of each range.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from datafactory.effects.catalogue import ALL
from datafactory.frame.chain import ChainSettings, SceneSource, illuminated, make_frames
from datafactory.frame.deal import Deal, PreparedScene
from datafactory.paths.density import cell_power
from datafactory.paths.merged_scene import merge_scene
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import CORNER, PathTable
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose
from datafactory.scenes.readers.open import open_scene
from shared.physics.units import amplitude_to_db, power_to_db
from shared.radar import Radar

REPOSITORY = Path(__file__).resolve().parents[2]
SCENES = (
    ("sionna:simple_street_canyon_with_cars", "Sionna's canyon", Pose((-45.0, 0.0, 0.6), yaw_deg=60.0), (8.0, 12.0)),
    (str(REPOSITORY / "scenes" / "street.usda"), "shipped street", Pose((0.0, 0.0, 0.5), yaw_deg=20.0), (20.0, 36.0)),
)
"""Scene, what it is called, pose, and the ranges that are drawn [m]."""
WINDOW = "taylor-30"
SPAN_DB = 60.0


def prepared(name: str) -> PreparedScene:
    scene = open_scene(name)
    materials = load_materials().map_materials([item.material for item in scene.objects])
    return PreparedScene(scene.name, scene.content_hash(), merge_scene(scene, materials), materials)


def strongest(paths: PathTable, count: int = 5) -> list[tuple[float, float]]:
    """Range [m] and power [dBW] of the strongest echoes of corners."""
    kinds = np.concatenate([paths.scattered.kinds, paths.specular.kinds])
    range_m = np.concatenate([paths.scattered.range_m(), paths.specular.range_m()])
    power = np.abs(np.concatenate([paths.scattered.amplitude, paths.specular.amplitude])) ** 2 * (kinds & CORNER > 0)
    best = np.argsort(-power)[:count]
    return [(round(float(range_m[i]), 2), round(float(power_to_db(power[i], -300.0)), 1)) for i in best]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=REPOSITORY / "docs" / "corners.png")
    parser.add_argument("--rays", type=int, default=100_000)
    given = parser.parse_args()
    radar = Radar()
    figure, axes = plt.subplots(len(SCENES), 3, figsize=(15.0, 9.0), layout="constrained")
    for (name, called, pose, (near, far)), row in zip(SCENES, axes, strict=True):
        scene, frame = prepared(name), Deal(scenes=1, poses=(pose,)).frame(0)
        silent = ALL.without("noise")
        images, levels = [], []
        for effects in (silent.without("corners"), silent):
            settings = effects.settings(ChainSettings(trace=TraceSettings(rays=given.rays)))
            source = SceneSource(frame, scene, settings)
            paths = illuminated(source.traced(radar), settings, radar)
            levels.append(cell_power(paths, radar, WINDOW).max(axis=1))
            ((made, _),) = make_frames([replace(source)], radar)
            images.append(made.image * made.image_peak)
        kinds = np.concatenate([paths.scattered.kinds, paths.specular.kinds])
        print(name, int((kinds & CORNER > 0).sum()), "echoes of corners of", len(paths), "; strongest [m, dBW]:",
              strongest(paths))  # fmt: skip
        ranges, u = radar.waveform.ranges_m, radar.grid.u
        rows = (ranges >= near) & (ranges <= far)
        top = max(float(amplitude_to_db(image[rows].max(), -300.0)) for image in images)
        for axis, image, title in zip(row, images, ("without corners", "with corners"), strict=False):
            shown = axis.pcolormesh(
                u, ranges[rows], amplitude_to_db(image[rows], -300.0), vmin=top - SPAN_DB, vmax=top, cmap="viridis"
            )
            axis.set(title=f"{called}, {title}: truth", xlabel="u", ylabel="range [m]")
            axis.invert_xaxis()
        figure.colorbar(shown, ax=row[1], label="dBW")
        for level, label in zip(levels, ("without", "with"), strict=True):
            row[2].plot(ranges, power_to_db(level, -300.0), label=label, linewidth=1.0)
        row[2].set(title=f"{called}: strongest cells", xlabel="range [m]", ylabel="dBW", xlim=(near - 5.0, far + 15.0))
        shown_levels = power_to_db(np.concatenate([level[rows] for level in levels]), -300.0)
        row[2].set_ylim(float(np.median(shown_levels)) - 25.0, float(shown_levels.max()) + 5.0)
        row[2].legend()
    figure.savefig(given.out, dpi=110)


if __name__ == "__main__":
    main()
