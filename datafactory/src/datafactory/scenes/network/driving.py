"""Traffic on a network: SUMO drives it, with its right of way, lights and car following (Krauss), from seeded trips."""

from __future__ import annotations

import math
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from datafactory.scenes.city.rules import Rules
from datafactory.scenes.city.site import Keyframe
from datafactory.scenes.network.conversion import Network, sumo_tools
from shared.physics.errors import InputError

WARM_UP_S = 60.0
"""Before the scene's time 0: the network fills."""
DURATION_S = 24.0
"""Of the traffic in the file, from time 0 on."""
STEP_S = 0.5
METRES_A_VEHICLE = 60.0
"""Of lane, for each vehicle that sets out."""
CARS = ("Saloon", "Hatchback", "Van")
LENGTHS_M = {"Saloon": 4.6, "Hatchback": 4.0, "Van": 5.0, "Lorry": 9.0, "Bus": 11.5}
CLASSES = {"Lorry": "truck", "Bus": "bus"}
"""SUMO's, of what is no passenger car."""
STRAIGHT_M = 5e-4
"""A keyframe that lies within this of the line between its neighbours is left out."""


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
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode or not (folder / "driven.xml").is_file():
        said = [line for line in done.stderr.splitlines() if line.startswith("Error")]
        raise InputError(
            network.source, f"sumo: {said[0] if said else 'it says nothing'}", "a network that cars can drive"
        )
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
    """SUMO gives the middle of the front bumper, and the heading clockwise from north."""
    yaw = 90.0 - float(state["angle"])
    x = float(state["x"]) - 0.5 * length * math.cos(math.radians(yaw)) - origin[0]
    y = float(state["y"]) - 0.5 * length * math.sin(math.radians(yaw)) - origin[1]
    if before is not None:
        yaw += 360.0 * round((before.yaw_deg - yaw) / 360.0)
    return Keyframe(time_s, (round(x, 3), round(y, 3), round(float(state.get("z", 0.0)), 3)), round(yaw, 1))


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
