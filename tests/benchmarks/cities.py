"""Cities of all styles: ``.venv/bin/python tests/benchmarks/cities.py sheet|above|variety [--out FILE]``.

``sheet`` draws styles by seeds from above, ``above`` one scene. ``variety`` prints how different seeds are, to the eye
and to the radar (docs/notes/cities.md says what the numbers are).
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

sys.path.append(str(Path(__file__).resolve().parents[1]))

from manual import ROOT
from prepared_scenes import prepared_scene

from datafactory.effects.catalogue import ALL
from datafactory.frame.chain import ChainSettings, SceneSource, make_frames
from datafactory.paths.solver import TraceSettings
from datafactory.run.preparation import Order, prepare
from datafactory.scenes.city.city import write_city
from datafactory.scenes.city.rules import Style
from datafactory.scenes.ground import HeightMap, height_map
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose
from datafactory.scenes.readers.open import open_scene
from datafactory.view.camera import above_picture
from datafactory.view.subject import Subject
from shared.radar import Radar

Real = NDArray[np.float64]

WINDOW_M = {Style.MOTORWAY: 90.0}
"""Half the width of a picture; of all others 75 m."""


def sheet(folder: Path, seeds: int, out: Path) -> None:
    """Styles in rows, seeds in columns, from above; north is to the left."""
    styles = list(Style)
    figure, axes = plt.subplots(len(styles), seeds, figsize=(3.0 * seeds, 3.0 * len(styles)), layout="constrained")
    for row, style in zip(axes, styles, strict=True):
        half = WINDOW_M.get(style, 75.0)
        for seed, axis in enumerate(row):
            path = folder / f"{style.value}-{seed}.usda"
            write_city(path, seed=seed, style=style)
            subject = Subject(path.stem, prepared_scene(path), Pose((0.0, 0.0, 0.0)), Radar())
            picture = above_picture(subject, (-half, half, half), pixels_a_metre=3.0)
            axis.imshow(picture, interpolation="lanczos")
            axis.set_axis_off()
            axis.set_title(f"{style.value}, seed {seed}", fontsize=9)
    figure.savefig(out, dpi=110)
    print(f"wrote {out}")


def frames(path: Path, count: int, rays: int) -> Iterator[tuple[Pose, Real]]:
    """Pose and truth image of drawn frames."""
    radar = Radar()
    order = Order(
        radar=radar, scenes=(str(path),), frames=count, effects=ALL.without("noise"), split="1:0:0",
        settings=ChainSettings(trace=TraceSettings(rays=rays)),
    )  # fmt: skip
    made = prepare(order, load_materials()).job
    for index in range(count):
        dealt = made.deal.frame(index)
        ((frame, _),) = make_frames([SceneSource(dealt, made.scenes[0], order.of_scenes)], radar)
        assert dealt.pose is not None
        yield dealt.pose, np.asarray(frame.image, dtype=np.float64)


def correlation(one: Real, other: Real) -> float:
    """Of two arrays of one shape, from -1 to 1; 0 where one of them is constant."""
    a, b = one.ravel() - one.mean(), other.ravel() - other.mean()
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size else 0.0


def heights(path: Path) -> HeightMap:
    return height_map(open_scene(str(path)), 1.0)


def best_match(one: HeightMap, other: HeightMap) -> float:
    """Largest normalised cross-correlation of two cities' heights over all shifts that keep half of the larger one."""
    a, b = (np.clip(np.where(np.isfinite(item.highest), item.highest, 0.0), 0.0, 15.0) for item in (one, other))
    a, b = a - a.mean(), b - b.mean()
    both = fftconvolve(a, b[::-1, ::-1])
    return float(both.max() / (np.linalg.norm(a) * np.linalg.norm(b)))


def ahead(surface: HeightMap, pose: Pose) -> Real:
    """Heights [60, 60] above the sensor's ground, 0 to 60 m ahead and 30 m to either side, from 0 to 15 m."""
    x, y = np.meshgrid(np.arange(60) + 0.5, np.arange(-30, 30) + 0.5, indexing="ij")
    yaw = np.radians(pose.yaw_deg)
    wx = pose.position[0] + np.cos(yaw) * x - np.sin(yaw) * y
    wy = pose.position[1] + np.sin(yaw) * x + np.cos(yaw) * y
    i, j = (np.floor((w - o) / surface.cell_m).astype(int) for w, o in zip((wx, wy), surface.origin, strict=True))
    inside = (i >= 0) & (j >= 0) & (i < surface.highest.shape[0]) & (j < surface.highest.shape[1])
    found = surface.highest[np.where(inside, i, 0), np.where(inside, j, 0)]
    return np.where(inside & np.isfinite(found), np.clip(found, 0.0, 15.0), 0.0)


def profile(image: Real) -> Real:
    """[90] level of the truth image by metre of range [dB], down to 60 dB below its strongest."""
    power = (image.astype(np.float64) ** 2).sum(axis=1)[:600]
    metres = power[: 600 // 7 * 7].reshape(-1, 7).mean(axis=1)
    level = 10.0 * np.log10(metres / metres.max() + 1e-6)
    return level - np.linspace(level[:10].mean(), level[-10:].mean(), len(level))


def looks(image: Real) -> Real:
    """The truth image in dB, down to -60, in cells of 0.9 m by 0.038 of u."""
    power = image.astype(np.float64)[:630, :450] ** 2
    cells = power.reshape(105, 6, 45, 10).mean(axis=(1, 3))
    return np.clip(10.0 * np.log10(cells / cells.max() + 1e-9), -60.0, 0.0)


def variety(folder: Path, seeds: int, styles: Sequence[Style], poses: int, rays: int) -> None:
    """How alike two cities of a style are: of other seeds, against other poses in the same city."""
    for style in styles:
        surfaces: list[HeightMap] = []
        views: list[tuple[int, tuple[NDArray[np.float64], ...]]] = []
        for seed in range(seeds):
            path = folder / f"{style.value}-{seed}.usda"
            write_city(path, seed=seed, style=style)
            surfaces.append(heights(path))
            for pose, image in frames(path, poses, rays) if poses else ():
                views.append((seed, (ahead(surfaces[-1], pose), profile(image), looks(image))))
        matches = [best_match(a, b) for a, b in combinations(surfaces, 2)]
        print(
            f"{style.value}: heights of two cities, best shift: mean {np.mean(matches):.2f}, most {np.max(matches):.2f}"
        )
        for number, name in enumerate(("heights ahead", "range profile", "truth image")):
            same = [correlation(a[1][number], b[1][number]) for a, b in combinations(views, 2) if a[0] == b[0]]
            other = [correlation(a[1][number], b[1][number]) for a, b in combinations(views, 2) if a[0] != b[0]]
            if same:
                spread = [float(np.std(values) / len(values) ** 0.5) for values in (same, other)]
                print(f"  {name}: other poses {np.mean(same):.2f} +- {spread[0]:.2f}", end=", ")
                print(f"other seeds {np.mean(other):.2f} +- {spread[1]:.2f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("sheet", "above", "variety"))
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--poses", type=int, default=3, help="frames a city; 0 for heights alone")
    parser.add_argument("--scene", type=Path, help="for above: 240 m around its origin")
    parser.add_argument("--rays", type=int, default=20_000)
    parser.add_argument("--style", choices=[style.value for style in Style], help="all without")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "cities.png")
    given = parser.parse_args()
    styles = [Style(given.style)] if given.style else list(Style)
    with tempfile.TemporaryDirectory() as folder:
        if given.what == "sheet":
            sheet(Path(folder), given.seeds, given.out)
        elif given.what == "above":
            subject = Subject(given.scene.stem, prepared_scene(given.scene), Pose((0.0, 0.0, 0.0)), Radar())
            plt.imsave(given.out, above_picture(subject, (-120.0, 120.0, 120.0), pixels_a_metre=4.0))
        else:
            variety(Path(folder), given.seeds, styles, given.poses, given.rays)


if __name__ == "__main__":
    main()
