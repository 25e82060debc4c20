"""Cities of all styles: ``.venv/bin/python tests/benchmarks/cities.py sheet|cost|variety [--out FILE]``.

``sheet`` draws styles by seeds from above. ``cost`` prints what the default city of each style takes: triangles, bytes,
processor seconds to open, to prepare (edges, corners, curved mirrors) and a frame. ``variety`` prints how different
seeds are, to the eye and to the radar (docs/cities.md says what the numbers are).
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from datafactory.frame.prepared import PreparedScene
from datafactory.paths.merged_scene import merge_scene
from datafactory.scenes.city.city import write_city
from datafactory.scenes.city.style import Style
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose
from datafactory.scenes.readers.open import open_scene
from datafactory.view.camera import above_picture
from datafactory.view.subject import Subject
from shared.radar import Radar

REPOSITORY = Path(__file__).resolve().parents[2]
WINDOW_M = {Style.MOTORWAY: 90.0}
"""Half the width of a picture; of all others 75 m."""


def prepared(path: Path) -> PreparedScene:
    scene = open_scene(str(path))
    materials = load_materials().map_materials([item.material for item in scene.objects])
    return PreparedScene(scene.name, scene.content_hash(), merge_scene(scene, materials), materials)


def sheet(folder: Path, seeds: int, out: Path) -> None:
    """Styles in rows, seeds in columns, from above; north is to the left."""
    styles = list(Style)
    figure, axes = plt.subplots(len(styles), seeds, figsize=(3.0 * seeds, 3.0 * len(styles)), layout="constrained")
    for row, style in zip(axes, styles, strict=True):
        half = WINDOW_M.get(style, 75.0)
        for seed, axis in enumerate(row):
            path = folder / f"{style.value}-{seed}.usda"
            write_city(path, seed=seed, style=style)
            subject = Subject(path.stem, prepared(path), Pose((0.0, 0.0, 0.0)), Radar())
            picture = above_picture(subject, (-half, half, half), pixels_a_metre=3.0)
            axis.imshow(picture, interpolation="lanczos")
            axis.set_axis_off()
            axis.set_title(f"{style.value}, seed {seed}", fontsize=9)
    figure.savefig(out, dpi=110)
    print(f"wrote {out}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("sheet", "cost", "variety"))
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--out", type=Path, default=REPOSITORY / "docs" / "cities.png")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if given.what == "sheet":
            sheet(Path(folder), given.seeds, given.out)


if __name__ == "__main__":
    main()
