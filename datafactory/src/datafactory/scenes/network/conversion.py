"""OpenDRIVE and OpenStreetMap to lanes, by SUMO's netconvert (Eclipse, DLR), an optional installation.

netconvert evaluates reference lines, lane widths, elevation and links, and says where lanes meet. Its network is read
with sumolib. Nothing else of a road network is decided here.
"""

from __future__ import annotations

import math
import subprocess
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from shared.physics.errors import InputError

Real = NDArray[np.float64]

INSTALL = "pip install 'sparseradar-datafactory[opendrive]'"
CURVE_STEP_M = 1.0
"""Between the points of a curve: an arc of 10 m radius is off by 1.3 cm at most."""
READ = {
    "opendrive": ["--opendrive-files", "{path}", "--offset.disable-normalization", "--opendrive.internal-shapes",
                  "--opendrive.curve-resolution", str(CURVE_STEP_M)],
    "osm": ["--osm-files", "{path}", "--keep-edges.by-vclass", "passenger", "--ramps.guess", "--junctions.join"],
}  # fmt: skip
WANTED = {"opendrive": "an OpenDRIVE file (.xodr) with roads", "osm": "an OpenStreetMap extract (.osm) with streets"}


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
    arguments = [part.format(path=path) for part in READ[form]]
    command = [str(programs / "netconvert"), *arguments, "-o", str(target), "--precision", "4", "--no-warnings"]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode or not target.is_file():
        said = [line.strip() for line in done.stderr.splitlines() if line.startswith("Error")]
        raise InputError(path, f"netconvert: {said[0] if said else 'it says nothing'}", WANTED[form])
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
    steps = np.linalg.norm(np.diff(points[:, :2], axis=0), axis=1)
    keep = np.concatenate([[True], steps > 1e-6])
    points = points[keep]
    if len(points) < 2:
        return np.zeros((0, 3)), np.zeros(0)
    steps = np.linalg.norm(np.diff(points[:, :2], axis=0), axis=1)
    ends = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.arange(0.5 * step_m, ends[-1], step_m)
    piece = np.clip(np.searchsorted(ends, at, side="right") - 1, 0, len(steps) - 1)
    share = ((at - ends[piece]) / steps[piece])[:, None]
    places = points[piece] + share * (points[piece + 1] - points[piece])
    delta = points[piece + 1] - points[piece]
    headings = np.array([math.degrees(math.atan2(y, x)) for x, y in delta[:, :2]])
    return places, headings
