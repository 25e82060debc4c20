"""Populated scenes by their meshes and over time: nothing in anything else, lanes kept, distances kept."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from prepared_scenes import STREET
from scene_solids import PopulationSolids, Thing, city_solids
from solids import Shape, Standing, containing, intersecting
from town_scenes import two_blocks

from datafactory.frame.deal import Deal
from datafactory.scenes.boxes import CLEAR_M, Movers
from datafactory.scenes.city.city import city
from datafactory.scenes.city.rules import Style
from datafactory.scenes.city.usd import write_usd
from datafactory.scenes.drives import Drives, draw_drive
from datafactory.scenes.ground import sensor_ground
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from datafactory.scenes.things import Population
from datafactory.scenes.traffic.arrange import parse_populate
from datafactory.scenes.traffic.population import populated
from datafactory.scenes.traffic.stretches import HORIZON_S

ASKED = parse_populate("cars=8,trucks=2,buses=1,cyclists=4,pedestrians=12,poles=12,signs=6,bins=3,benches=2,parked=0.6")
EVERYWHERE = {"poles": 12, "pedestrians": 12, "cyclists": 4}
"""Of these, what a city of any style has room for: all."""
DRIVE_S = np.arange(0.0, 12.0, 0.5)
"""Times of a long drive. Everything of one stream has one speed."""
WHOLE_S = np.linspace(0.0, HORIZON_S - 0.01, 61)
LATER_S = (60.0, 133.3, 377.7, 599.0)
VEHICLES = ("car", "truck", "bus")
CANYON = "sionna:simple_street_canyon"
SLOW = [style for style in Style if style is not Style.OLD_TOWN]
"""All styles are populated alike: what one shows, the others seldom break."""
SEEDS = range(2)
TWO_SECONDS = Drives(seconds=2.0, rate_hz=5.0)
LANE_M = 3.5
"""From the middle of a road of two lanes to the outer end of either."""
NARROWEST_KERB_M = 2.4
OPEN_M = 1.0
"""So far the boresight is open: further than anything that would blind the radar."""


@dataclass(frozen=True, eq=False)
class Populated:
    """A populated scene, the solids of what was put into it, and those of what stood there before."""

    scene: Scene
    population: Population
    solids: PopulationSolids
    walls: list[Standing]

    @staticmethod
    def of(bare: Scene, walls: list[Standing], seed: int) -> Populated:
        scene = populated(bare, ASKED, seed)
        assert scene.population is not None
        return Populated(scene, scene.population, PopulationSolids(scene), walls)

    @property
    def moving(self) -> list[Thing]:
        return [thing for thing in self.solids.things if thing.moves]

    def standing(self, time_s: float) -> list[Standing]:
        return [*self.walls, *self.solids.at(time_s)]


def street_solids(street: Scene) -> list[Standing]:
    """What stands still on the shipped street; test_populate.py says that its own traffic has its way."""
    parts: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    for item in street.objects:
        if not item.moves and not item.name.startswith("/World/Ground/"):
            parts.setdefault(item.name.partition("/Geometry")[0], []).append((item.vertices, item.triangles))
    return [Standing(name, Shape.around(meshes)) for name, meshes in parts.items()]


def bare_scene(which: str, folder: Path) -> tuple[Scene, list[Standing]]:
    """A scene without traffic, and the solids in it: of a city the parked cars too."""
    if which == "street":
        bare = open_scene(str(STREET))
        return bare, street_solids(bare)
    if which in ("hill", CANYON):
        bare = two_blocks() if which == "hill" else open_scene(which)
        houses = [item for item in bare.objects if item.name not in ("ground", "mesh-floor")]
        return bare, [Standing(item.name, Shape.around([(item.vertices, item.triangles)])) for item in houses]
    standing = city(seed=0, blocks=2, style=Style(which))
    write_usd(folder / "city.usdc", standing, "what stands")
    return open_scene(str(folder / "city.usdc")), city_solids(standing)


@pytest.mark.parametrize(
    "which",
    ["hill", "street", CANYON, Style.OLD_TOWN, *(pytest.param(style, marks=pytest.mark.slow) for style in SLOW)],
)
def test_populated_scenes_are_sound_at_all_times(which: str, tmp_path: Path) -> None:
    bare, walls = bare_scene(which, tmp_path)
    for seed in SEEDS:
        item = Populated.of(bare, walls, seed)
        assert len(item.solids.things) > 30
        if which in list(Style):  # every style has room
            placed = item.population.placed
            assert placed["cars"] + placed["trucks"] >= 2
            assert {kind: placed[kind] for kind in EVERYWHERE} == EVERYWHERE
        nothing_is_in_anything_else(item)
        sensors_are_within_nothing(item)
        lanes_are_kept(item)
        assert nobody_catches_up_with_anybody(item) > 0


def nothing_is_in_anything_else(item: Populated) -> None:
    assert intersecting(item.standing(0.0)) == []
    for time_s in (*DRIVE_S, *LATER_S):
        assert intersecting(item.standing(time_s), moving_only=True) == [], (item.population.seed, time_s)


def sensors_are_within_nothing(item: Populated) -> None:
    """Poses drawn with a time each, and a drive of ten poses, against everything as it stands at that time."""
    ground = sensor_ground(item.scene)
    deal = Deal(seed=3, scenes=1, frames=16, grounds=(ground,), traffic=(Movers(item.scene),))
    drawn = [deal.frame(number).where for number in range(16)]
    assert len({pose.time_s for pose in drawn}) == 16
    assert all(0.0 <= pose.time_s < HORIZON_S for pose in drawn)
    assert Movers(item.scene).clear_of(drawn, CLEAR_M)
    drive = draw_drive(ground, Movers(item.scene), "train", TWO_SECONDS, np.random.default_rng(4))
    assert len(drive) == 10
    for pose in (*drawn, *drive):
        standing, ahead = item.standing(pose.time_s), pose.rotation()[:, 0]
        for metres in np.linspace(0.0, OPEN_M, 5):
            assert containing(standing, np.asarray(pose.position) + metres * ahead) == [], pose


def of_its_road(population: Population, thing: Thing, time_s: float) -> tuple[float, float, float]:
    """How far to the left of its road's middle a thing is [m], and its velocity along the road and to its left."""
    place, velocity = thing.at(time_s)
    (road,) = [road for road in population.roads if road.holds(place[0], place[1])]
    _, left = road.coordinates(place[0], place[1])
    cosine, sine = np.cos(road.heading_rad), np.sin(road.heading_rad)
    return float(left), cosine * velocity[0] + sine * velocity[1], cosine * velocity[1] - sine * velocity[0]


def lanes_are_kept(item: Populated) -> None:
    """Who moves stays on its own line across the road, all of it on its own side, with one speed, straight ahead."""
    for thing in item.moving:
        left, ahead, aside = np.transpose([of_its_road(item.population, thing, time_s) for time_s in WHOLE_S])
        assert np.ptp(left) < 0.01, thing.name
        assert np.ptp(ahead) < 1e-6, thing.name
        assert np.abs(aside).max() < 1e-6, thing.name
        speed = thing.at(12.0)[1]
        assert thing.axes[0] @ speed == pytest.approx(np.linalg.norm(speed), rel=1e-6)  # it looks where it goes
        near, far = abs(left[0]) - 0.5 * thing.size_m[1], abs(left[0]) + 0.5 * thing.size_m[1]
        if thing.label == "pedestrian":
            assert near > NARROWEST_KERB_M, thing.name
            continue
        if abs(left[0]) > 0.1:  # else the road has one lane, in its middle
            assert near > 0.0, thing.name
            assert left[0] * ahead[0] < 0.0 or thing.label == "bicycle", thing.name
        if thing.label in VEHICLES:
            assert far < LANE_M, thing.name
            assert 8.0 <= abs(ahead[0]) <= 14.0, thing.name


def nobody_catches_up_with_anybody(item: Populated) -> int:
    """Who shares a line keeps its distance, round the line's end too; how many lines are shared."""
    lines: dict[tuple[int, float], list[Thing]] = {}
    for thing in item.moving:
        x, y = thing.at(0.0)[0][:2, None]
        (number,) = [n for n, road in enumerate(item.population.roads) if road.holds(x, y)]
        left = float(item.population.roads[number].coordinates(x, y)[1][0])
        lines.setdefault((number, round(left, 1)), []).append(thing)
    shared = [line for line in lines.values() if len(line) > 1]
    for line in shared:
        longest = max(thing.size_m[0] for thing in line)
        for time_s in WHOLE_S:
            places = np.array([thing.at(time_s)[0] for thing in line])
            apart = np.linalg.norm(places[:, None] - places[None], axis=-1)[np.triu_indices(len(line), 1)]
            assert apart.min() > longest, (line[0].name, time_s)
    return len(shared)
