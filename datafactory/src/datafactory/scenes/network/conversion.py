"""OpenDRIVE and OpenStreetMap to lanes, and traffic on them, by SUMO (Eclipse, DLR), an optional installation.

netconvert evaluates reference lines, lane widths, elevation and links, and says where lanes meet. Its network is read
with sumolib. Nothing else of a road network is decided here. SUMO drives the traffic, with its right of way, lights and
car following (Krauss), from seeded trips.
"""

from __future__ import annotations

import math
import subprocess
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import numpy as np

from datafactory.scenes.city.rules import Rules
from datafactory.scenes.city.site import Keyframe
from datafactory.scenes.motion import Real
from datafactory.scenes.network.speed_limits import CURVE_STEP_M, limited
from shared.physics.errors import InputError

INSTALL = "pip install 'sparseradar-datafactory[opendrive]'"
READ = {
    # Not with --opendrive.internal-shapes: of the 225 ways over Town07's junctions 30 began half a lane beside theirs.
    # Without turnarounds: at a road's end vehicles would turn on the spot.
    "opendrive": ["--opendrive-files", "{path}", "--offset.disable-normalization",
                  "--opendrive.curve-resolution", str(CURVE_STEP_M), "--no-turnarounds"],
    "osm": ["--osm-files", "{path}", "--keep-edges.by-vclass", "passenger", "--ramps.guess", "--junctions.join",
            "--no-turnarounds"],
}  # fmt: skip
WANTED = {"opendrive": "an OpenDRIVE file (.xodr) with roads", "osm": "an OpenStreetMap extract (.osm) with streets"}


WARM_UP_S = 60.0
"""Before the scene's time 0: the network fills."""
DURATION_S = 24.0
"""Of the traffic in the file, from time 0 on."""
STEP_S = 0.1
METRES_A_VEHICLE = 60.0
"""Of lane, for each vehicle that sets out."""
CARS = ("Saloon", "Hatchback", "Van")
LENGTHS_M = {"Saloon": 4.6, "Hatchback": 4.0, "Van": 5.0, "Lorry": 9.0, "Bus": 11.5}
CLASSES = {"Lorry": "truck", "Bus": "bus"}
"""SUMO's, of what is no passenger car."""
STRAIGHT_M = 5e-4
"""A keyframe that lies within this of the line between its neighbours is left out."""


@dataclass(frozen=True, eq=False)
class Lane:
    """A lane that cars drive on.

    :param points: [n, 3] its centre line in the direction of travel [m], in the network's coordinates
    :param width: [m]
    :param outermost: whether nothing lies to its right
    :param junction: whether it leads over a junction
    """

    points: Real
    width: float
    outermost: bool
    junction: bool


@dataclass(frozen=True, eq=False)
class Network:
    """The lanes of a road network.

    :param source: the file
    :param file: SUMO's own form of it, for the traffic
    :param lanes: those between junctions and those over them
    :param junctions: [m, 2] outlines of the areas where lanes meet
    :param speeds: of the edges between junctions, by name [m/s]
    """

    source: Path
    file: Path
    lanes: tuple[Lane, ...]
    junctions: tuple[Real, ...]
    speeds: dict[str, float]

    def centre(self) -> tuple[float, float]:
        """Middle of all lanes (x, y) [m]."""
        every = np.concatenate([lane.points for lane in self.lanes])
        x, y = 0.5 * (every[:, :2].min(axis=0) + every[:, :2].max(axis=0))
        return float(x), float(y)


def sumo_tools() -> tuple[Path, ModuleType]:
    """The folder of SUMO's programs, and sumolib.

    :raises InputError: they are not installed
    """
    try:
        import shapely  # noqa: F401  the surfaces' library, which comes with the same extra
        import sumo
        import sumolib
    except ImportError as error:
        raise InputError("city", f"the package {error.name} is not installed", INSTALL) from None
    return Path(sumo.SUMO_HOME) / "bin", sumolib


def _run(command: list[str], made: Path, source: Path, expected: str) -> None:
    """Run one of SUMO's programs.

    :raises InputError: it did not make what it should
    """
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode or not made.is_file():
        said = [line.strip() for line in done.stderr.splitlines() if line.startswith("Error")]
        raise InputError(source, f"{Path(command[0]).name}: {said[0] if said else 'it says nothing'}", expected)


def read_network(path: Path, form: str, folder: Path) -> Network:
    """Convert a file and read its lanes.

    :param form: ``"opendrive"`` or ``"osm"``
    :param folder: where SUMO's form of it is written
    :raises InputError: no such file, no such form, no lanes that cars drive on, or SUMO is not installed
    """
    programs, sumolib = sumo_tools()
    if not path.is_file():
        raise InputError(path, "no such file", WANTED[form])
    target = folder / "network.net.xml"
    read = limited(path, folder) if form == "opendrive" else path
    arguments = [part.format(path=read) for part in READ[form]]
    command = [str(programs / "netconvert"), *arguments, "-o", str(target), "--precision", "4", "--no-warnings"]
    _run(command, target, path, WANTED[form])
    net = sumolib.net.readNet(str(target), withInternal=True)
    lanes, speeds = [], {}
    for edge in net.getEdges(withInternal=True):
        if not edge.allows("passenger"):
            continue
        junction = edge.getFunction() == "internal"
        if not junction:
            speeds[edge.getID()] = float(edge.getSpeed())
        for index, lane in enumerate(edge.getLanes()):
            points = np.array(lane.getShape3D(), dtype=np.float64)
            if len(points) >= 2 and np.isfinite(points).all():
                lanes.append(Lane(points, float(lane.getWidth()), index == 0, junction))
    if not speeds:
        raise InputError(path, "no lane that cars drive on", WANTED[form])
    outlines = [np.array(node.getShape(), dtype=np.float64) for node in net.getNodes()]
    junctions = tuple(outline for outline in outlines if len(outline) >= 3)
    return Network(path, target, tuple(lanes), junctions, speeds)


def along(points: Real, step_m: float) -> tuple[Real, Real]:
    """Places on a polyline every ``step_m``, [k, 3], and the headings there [k] [degree]."""
    steps = np.hypot(*np.diff(points[:, :2], axis=0).T)
    points = points[np.concatenate([[True], steps > 1e-6])]
    delta = np.diff(points, axis=0)
    ends = np.concatenate([[0.0], np.cumsum(np.hypot(*delta[:, :2].T))])
    at = np.arange(0.5 * step_m, ends[-1], step_m)
    places = np.stack([np.interp(at, ends, points[:, axis]) for axis in range(3)], axis=1)
    x, y, _ = delta[np.searchsorted(ends, at, side="right") - 1].T
    return places, np.degrees(np.arctan2(y, x))


def trajectories(
    network: Network, rules: Rules, rng: np.random.Generator, folder: Path, origin: tuple[float, float]
) -> list[tuple[str, list[Keyframe]]]:
    """(model, keyframes) of every vehicle that drives all the time from 0 to DURATION_S.

    Vehicles that set out or arrive meanwhile are left out: nothing appears or vanishes in a scene.

    :param rng: draws the trips, and the seed of SUMO
    :param origin: the world's, in the network's coordinates [m]
    :raises InputError: SUMO fails on this network
    """
    programs, _ = sumo_tools()
    _write_trips(network, rules, rng, folder / "trips.xml")
    command = [
        str(programs / "sumo"), "-n", str(network.file), "-r", str(folder / "trips.xml"),
        "--step-length", str(STEP_S), "--begin", "0", "--end", str(WARM_UP_S + DURATION_S + STEP_S),
        "--fcd-output", str(folder / "driven.xml"), "--device.fcd.begin", str(WARM_UP_S), "--precision", "4",
        "--seed", str(int(rng.integers(2**31 - 1))), "--lanechange.duration", "3", "--time-to-teleport", "-1",
        "--ignore-route-errors", "--no-step-log", "--no-warnings", "--xml-validation", "never",
    ]  # fmt: skip
    _run(command, folder / "driven.xml", network.source, "a network that cars can drive")
    driven: dict[str, tuple[str, list[Keyframe]]] = {}
    count = 0
    for _, step in ElementTree.iterparse(folder / "driven.xml"):
        if step.tag != "timestep":
            continue
        time_s = round(float(step.attrib["time"]) - WARM_UP_S, 3)
        if not 0.0 <= time_s <= DURATION_S:
            continue
        count += 1
        for vehicle in step:
            model, keys = driven.setdefault(vehicle.attrib["id"], (vehicle.attrib["type"], []))
            keys.append(_keyframe(vehicle.attrib, time_s, LENGTHS_M[model], origin, keys[-1] if keys else None))
        step.clear()
    return [(model, thinned(keys)) for model, keys in driven.values() if len(keys) == count]


def _keyframe(
    state: dict[str, str], time_s: float, length: float, origin: tuple[float, float], before: Keyframe | None
) -> Keyframe:
    """SUMO gives the middle of the front bumper, the slope there, and the heading clockwise from north."""
    yaw = 90.0 - float(state["angle"])
    x = float(state["x"]) - 0.5 * length * math.cos(math.radians(yaw)) - origin[0]
    y = float(state["y"]) - 0.5 * length * math.sin(math.radians(yaw)) - origin[1]
    z = float(state.get("z", 0.0)) - 0.5 * length * math.tan(math.radians(float(state.get("slope", 0.0))))
    if before is not None:
        yaw += 360.0 * round((before.yaw_deg - yaw) / 360.0)
    return Keyframe(time_s, (round(x, 3), round(y, 3), round(z, 3)), round(yaw, 1))


def _write_trips(network: Network, rules: Rules, rng: np.random.Generator, path: Path) -> None:
    """Trips from any edge to any other, over the warm-up; those without a way are left out by SUMO."""
    root = ElementTree.Element("routes")
    for model, length in LENGTHS_M.items():
        ElementTree.SubElement(
            root, "vType", id=model, length=str(length), vClass=CLASSES.get(model, "passenger"),
            speedFactor="1", speedDev="0.1",
        )  # fmt: skip
    edges = sorted(network.speeds)
    lanes = [lane.points for lane in network.lanes if not lane.junction]
    metres = sum(float(np.linalg.norm(np.diff(points[:, :2], axis=0), axis=1).sum()) for points in lanes)
    departs = np.sort(rng.uniform(0.0, WARM_UP_S, int(metres / METRES_A_VEHICLE)))
    for number, depart in enumerate(departs):
        first, last = (edges[int(index)] for index in rng.integers(len(edges), size=2))
        heavy = rng.random() < rules.heavy
        model = ("Lorry" if rng.random() < 0.6 else "Bus") if heavy else CARS[int(rng.integers(len(CARS)))]
        trip = {"from": first, "to": last, "departSpeed": "avg", "departPos": "random_free"}
        ElementTree.SubElement(root, "trip", id=str(number), type=model, depart=f"{depart:.2f}", attrib=trip)
    ElementTree.ElementTree(root).write(path)


def thinned(keys: list[Keyframe]) -> list[Keyframe]:
    """The keyframes without those that lie on the lines between the others."""
    kept, first = keys[:1], 0
    for last in range(2, len(keys)):
        if not all(_between(keys[first], key, keys[last]) for key in keys[first + 1 : last]):
            kept.append(keys[last - 1])
            first = last - 1
    return [*kept, keys[-1]]


def _between(before: Keyframe, key: Keyframe, after: Keyframe) -> bool:
    share = (key.time_s - before.time_s) / (after.time_s - before.time_s)
    places = zip(before.position, key.position, after.position, strict=True)
    off = max(abs(start + share * (end - start) - here) for start, here, end in places)
    turned = abs(before.yaw_deg + share * (after.yaw_deg - before.yaw_deg) - key.yaw_deg)
    return off <= STRAIGHT_M and turned <= 0.01
