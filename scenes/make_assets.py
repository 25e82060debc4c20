"""Write vehicles and street furniture into ``scenes/assets``: ``.venv/bin/python scenes/make_assets.py``.

Metres, z up; vehicles look along +x, signs are read from -x, and all stand at z = 0 about the origin. Each file says by
``radar:class`` what it is. The same versions write the same bytes.

Shapes hold what a radar at bumper height sees: bowed bodies with round corners, wheels in their arches, licence plates,
the bar under a lorry's tail, posts. They leave out what is finer than a wavelength or inside.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parent))

from asset_shapes import bowed_outline, loft, placed, post, recess, round_outline, wheel

from datafactory.scenes.city.shapes import QUARTER_TURN_X, X_TO_Z_CYCLE, Surface, box, joined
from datafactory.scenes.city.site import Placement
from datafactory.scenes.city.usd import write_usd

PARTS = (3, 3, 9)
CABIN_PARTS = (3, 2, 5)


@dataclass(frozen=True)
class CarBody:
    """A passenger car or van.

    :param length, width, height: outer sizes
    :param waist: height of the lower edge of its windows
    :param cabin: x of the rear and front foot of its windows, and of the rear and front end of its roof
    :param axle: distance of either axle from the middle
    :param panels: the windows behind the front seats are sheet metal
    """

    length: float
    width: float
    height: float
    waist: float
    cabin: tuple[float, float, float, float]
    axle: float
    wheel_radius: float = 0.32
    panels: bool = False


CARS = {
    "saloon": CarBody(4.70, 1.82, 1.45, 0.94, (-1.75, 1.00, -1.00, 0.15), 1.40),
    "hatchback": CarBody(4.05, 1.76, 1.48, 0.95, (-1.85, 0.85, -1.50, 0.10), 1.27),
    "suv": CarBody(4.60, 1.90, 1.68, 1.05, (-2.10, 0.90, -1.70, 0.20), 1.35, 0.36),
    "van": CarBody(5.00, 1.94, 1.97, 1.12, (-2.42, 1.75, -2.36, 1.05), 1.50, 0.34, panels=True),
}


def car(body: CarBody) -> Surface:
    """Lower body with arches and wheels, windows and roof above it, plates in front and behind."""
    half, side = 0.5 * body.length, 0.5 * body.width
    heights = (0.20, 0.44, 0.68, body.waist)
    insets = (0.05, 0.005, 0.0, 0.06)
    levels = [
        (z, bowed_outline(half - inset, side - inset, 0.30 - inset, PARTS))
        for z, inset in zip(heights, insets, strict=True)
    ]
    middles = 0.5 * (levels[1][1] + np.roll(levels[1][1], -1, axis=0))

    def arch(band: int, strip: int) -> bool:
        x, y = middles[strip]
        return band < 2 and abs(y) > 0.85 * side and abs(abs(x) - body.axle) < 0.36

    parts = [loft(levels, "metal", floor="metal", lid="metal", left_out=arch)]
    for sign in (1.0, -1.0):
        for x in (-body.axle, body.axle):

            def here(band: int, strip: int, sign: float = sign, x: float = x) -> bool:
                return arch(band, strip) and bool(sign * middles[strip, 1] > 0.0 and x * middles[strip, 0] > 0.0)

            def inwards(points: np.ndarray, sign: float = sign, x: float = x) -> np.ndarray:
                """To the arch's ground, which is smaller than its mouth: real ones have no right angles."""
                return np.array([x, 0.0, 0.2]) + (points - [x, 0.0, 0.2]) * [0.75, 1.0, 0.8] - [0.0, 0.28 * sign, 0.0]

            parts.append(recess(levels, here, inwards, "metal"))
            parts.append(wheel(body.wheel_radius, 0.2, x, sign * (side - 0.12)))
    parts.append(_cabin(body, side))
    for sign in (1.0, -1.0):
        plate = sign * (half + 0.008)
        low, high = sorted((plate - sign * 0.02, plate))
        parts.append(box((low, -0.26, 0.40), (high, 0.26, 0.51), "metal"))
    return joined(parts)


def _cabin(body: CarBody, side: float) -> Surface:
    """Windows between pillars, which are the corners of the outline, and a roof with a rounded edge."""
    rear, front, roof_rear, roof_front = body.cabin
    eaves = body.height - 0.08
    shapes = (
        (body.waist, rear, front, side - 0.09, 0.16),
        (eaves, roof_rear - 0.05, roof_front + 0.05, side - 0.22, 0.16),
        (body.height, roof_rear + 0.12, roof_front - 0.12, side - 0.38, 0.16),
    )
    levels = []
    for z, back, ahead, half_width, corner in shapes:
        outline = bowed_outline(0.5 * (ahead - back), half_width, corner, CABIN_PARTS)
        levels.append((z, outline + np.array([0.5 * (ahead + back), 0.0])))
    ends, corners, sides = CABIN_PARTS
    quarter = [*["glass"] * ends, *["metal"] * corners, *["glass"] * sides, *["metal"] * corners]
    around = [*quarter, *quarter]
    x = levels[0][1][:, 0]

    def material(band: int, strip: int) -> str:
        shut = body.panels and x[strip] < 0.6
        return "metal" if band > 0 or shut else around[strip]

    return loft(levels, material, lid="metal")


def truck() -> Surface:
    """A lorry of 8.4 x 2.5 x 3.5 m: cab, box of sheet metal, frame, six wheels, tanks, and a bar under its tail."""
    cab_levels = []
    for z, inset in ((0.45, 0.04), (0.75, 0.0), (1.45, 0.0), (2.55, 0.10), (2.90, 0.22)):
        outline = bowed_outline(0.95 - inset, 1.22 - inset, 0.25 - 0.5 * inset, (3, 3, 5))
        cab_levels.append((z, outline + np.array([3.25, 0.0])))
    ends, corners, sides = 3, 3, 5
    glazed = [*["glass"] * ends, *["metal"] * corners, *["glass"] * sides]
    cab = loft(
        cab_levels,
        lambda band, strip: glazed[strip] if band == 2 and strip < len(glazed) else "metal",
        floor="metal",
        lid="metal",
    )
    parts = [
        cab,
        box((-4.2, -1.25, 1.05), (2.05, 1.25, 3.5), "metal"),
        box((-4.1, -0.45, 0.75), (3.0, 0.45, 1.0), "metal"),
        placed(post(0.06, -1.15, 1.15, "metal"), (-4.1, 0.0, 0.5), QUARTER_TURN_X),
        placed(post(0.30, -0.5, 0.5, "metal"), (0.2, 0.85, 0.72), X_TO_Z_CYCLE),
        placed(post(0.30, -0.5, 0.5, "metal"), (0.2, -0.85, 0.72), X_TO_Z_CYCLE),
        box((4.17, -0.26, 0.5), (4.205, 0.26, 0.61), "metal"),
        box((-4.205, -0.26, 0.7), (-4.17, 0.26, 0.81), "metal"),
    ]
    return joined([*parts, *(wheel(0.5, 0.3, x, y) for y in (1.08, -1.08) for x in (-3.1, -1.9, 3.0))])


def bus() -> Surface:
    """A city bus of 12 x 2.55 x 3.1 m with a band of windows and a rounded roof."""
    shapes = ((0.30, 0.03), (0.60, 0.0), (1.10, 0.0), (2.45, 0.04), (2.90, 0.10), (3.05, 0.25), (3.10, 0.60))
    levels = [(z, bowed_outline(6.0 - inset, 1.275 - inset, 0.35 - 0.5 * inset, (3, 3, 27))) for z, inset in shapes]
    corners = [*[False] * 3, *[True] * 3, *[False] * 27, *[True] * 3] * 2
    parts = [
        loft(levels, lambda band, strip: "glass" if band == 2 and not corners[strip] else "metal", "metal", "metal"),
        box((5.99, -0.26, 0.4), (6.01, 0.26, 0.51), "metal"),
        box((-6.01, -0.26, 0.7), (-5.99, 0.26, 0.81), "metal"),
    ]
    return joined([*parts, *(wheel(0.48, 0.28, x, y) for y in (1.15, -1.15) for x in (-3.1, 2.9))])


def lamp() -> Surface:
    """A steel lamp post of 7 m with an arm of 1.5 m towards -y."""
    arm = placed(post(0.04, 0.0, 1.5, "metal"), (0.0, 0.0, 6.9), QUARTER_TURN_X)
    return joined([post((0.09, 0.05), 0.0, 7.0, "metal"), arm, box((-0.12, -1.9, 6.85), (0.12, -1.4, 6.97), "metal")])


def traffic_light() -> Surface:
    """A post of 3.4 m with a head of three lamps that face -x."""
    head = [box((-0.16, -0.15, 2.35), (0.1, 0.15, 3.3), "metal")]
    for z in (2.52, 2.82, 3.12):
        lens = placed(post(0.1, 0.0, 0.03, "glass"), (-0.19, 0.0, z), X_TO_Z_CYCLE)
        head.append(lens)
    return joined([post(0.057, 0.0, 3.4, "metal"), *[placed(part, (-0.06, 0.0, 0.0)) for part in head]])


def bollard() -> Surface:
    """A steel bollard of 0.95 m with a domed head."""
    levels = [(0.0, round_outline(0.08, 16)), (0.87, round_outline(0.08, 16))]
    levels += [(0.87 + 0.08 * np.sin(a), round_outline(0.08 * np.cos(a), 16)) for a in np.radians((20, 40, 60, 78))]
    return loft(levels, "metal", floor="metal", lid="metal")


def sign(outline: str) -> Surface:
    """A sheet of 4 mm on a post, readable from -x: ``"round"``, ``"triangle"``, ``"octagon"`` or ``"panel"``."""
    octagon = round_outline(0.42 / np.cos(np.pi / 8), 8) @ _turn(np.pi / 8).T
    outlines = {
        "round": round_outline(0.30, 20),
        "triangle": np.array([(0.45, -0.26), (0.0, 0.52), (-0.45, -0.26)])[::-1],
        "octagon": octagon,
        "panel": np.array([(-0.3, -0.45), (0.3, -0.45), (0.3, 0.45), (-0.3, 0.45)]),
    }
    edge = outlines[outline]
    sheet = placed(loft([(0.0, edge), (0.004, edge)], "metal", "metal", "metal"), (-0.044, 0.0, 2.5), X_TO_Z_CYCLE)
    return joined([post(0.03, 0.0, 3.0, "metal"), sheet])


def _turn(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def litter_bin() -> Surface:
    """A bin of sheet metal, 0.9 m high."""
    return post(0.22, 0.0, 0.9, "metal")


def bench() -> Surface:
    """A bench of 1.8 m along x: wooden seat and back, legs of metal; who sits on it looks along -y."""
    parts = [box((x - 0.03, -0.22, 0.0), (x + 0.03, 0.25, 0.42), "metal") for x in (-0.75, 0.75)]
    parts += [box((-0.9, -0.24, 0.42), (0.9, 0.2, 0.46), "wood"), box((-0.9, 0.2, 0.55), (0.9, 0.24, 0.85), "wood")]
    parts += [box((x - 0.03, 0.2, 0.42), (x + 0.03, 0.24, 0.85), "metal") for x in (-0.75, 0.75)]
    return joined(parts)


ASSETS: dict[str, tuple[str, Callable[[], Surface]]] = {
    **{name: ("car", partial(car, body)) for name, body in CARS.items()},
    "truck": ("truck", truck),
    "bus": ("bus", bus),
    "lamp": ("pole", lamp),
    "traffic_light": ("pole", traffic_light),
    "bollard": ("pole", bollard),
    **{f"sign_{kind}": ("sign", partial(sign, kind)) for kind in ("round", "triangle", "octagon", "panel")},
    "bin": ("other", litter_bin),
    "bench": ("other", bench),
}
"""Class and shape of every file, by its name."""


def main(folder: Path) -> None:
    """Write every asset."""
    for name, (label, build) in ASSETS.items():
        surface = build()
        low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
        x, y, z = np.round(high - low, 2)
        about = f"{name}: {x:g} x {y:g} x {z:g} m. Metres, z up, x ahead."
        write_usd(folder / f"{name}.usda", [Placement(name.capitalize(), surface, radar_class=label)], about)


if __name__ == "__main__":
    main(Path(__file__).resolve().parent / "assets")
