"""Speed limits of OpenDRIVE's roads and bends, written into their lanes: netconvert reads those of lanes alone.

SUMO drives a road at its limit, whatever its bends: on Town07 14 m/s where the radius is 6 m.
"""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from datafactory.scenes.drives import LATERAL_MPS2
from shared.physics.errors import InputError

CURVE_STEP_M = 1.0
"""Between the points of a curve: an arc of 10 m radius is off by 1.3 cm at most."""
UNITS_MPS = {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704}
"""Of OpenDRIVE's speed limits; m/s where none is stated."""
USUAL_MPS, UNLIMITED_MPS = 13.89, 39.44
"""netconvert's own: where no limit is stated, and where a file says that there is none (--osm.speedlimit-none)."""


def _limit_mps(limits: ElementTree.Element | None) -> float:
    """What an OpenDRIVE ``<speed>`` states; any other text than a positive number, as "undefined", is no statement."""
    stated = {} if limits is None else limits.attrib
    if stated.get("max") == "no limit":
        return UNLIMITED_MPS
    try:
        limit = float(stated.get("max", "nan")) * UNITS_MPS[stated.get("unit", "m/s")]
    except (ValueError, KeyError):
        return USUAL_MPS
    return limit if 0.0 < limit < math.inf else USUAL_MPS


def _curvature(geometry: ElementTree.Element) -> float:
    """The largest of a piece of a reference line [1/m]; 0 of a straight one, and of a kind that is not known."""
    shape = geometry[0]  # behind it there may be data of the file's maker
    stated = {name: float(value) for name, value in shape.attrib.items() if name != "pRange"}
    if shape.tag in ("poly3", "paramPoly3"):
        last = 1.0 if shape.get("pRange") == "normalized" else float(geometry.get("length", 0.0))
        u = np.array([stated.get(f"{c}U", float(c == "b")) for c in "abcd"])
        v = np.array([stated.get(f"{c}V", stated.get(c, 0.0)) for c in "abcd"])
        p = np.linspace(0.0, last, 9)
        (u1, u2), (v1, v2) = ([np.polynomial.Polynomial(line).deriv(order)(p) for order in (1, 2)] for line in (u, v))
        return float(np.max(np.abs(u1 * v2 - v1 * u2) / np.maximum(np.hypot(u1, v1), 1e-9) ** 3))
    return max(abs(stated.get(name, 0.0)) for name in ("curvature", "curvStart", "curvEnd"))


def _bends(road: ElementTree.Element) -> list[tuple[float, float, float]]:
    """(from, to, speed that :data:`LATERAL_MPS2` allows) of the pieces of a road that are not straight [m, m, m/s]."""
    found = []
    for geometry in road.iterfind("planView/geometry"):
        start, curvature = float(geometry.get("s", 0.0)), _curvature(geometry)
        if curvature > 0.0:
            found.append((start, start + float(geometry.get("length", 0.0)), math.sqrt(LATERAL_MPS2 / curvature)))
    return found


def limited(path: Path, folder: Path) -> Path:
    """An OpenDRIVE file whose lanes state the speed limits of their roads and bends.

    A road's limit holds from its ``s`` on to the next one's, in each lane as far as the lane's own first limit; in a
    bend none allows more than :data:`LATERAL_MPS2` across. Limits change CURVE_STEP_M from a lane section's ends and
    from each other at least: netconvert cuts roads where they do.

    :param folder: where it is written
    :return: ``path`` where netconvert is to say what is wrong with the file
    :raises InputError: traffic that keeps left, which netconvert would drive against its lanes
    """
    try:
        root = ElementTree.parse(path).getroot()
        for item in root.iter():  # without a namespace, which ElementTree would write as a prefix
            item.tag = item.tag.rpartition("}")[2]
        left = [road.get("id", "") for road in root.iter("road") if road.get("rule") == "LHT"]
        for road in root.iter("road"):
            _limit_lanes(road)
    except (OSError, SyntaxError, ValueError, LookupError):
        return path
    if left:
        raise InputError(path, f"road {left[0]!r} has rule LHT", "traffic that keeps right, which alone is simulated")
    ElementTree.ElementTree(root).write(folder / "limited.xodr", encoding="utf-8", xml_declaration=True)
    return folder / "limited.xodr"


def _limit_lanes(road: ElementTree.Element) -> None:
    """:raises ValueError: a length that is no number"""
    stated = sorted((float(item.get("s", 0.0)), _limit_mps(item.find("speed"))) for item in road.findall("type"))
    bends = _bends(road)
    sections = list(road.iter("laneSection"))
    starts = [float(section.get("s", 0.0)) for section in sections]
    for section, start, end in zip(sections, starts, [*starts[1:], float(road.get("length", 0.0))], strict=True):
        for lane in section.iter("lane"):
            own = [(start + float(item.get("sOffset", 0.0)), _limit_mps(item)) for item in lane.findall("speed")]
            limits = [(-math.inf, USUAL_MPS), *(one for one in stated if one[0] < min(own, default=(math.inf,))[0])]
            limits += sorted(own)
            marks = [start]
            for mark in sorted({s for s, _ in limits} | {edge for bend in bends for edge in bend[:2]}):
                if marks[-1] + CURVE_STEP_M <= mark < end - CURVE_STEP_M:
                    marks.append(mark)
            for item in lane.findall("speed"):
                lane.remove(item)
            before = None
            for mark, following in pairwise([*marks, end]):
                limit = [mps for s, mps in limits if s < mark + CURVE_STEP_M][-1]
                limit = min([limit, *(mps for a, b, mps in bends if a < following and b > mark)])
                if limit != before:
                    ElementTree.SubElement(lane, "speed", sOffset=repr(mark - start), max=repr(limit))
                before = limit
