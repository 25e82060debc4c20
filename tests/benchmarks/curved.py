"""Draw docs/curved.png: what round metal bodies send back by aspect, as flat facets, as curved mirrors, in closed form.

    python tests/benchmarks/curved.py [FILE.png]

The bodies turn about the vertical axis 8 m before a sensor at their height. All are tessellated with folds of 15 deg.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from scipy.special import fresnel

sys.path.append(str(Path(__file__).resolve().parents[1]))

from curved_bodies import Mesh, cylinder, rounded_box, sphere
from sionna_scenes import WAVELENGTH_M, mesh, scene_of, view_of

from datafactory.paths import smooth
from datafactory.paths.backend import select_variant
from datafactory.paths.curved_echoes import curved_mirrors
from datafactory.paths.mirrors import single_mirrors
from datafactory.paths.solver import TraceSettings
from datafactory.scenes.poses import Pose

Real = NDArray[np.float64]
Shares = Callable[[Real], NDArray[np.complex128]]

DISTANCE_M = 8.0
HALF, ROUNDING_M = (2.2, 0.9, 0.7), 0.35
"""Half sides of the car body, and the radius of its rounded edges [m]."""
ASPECT_DEG = np.arange(0.0, 90.1, 0.5)
NOTHING_DBSM = -60.0


def levels_dbsm(of: Mesh, folds_deg: float) -> Real:
    """[aspects] radar cross section of what single mirrors send back, with surfaces smooth up to ``folds_deg``."""
    home, settings, found = Pose((0.0, 0.0, 0.0)), TraceSettings(diffuse=False), []
    before, smooth.SMOOTH_FOLD_DEG = smooth.SMOOTH_FOLD_DEG, folds_deg
    for aspect in np.radians(ASPECT_DEG):
        turn = np.array(
            [[np.cos(aspect), -np.sin(aspect), 0.0], [np.sin(aspect), np.cos(aspect), 0.0], [0.0, 0.0, 1.0]]
        )
        merged = scene_of(mesh("body", of[0] @ turn.T + np.array([DISTANCE_M, 0.0, 0.0]), of[1], "metal"))
        view = view_of(merged, home, settings)
        flat, points, images = single_mirrors(view)[0], *curved_mirrors(view)[:2]
        parts = (points, images, flat)
        delay = np.exp(4j * np.pi / WAVELENGTH_M * np.concatenate([part.range_m() for part in parts]))
        echo = np.sum(np.concatenate([part.amplitude for part in parts]) * delay)
        range_m = min((part.range_m().min() for part in parts if len(part)), default=1.0)
        found.append(abs(echo) * range_m**2)
    smooth.SMOOTH_FOLD_DEG = before
    return in_dbsm(np.array(found))


def in_dbsm(amplitude_times_square_range: Real) -> Real:
    section = (4.0 * np.pi) ** 3 * amplitude_times_square_range**2 / WAVELENGTH_M**2
    return 10.0 * np.log10(np.maximum(section, 10.0 ** (0.1 * NOTHING_DBSM)))


def strip(low: Real | float, high: Real | float, range_m: Real | float) -> NDArray[np.complex128]:
    """Share of a strip between these offsets [m] from the foot, of a plane at ``range_m``."""
    scale = 2.0 / np.sqrt(range_m * WAVELENGTH_M)
    (sine_low, cosine_low), (sine, cosine) = fresnel(np.asarray(low) * scale), fresnel(np.asarray(high) * scale)
    return (cosine - cosine_low + 1j * (sine - sine_low)) / (1.0 + 1j)


def closed_sphere(radius: float) -> Real:
    range_m = DISTANCE_M - radius
    return in_dbsm(np.full(len(ASPECT_DEG), WAVELENGTH_M * range_m / (8.0 * np.pi) * radius / DISTANCE_M))


def closed_cylinder(radius: float, length: float, distance: Real | float) -> Real:
    """[aspects] of a standing cylinder: amplitude times range squared."""
    range_m = np.asarray(distance) - radius
    share = np.abs(strip(-0.5 * length, 0.5 * length, range_m))
    return WAVELENGTH_M * range_m / (8.0 * np.pi) * share / np.sqrt(1.0 + range_m / radius) * np.ones(len(ASPECT_DEG))


def closed_car() -> Real:
    """Front and side are flat mirrors while the sensor stands before them; in between there is the rounded edge."""
    aspect = np.radians(ASPECT_DEG)
    straight = np.array(HALF) - ROUNDING_M
    corner = np.array([DISTANCE_M * np.cos(aspect) - straight[0], DISTANCE_M * np.sin(aspect) - straight[1]])
    level = closed_cylinder(ROUNDING_M, 2.0 * straight[2], np.hypot(*corner))
    for half, across, ahead in (
        (HALF[0], DISTANCE_M * np.sin(aspect), DISTANCE_M * np.cos(aspect)),
        (HALF[1], DISTANCE_M * np.cos(aspect), DISTANCE_M * np.sin(aspect)),
    ):
        width = straight[1] if half == HALF[0] else straight[0]
        range_m = np.maximum(ahead - half, 0.01)
        share = strip(-width - across, width - across, range_m) * strip(-straight[2], straight[2], range_m)
        before = (across < width) & (ahead > half)
        level = np.where(before, WAVELENGTH_M * range_m / (8.0 * np.pi) * np.abs(share), level)
    return in_dbsm(level)


def draw() -> plt.Figure:
    """Three panels, one a body."""
    select_variant()
    bodies = (
        ("sphere, radius 0.5 m", sphere(0.5, 24), closed_sphere(0.5)),
        (
            "standing cylinder, radius 0.3 m, 1 m high",
            cylinder(0.3, 1.0, 24),
            in_dbsm(closed_cylinder(0.3, 1.0, DISTANCE_M)),
        ),
        ("rounded car body, 4.4 x 1.8 x 1.4 m", rounded_box(HALF, ROUNDING_M, 6), closed_car()),
    )
    figure, panels = plt.subplots(1, 3, figsize=(13.0, 4.2), sharey=True, constrained_layout=True)
    for panel, (title, of, closed) in zip(panels, bodies, strict=True):
        curved = levels_dbsm(of, smooth.SMOOTH_FOLD_DEG)
        panel.plot(ASPECT_DEG, levels_dbsm(of, 0.0), ".", color="0.6", markersize=4, label="flat facets")
        panel.plot(ASPECT_DEG, closed, color="tab:orange", linewidth=4, alpha=0.6, label="closed form")
        panel.plot(ASPECT_DEG, curved, color="tab:blue", linewidth=1, label="curved mirrors")
        panel.set(title=title, xlabel="aspect [deg]", xlim=(0.0, 90.0), ylim=(NOTHING_DBSM - 2.0, 40.0))
        panel.grid(alpha=0.3)
        off = np.abs(curved - closed)
        print(f"{title}: largest difference {off.max():.2f} dB, median {np.median(off):.2f} dB")
    panels[0].set_ylabel(f"radar cross section [dBsm]; {NOTHING_DBSM:g}: no echo")
    panels[0].legend(loc="upper right")
    return figure


if __name__ == "__main__":
    draw().savefig(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/curved.png"), dpi=90, metadata={"Software": None})
