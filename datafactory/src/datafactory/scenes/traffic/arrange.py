"""Who drives, parks, walks and stands where along the stretches of road: the shipped vehicles and street furniture.

The rules: docs/populate.md#where-everything-goes. Numbers that are asked for are dealt to the stretches in turn. What
stands is put on the ground under it, and left out where that is no plane.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from datafactory.scenes.ground import Ground
from datafactory.scenes.motion import Track
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import SceneObject
from datafactory.scenes.things import Strip
from datafactory.scenes.traffic.stretches import (
    FURNITURE_M,
    Course,
    Layout,
    Line,
    Stretch,
    layout_of,
    length_of,
    plane_under,
    spaced,
    tilted,
)
from shared.physics.errors import InputError, meant

LARGEST_COUNT = 2000
"""Of a kind, however it was asked for."""
LARGEST_DENSITY = 100.0
"""One a metre: more than has room of any kind."""
PER_100_M = "/100m"
"""Behind the number of a density."""
CHOICES: dict[str, tuple[tuple[str, ...], tuple[float, ...] | None]] = {
    "cars": (("saloon", "hatchback", "suv", "van"), (0.35, 0.35, 0.2, 0.1)),
    "poles": (("lamp", "traffic_light", "bollard"), (0.6, 0.15, 0.25)),
    "signs": (("sign_round", "sign_triangle", "sign_octagon", "sign_panel"), None),
}
"""What the things of a kind may be, and with which shares; None: equal ones."""
OVER_THE_ROAD = ("lamp", "bin", "bench")
"""Furniture that is turned to the road: a lamp's arm lies along -y. The rest is turned to those who come."""
REACH_M = 2.2
"""What is higher than this above the ground may reach over others: a lamp's arm."""
HEADWAY_M = 18.0
"""Of a lane for each vehicle, at least, from middle to middle: a bus, and 6 m."""
CYCLING_M, WALKING_M = 8.0, 3.0
"""The same of cyclists and walkers."""
END_M = 6.5
"""Vehicles' middles stay so far from a stretch's ends: half a bus."""
SLOT_M = 6.2
"""Of kerb for a parked car."""
VEHICLE_MPS, CYCLING_MPS, WALKING_MPS = (8.0, 14.0), (3.5, 6.5), (0.8, 1.7)
STATURE_M = (1.55, 1.92)
UNEVEN_M = 0.08
"""How far the ground may be off the plane that something stands on."""


COUNTED = ("cars", "trucks", "buses", "cyclists", "pedestrians", "poles", "signs", "bins", "benches")
KINDS = (*COUNTED, "parked")


@dataclass(frozen=True)
class Asked:
    """How much of what a scene is to be populated with.

    :param counts: by kind: cars, trucks and buses that drive, cyclists, pedestrians that walk, poles (lamps, traffic
        lights and bollards), signs of traffic, bins and benches; without those that were not asked for
    :param parked: share of the kerbs along the populated roads that parked cars take, 0 to 1
    :param densities: by kind, a hundred metres of populated road, instead of a number
    """

    counts: dict[str, int]
    parked: float = 0.0
    densities: dict[str, float] = field(default_factory=dict)

    def along(self, road_m: float) -> Asked:
        """With numbers in place of densities, for so much road [m]."""
        numbers = {kind: min(round(each * road_m / 100.0), LARGEST_COUNT) for kind, each in self.densities.items()}
        counts = self.counts | numbers
        return Asked({kind: counts[kind] for kind in COUNTED if counts.get(kind)}, self.parked)

    @property
    def text(self) -> str:
        """As ``--populate`` takes it."""
        said = {kind: f"{count:g}" for kind, count in (*self.counts.items(), ("parked", self.parked)) if count}
        said |= {kind: f"{density:g}{PER_100_M}" for kind, density in self.densities.items()}
        return ",".join(f"{kind}={said[kind]}" for kind in KINDS if kind in said)


def parse_populate(text: str) -> Asked:
    """``"cars=20,parked=0.6"`` or ``"cars=4/100m"`` as a value.

    :raises InputError: an entry without a number, an unknown or doubled kind, a number out of its bounds
    """
    found: dict[str, float] = {}
    densities: dict[str, float] = {}
    for entry in text.split(","):
        kind, equals, value = (part.strip() for part in entry.partition("="))
        if kind not in KINDS:
            raise InputError("--populate", f"unknown kind {kind!r}", f"one of {', '.join(KINDS)}{meant(kind, KINDS)}")
        if kind in found or kind in densities:
            raise InputError("--populate", f"{kind} is given twice", "each kind once")
        if not equals:
            raise InputError("--populate", f"{kind} without a number", f"{kind}=NUMBER")
        if kind == "parked":
            found[kind] = _number(kind, value, 1.0, "a share of the kerb from 0 to 1")
        elif value.endswith(PER_100_M):
            expected = f"from 0 to {LARGEST_DENSITY:g} a hundred metres of road, as {kind}=4{PER_100_M}"
            densities[kind] = _number(kind, value, LARGEST_DENSITY, expected)
        else:
            found[kind] = _number(kind, value, LARGEST_COUNT, f"a whole number from 0 to {LARGEST_COUNT}", whole=True)
    counts = {kind: int(found[kind]) for kind in COUNTED if found.get(kind)}
    return Asked(counts, found.get("parked", 0.0), densities)


def _number(kind: str, value: str, most: float, expected: str, whole: bool = False) -> float:
    """:raises InputError: no number from 0 to ``most``, or no ``whole`` one"""
    try:
        number = float(value.removesuffix(PER_100_M) if kind in COUNTED else value)
    except ValueError:
        number = math.nan
    if not 0.0 <= number <= most or (whole and not (value.isascii() and value.isdigit())):
        raise InputError("--populate", f"{kind}={value}", expected)
    return number


@dataclass(frozen=True, eq=False)
class Asset:
    """A thing in its own frame, x ahead, standing at z = 0.

    :param label: its class, as its file has it
    :param parts: its meshes
    :param foot: length and width of what of it stands below ``REACH_M``, about the origin [m]
    """

    label: str
    parts: tuple[SceneObject, ...]
    foot: tuple[float, float]


@lru_cache(maxsize=32)
def asset(name: str) -> Asset:
    """The asset in ``scenes/assets/NAME.usda``."""
    scene = open_scene(f"shipped:assets/{name}")
    parts = tuple(replace(item, name=item.name.rpartition("/")[2].lower()) for item in scene.objects)
    points = np.concatenate([item.vertices for item in parts])
    low = points[points[:, 2] <= REACH_M]
    half = np.abs(low[:, :2]).max(axis=0)
    label = next(item.label.class_name for item in scene.objects if item.label is not None)
    return Asset(label, parts, (2.0 * float(half[0]), 2.0 * float(half[1])))


@dataclass(frozen=True)
class Arranged:
    """One thing with its place.

    :param kind: as it was asked for; :param what: an asset, ``"pedestrian"`` or ``"cyclist"``
    :param position: of its origin at time 0 [m]; :param axes: [3, 3] rows ahead, left, up
    :param course: the line that it moves along, and how far along it is at time 0; None where it stands
    :param stature_m: of a pedestrian
    """

    kind: str
    what: str
    position: tuple[float, float, float]
    axes: np.ndarray
    course: tuple[Course, float] | None = None
    stature_m: float = 0.0

    def motion(self) -> Track | None:
        return None if self.course is None else self.course[0].track(self.course[1])


def arrange(stretches: Sequence[Stretch], ground: Ground, asked: Asked, rng: np.random.Generator) -> list[Arranged]:
    """Places of what was asked for, as much of it as there is room for."""
    layouts = [layout_of(stretch.strip.half_width_m, asked.parked > 0.0, rng) for stretch in stretches]
    roads = list(zip(stretches, layouts, strict=True))
    wanted = {kind: [kind] * asked.counts.get(kind, 0) for kind in COUNTED}
    vehicles = [*wanted["cars"], *wanted["trucks"], *wanted["buses"]]
    placements = list(_streams(roads, [vehicles[n] for n in rng.permutation(len(vehicles))], "lanes", rng))
    placements += _streams(roads, wanted["cyclists"], "cycling", rng)
    placements += _streams(roads, wanted["pedestrians"], "walking", rng)
    placements += _parked(roads, ground, asked.parked, rng)
    placements += _furniture(roads, ground, asked, rng)
    return placements


def _streams(
    roads: Sequence[tuple[Stretch, Layout]], kinds: Sequence[str], lines: str, rng: np.random.Generator
) -> Iterator[Arranged]:
    """What moves, dealt to all lines of one use in turn."""
    end_m, least_m, speeds = {
        "lanes": (END_M, HEADWAY_M, VEHICLE_MPS),
        "cycling": (1.5, CYCLING_M, CYCLING_MPS),
        "walking": (1.0, WALKING_M, WALKING_MPS),
    }[lines]
    every: list[tuple[Stretch, Line]] = [
        (stretch, line) for stretch, layout in roads for line in getattr(layout, lines)
    ]
    every = [every[n] for n in rng.permutation(len(every))]
    room = [int((stretch.strip.length_m - 2.0 * end_m) / least_m) for stretch, _ in every]
    dealt: list[list[str]] = [[] for _ in every]
    waiting = list(kinds)
    while waiting and any(len(own) < most for own, most in zip(dealt, room, strict=True)):
        for own, most in zip(dealt, room, strict=True):
            if waiting and len(own) < most:
                own.append(waiting.pop())
    for (stretch, line), own in zip(every, dealt, strict=True):
        half = 0.5 * stretch.strip.length_m - end_m
        axes = stretch.axes(0.0 if line.forward else np.pi)
        first, last = (stretch.point(along if line.forward else -along, line.left_m) for along in (-half, half))
        length = length_of(last - first)
        (x, y, z), (a, b, c) = first.tolist(), ((last - first) / length).tolist()
        course = Course((x, y, z), (a, b, c), length, float(rng.uniform(*speeds)))
        for kind, at_m in zip(own, spaced(len(own), length, least_m, rng).tolist(), strict=True):
            stature = float(rng.uniform(*STATURE_M)) if kind == "pedestrians" else 0.0
            yield Arranged(kind, _model(kind, rng), course.place(at_m), axes, (course, at_m), stature)


def _model(kind: str, rng: np.random.Generator) -> str:
    if kind in CHOICES:
        names, shares = CHOICES[kind]
        return str(rng.choice(names, p=shares))
    one = {"trucks": "truck", "buses": "bus", "cyclists": "cyclist", "pedestrians": "pedestrian"}
    return (one | {"bins": "bin", "benches": "bench"})[kind]


def _parked(
    roads: Sequence[tuple[Stretch, Layout]], ground: Ground, share: float, rng: np.random.Generator
) -> Iterator[Arranged]:
    """Cars in that share of the slots along the kerbs, each a little off its line."""
    for stretch, layout in roads:
        slots = int((stretch.strip.length_m - 2.0 * END_M) / SLOT_M)
        for line in layout.parking:
            taken = rng.permutation(slots)[: round(share * slots)]
            for slot in np.sort(taken).tolist():
                along = (slot - 0.5 * (slots - 1)) * SLOT_M + rng.uniform(-0.3, 0.3)
                turn = np.radians(rng.uniform(-1.5, 1.5)) + (0.0 if line.forward else np.pi)
                what = _model("cars", rng)
                left = line.left_m + rng.uniform(-0.06, 0.06)
                placement = standing(stretch, ground, "parked", what, along, left, float(turn))
                if placement is not None:
                    yield placement


def _furniture(
    roads: Sequence[tuple[Stretch, Layout]], ground: Ground, asked: Asked, rng: np.random.Generator
) -> Iterator[Arranged]:
    """Poles, signs, bins and benches behind the kerbs, at places drawn without putting one back."""
    spots = [
        (number, side, along)
        for number, (stretch, layout) in enumerate(roads)
        if layout.kerb_m + FURNITURE_M < stretch.strip.half_width_m
        for side in (-1.0, 1.0)
        for along in np.arange(2.0 - 0.5 * stretch.strip.length_m, 0.5 * stretch.strip.length_m - 2.0, 2.5).tolist()
    ]
    free = [spots[n] for n in rng.permutation(len(spots))]
    for kind in ("poles", "signs", "bins", "benches"):
        found = 0
        while found < asked.counts.get(kind, 0) and free:
            number, side, along = free.pop()
            stretch, layout = roads[number]
            what = _model(kind, rng)
            turn = 0.0 if (side > 0.0) == (what in OVER_THE_ROAD) else np.pi
            left = side * (layout.kerb_m + FURNITURE_M)
            placement = standing(stretch, ground, kind, what, along, left, turn)
            if placement is not None:
                found += 1
                yield placement


def standing(
    stretch: Stretch, ground: Ground, kind: str, what: str, along: float, left: float, turn_rad: float
) -> Arranged | None:
    """An asset on the ground under it; None where that is no plane, or no ground."""
    x, y, _ = stretch.point(along, left).tolist()
    heading = stretch.strip.heading_rad + turn_rad
    foot = asset(what).foot
    length, width = np.maximum(foot, ground.cell_m).tolist()
    plane = plane_under(ground, Strip((x, y), heading, length, 0.5 * width), (3, 3), UNEVEN_M)
    if plane is None:
        return None
    level, rise, tilt = plane
    upright = max(foot) < 1.0  # a post stands plumb on a slope
    return Arranged(kind, what, (x, y, level), tilted(heading, 0.0, 0.0) if upright else tilted(heading, rise, tilt))
