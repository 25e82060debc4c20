"""What stands in streets: lamps, signs, signals, rails, shelters, trees. Metres, z up, base at z = 0.

Every part is closed, and its normals point outwards.

A tree's crown at 77 GHz is a volume of leaves, each larger than the wavelength. Here it is a closed, ragged shell of 80
facets of the material *vegetation*: a rough surface that scatters what reaches it, in all directions, from its outside.
Nothing passes through it and nothing moves in it: what stands behind a crown is hidden, and wind has no Doppler.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from datafactory.scenes.city.shapes import X_TO_Z_CYCLE, Surface, blob, box, cylinder, joined, prism


def lamp_post(height: float = 7.0) -> Surface:
    """Steel lamp post: mast at the origin, arm and luminaire reaching 1.8 m towards -y at its top."""
    mast = cylinder(0.075, 0.0, height, 12, "metal")
    arm = box((-0.03, -1.4, height - 0.1), (0.03, 0.0, height - 0.04), "metal")
    return joined([mast, arm, box((-0.12, -1.8, height - 0.14), (0.12, -1.3, height - 0.02), "metal")])


def sign(kind: str) -> Surface:
    """Traffic sign on a post: a 5 mm plate that faces -x, as ``"round"``, ``"triangle"`` or ``"panel"``."""
    angle = 2.0 * np.pi * np.arange(16) / 16
    outlines = {
        "round": 0.3 * np.column_stack([np.cos(angle), np.sin(angle)]),
        "triangle": np.array([(-0.45, -0.26), (0.45, -0.26), (0.0, 0.52)]),
        "panel": np.array([(-0.3, -0.45), (0.3, -0.45), (0.3, 0.45), (-0.3, 0.45)]),
    }
    plate = prism(outlines[kind], 0.0, 0.005, "metal").moved((-0.04, 0.0, 2.45), X_TO_Z_CYCLE)
    return joined([cylinder(0.03, 0.0, 2.9, 12, "metal"), plate])


def bollard() -> Surface:
    """Steel bollard, 1 m."""
    return cylinder(0.06, 0.0, 1.0, 12, "metal")


def litter_bin() -> Surface:
    """Litter bin of sheet metal, 0.9 m."""
    return cylinder(0.24, 0.0, 0.9, 12, "metal")


def street_tree(rng: np.random.Generator, radius: float) -> Surface:
    """A tree whose crown stays within 1.2 ``radius`` [m] of its trunk and begins 3.9 m above the ground, or higher.

    Lorries pass below it, as they must (RASt 06 asks for 4.5 m over roads).
    """
    crown = blob((radius, radius, rng.uniform(1.1, 1.6) * radius), 0.2, rng, "vegetation")
    bottom = 3.9 + rng.uniform(0.0, 0.8)
    trunk = cylinder(rng.uniform(0.1, 0.2), 0.0, bottom + 0.5 * radius, 10, "wood")
    return joined([trunk, crown.moved((0.0, 0.0, bottom - crown.vertices[:, 2].min()))])


def conifer(rng: np.random.Generator) -> Surface:
    """A conifer: a trunk under three stacked rings of branches, 6 to 9 m high, at most 1.8 m wide to each side."""
    height, radius = rng.uniform(6.0, 9.0), rng.uniform(1.3, 1.8)
    angle = 2.0 * np.pi * np.arange(9) / 9
    trunk = cylinder(0.14, 0.0, 1.2, 10, "wood")
    rings, bottom = [], 1.2
    for share in (1.0, 0.72, 0.42):
        top = bottom + (height - 1.2) / 3.0
        rx, ry = radius * share * rng.uniform(0.8, 1.0, 2)
        rings.append(prism(np.column_stack([rx * np.cos(angle), ry * np.sin(angle)]), bottom, top, "vegetation"))
        bottom = top
    return joined([trunk, *rings])


def traffic_light() -> Surface:
    """A signal on a post: its head faces -x."""
    return joined([cylinder(0.06, 0.0, 3.4, 12, "metal"), box((-0.36, -0.15, 2.4), (-0.07, 0.15, 3.3), "metal")])


def guard_rail(length: float, spacing: float) -> Surface:
    """Steel guard rail from x = 0 to ``length``: a beam of two ribs 0.75 m high that faces -y, posts every ``spacing``.

    The ribs and the sheet between them are those of a W beam (EN 1317, 310 mm high), with square edges.
    """
    beam = [
        box((0.0, 0.0, 0.44), (length, 0.01, 0.75), "metal"),
        box((0.0, -0.08, 0.44), (length, 0.0, 0.54), "metal"),
        box((0.0, -0.08, 0.65), (length, 0.0, 0.75), "metal"),
    ]
    count = max(1, int(length / spacing))
    places = [(index + 0.5) * length / count for index in range(count)]
    return joined([*beam, *(box((x - 0.05, 0.01, 0.0), (x + 0.05, 0.11, 0.72), "metal") for x in places)])


def pedestrian_rail(length: float) -> Surface:
    """Railing of tubes along a kerb from x = 0 to ``length``, 1 m high."""
    posts = [
        box((x - 0.025, -0.025, 0.0), (x + 0.025, 0.025, 0.94), "metal") for x in np.linspace(0.05, length - 0.05, 3)
    ]
    bars = [box((0.0, -0.025, z), (length, 0.025, z + 0.06), "metal") for z in (0.94,)]
    return joined([*posts, *bars, box((0.08, -0.015, 0.45), (0.5 * length - 0.03, 0.015, 0.49), "metal")])


def barrier(length: float) -> Surface:
    """Concrete safety barrier from x = 0 to ``length``, 0.8 m high and 0.6 m wide (New Jersey profile)."""
    profile = [
        (-0.3, 0.0), (0.3, 0.0), (0.3, 0.08), (0.11, 0.33), (0.08, 0.8), (-0.08, 0.8), (-0.11, 0.33), (-0.3, 0.08),
    ]  # fmt: skip
    # The profile is not convex at its waist: a foot and a wall that stands on it.
    foot = prism([profile[i] for i in (0, 1, 2, 3, 6, 7)], 0.0, length, "concrete").moved((0.0, 0.0, 0.0), X_TO_Z_CYCLE)
    wall = prism([profile[i] for i in (6, 3, 4, 5)], 0.0, length, "concrete").moved((0.0, 0.0, 0.0), X_TO_Z_CYCLE)
    return joined([foot, wall])


def bus_shelter() -> Surface:
    """A shelter that opens towards -y: glass panes in steel frames at its back and ends, a roof, a bench."""
    posts = [
        box((x - 0.04, y - 0.04, 0.0), (x + 0.04, y + 0.04, 2.4), "metal") for x in (-2.0, 2.0) for y in (0.0, 1.2)
    ]
    back = box((-1.96, 1.19, 0.3), (1.96, 1.21, 2.1), "glass")
    ends = [box((x - 0.01, 0.04, 0.3), (x + 0.01, 1.16, 2.1), "glass") for x in (-2.0, 2.0)]
    roof = box((-2.2, -0.2, 2.4), (2.2, 1.4, 2.5), "metal")
    bench = box((-1.6, 0.75, 0.42), (1.6, 1.1, 0.47), "wood")
    legs = [box((x - 0.04, 0.85, 0.0), (x + 0.04, 0.95, 0.42), "metal") for x in (-1.3, 1.3)]
    return joined([*posts, back, *ends, roof, bench, *legs])


def manhole_cover() -> Surface:
    """A cast iron cover of 0.6 m, 5 mm above the road."""
    return cylinder(0.3, 0.0, 0.005, 16, "metal")


def fence(length: float) -> Surface:
    """A steel fence from x = 0 to ``length``, 1.8 m high: posts and two rails. A mesh does not hold its thin wires."""
    places = (0.03, 0.5 * length, length - 0.03)
    posts = [box((x - 0.03, -0.03, 0.0), (x + 0.03, 0.03, 1.7), "metal") for x in places]
    low = [box((a + 0.03, -0.02, 0.25), (b - 0.03, 0.02, 0.3), "metal") for a, b in pairwise(places)]
    return joined([*posts, *low, box((0.0, -0.03, 1.7), (length, 0.03, 1.76), "metal")])


def container() -> Surface:
    """A sea container of 20 feet: 6.06 x 2.44 x 2.59 m, its long sides with upright ribs."""
    body = box((-3.03, -1.18, 0.0), (3.03, 1.18, 2.59), "metal")
    places = np.linspace(-2.8, 2.8, 8)
    left = [box((x - 0.1, 1.18, 0.1), (x + 0.1, 1.22, 2.5), "metal") for x in places]
    right = [box((x - 0.1, -1.22, 0.1), (x + 0.1, -1.18, 2.5), "metal") for x in places]
    return joined([body, *left, *right])


def tank(radius: float, height: float) -> Surface:
    """An upright storage tank of sheet steel, 48 sides, on a concrete slab."""
    slab = cylinder(radius + 0.4, 0.0, 0.2, 24, "concrete")
    return joined([slab, cylinder(radius, 0.2, height, 48, "metal")])


def gantry(half_span: float) -> Surface:
    """A sign gantry across a motorway: posts at y = +-``half_span``, a beam, four panels that face -x."""
    posts = [box((-0.2, y - 0.2, 0.0), (0.2, y + 0.2, 5.6), "metal") for y in (-half_span, half_span)]
    beam = box((-0.25, -half_span - 0.2, 5.6), (0.25, half_span + 0.2, 6.3), "metal")
    step = 2.0 * half_span / 4.0
    panels = [
        box((-0.31, -half_span + (i + 0.2) * step, 5.3), (-0.25, -half_span + (i + 0.8) * step, 7.4), "metal")
        for i in range(4)
    ]
    return joined([*posts, beam, *panels])


def noise_wall(length: float, height: float, material: str) -> Surface:
    """A noise barrier from x = 0 to ``length``: panels between steel posts that stand 8 cm before them."""
    panel = box((0.0, -0.06, 0.0), (length, 0.06, height), material)
    posts = [box((x, -0.14, 0.0), (x + 0.16, -0.06, height), "metal") for x in (0.0, 0.5 * length)]
    return joined([panel, *posts])


def bench() -> Surface:
    """A bench of wood on two feet of concrete."""
    feet = [box((x - 0.1, -0.2, 0.0), (x + 0.1, 0.2, 0.42), "concrete") for x in (-0.6, 0.6)]
    return joined([*feet, box((-0.9, -0.22, 0.42), (0.9, 0.22, 0.48), "wood")])
