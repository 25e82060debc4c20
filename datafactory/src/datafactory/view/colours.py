"""The colour of every material and of every kind of path, the same in the page and in the pictures."""

from __future__ import annotations

import colorsys
import hashlib

Colour = tuple[int, int, int]
"""Red, green, blue, 0 to 255."""

MATERIALS: dict[str, Colour] = {
    "concrete": (178, 176, 170), "road_concrete": (150, 149, 145), "asphalt": (92, 93, 98), "brick": (178, 98, 74),
    "plasterboard": (222, 214, 198), "ceiling_board": (232, 228, 220), "marble": (214, 206, 214),
    "wood": (176, 132, 84), "chipboard": (196, 158, 110), "plywood": (206, 172, 124), "floorboard": (158, 112, 66),
    "glass": (126, 186, 214), "acrylic": (160, 204, 224), "metal": (70, 110, 168), "polypropylene": (98, 88, 150),
    "tyre_rubber": (52, 50, 54), "very_dry_ground": (206, 184, 140), "medium_dry_ground": (172, 148, 104),
    "wet_ground": (128, 106, 74), "water": (74, 132, 196), "vegetation": (106, 154, 84), "human_skin": (226, 168, 140),
}  # fmt: skip
"""Of the material table, as one would paint them; metal is blue, so that it stands out."""

DIRECT, MIRROR, SEVERAL = "direct scatter", "mirror", "multi-bounce"
DIFFRACTION, REFRACTION = "diffraction", "refraction"
KINDS: dict[str, Colour] = {
    DIRECT: (213, 94, 0),
    MIRROR: (0, 114, 178),
    SEVERAL: (160, 32, 120),
    DIFFRACTION: (0, 140, 90),
    REFRACTION: (204, 153, 0),
}
"""Kinds of path, after Okabe and Ito, Color Universal Design, 2008: told apart with any kind of colour vision."""

SENSOR: Colour = (20, 20, 20)
MOTION: Colour = (220, 20, 60)
TARGET: Colour = (255, 0, 160)


def material_colour(name: str) -> Colour:
    """A material's colour; one that is not in the table has one that follows from its name."""
    if name in MATERIALS:
        return MATERIALS[name]
    digest = hashlib.sha256(name.encode()).digest()
    red, green, blue = colorsys.hls_to_rgb(digest[0] / 256.0, 0.6, 0.35)
    return round(255 * red), round(255 * green), round(255 * blue)


def css(colour: Colour) -> str:
    """``#rrggbb``."""
    return "#{:02x}{:02x}{:02x}".format(*colour)
