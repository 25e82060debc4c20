"""Speed limits of OpenDRIVE's roads, written into their lanes: netconvert reads those of lanes alone."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

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


def limited(path: Path, folder: Path) -> Path:
    """An OpenDRIVE file whose lanes state the speed limits of their roads: netconvert reads those of lanes alone.

    A road's limit holds from its ``s`` on to the next one's, in each lane as far as the lane's own first limit. One
    that begins within CURVE_STEP_M of a lane section's ends begins there: netconvert cuts roads where limits change.

    :param folder: where it is written
    :return: ``path`` where no road has a limit, or where netconvert is to say what is wrong with the file
    :raises InputError: traffic that keeps left, which netconvert would drive against its lanes
    """
    try:
        root = ElementTree.parse(path).getroot()
        for item in root.iter():  # without a namespace, which ElementTree would write as a prefix
            item.tag = item.tag.rpartition("}")[2]
        left = [road.get("id", "") for road in root.iter("road") if road.get("rule") == "LHT"]
        roads = [road for road in root.iter("road") if road.find("type/speed") is not None]
        for road in roads:
            _limit_lanes(road)
    except (OSError, SyntaxError, ValueError, LookupError):
        return path
    if left:
        raise InputError(path, f"road {left[0]!r} has rule LHT", "traffic that keeps right, which alone is simulated")
    if not roads:
        return path
    ElementTree.ElementTree(root).write(folder / "limited.xodr", encoding="utf-8", xml_declaration=True)
    return folder / "limited.xodr"


def _limit_lanes(road: ElementTree.Element) -> None:
    """:raises ValueError: a length that is no number"""
    stated = sorted((float(item.get("s", 0.0)), _limit_mps(item.find("speed"))) for item in road.findall("type"))
    changes = [here for before, here in pairwise([(0.0, 0.0), *stated]) if here[1] != before[1]]
    sections = list(road.iter("laneSection"))
    starts = [float(section.get("s", 0.0)) for section in sections]
    for section, start, end in zip(sections, starts, [*starts[1:], float(road.get("length", 0.0))], strict=True):
        near = start + CURVE_STEP_M
        # Of those that begin before the section the last one holds.
        limits = {0.0 if s < near else s - start: mps for s, mps in changes if s < max(near, end - CURVE_STEP_M)}
        for lane in section.iter("lane"):
            own = min((float(item.get("sOffset", 0.0)) for item in lane.findall("speed")), default=math.inf)
            for offset, mps in limits.items():
                if offset < own:
                    ElementTree.SubElement(lane, "speed", sOffset=repr(offset), max=repr(mps))
