"""Road networks written by hand: an OpenDRIVE file of a line, an arc and a junction, and an OpenStreetMap one."""

import math

LINE_M, RADIUS_M, ARC_M, GRADE, LANE_M, OTHER_M = 60.0, 40.0, 40.0, 0.02, 3.5, 250.0
"""Road 1: a line along x from the origin, then an arc to the left, rising by GRADE; a lane to either side. The
other two roads are level lines of OTHER_M. The speed limit is 30 km/h."""


def _geometry(s: float, x: float, y: float, heading: float, length: float, curvature: float = 0.0) -> str:
    shape = f'<arc curvature="{curvature}"/>' if curvature else "<line/>"
    return f'<geometry s="{s}" x="{x}" y="{y}" hdg="{heading}" length="{length}">{shape}</geometry>'


def _lane(number: int, links: str = "") -> str:
    width = f'<width sOffset="0" a="{LANE_M}" b="0" c="0" d="0"/>'
    return f'<lane id="{number}" type="driving" level="false"><link>{links}</link>{width}</lane>'


def _road(
    number: int, length: float, geometry: str, link: str, lanes: str, junction: int = -1, grade: float = 0.0
) -> str:
    return (
        f'<road name="" length="{length}" id="{number}" junction="{junction}"><link>{link}</link>'
        f'<type s="0" type="town"><speed max="30" unit="km/h"/></type>'
        f'<planView>{geometry}</planView><elevationProfile><elevation s="0" a="0" b="{grade}" c="0" d="0"/>'
        f'</elevationProfile><lanes><laneSection s="0">{lanes}</laneSection></lanes></road>'
    )


BOTH = f'<left>{_lane(1)}</left><center><lane id="0" type="none" level="false"/></center><right>{_lane(-1)}</right>'
JOINED = '<predecessor elementType="junction" elementId="100"/>'


def _through(number: int, start: int, end: int, geometry: str, length: float) -> str:
    """A road over the junction, from the beginning of one road to that of another."""
    link = (
        f'<predecessor elementType="road" elementId="{start}" contactPoint="start"/>'
        f'<successor elementType="road" elementId="{end}" contactPoint="start"/>'
    )
    lane = _lane(-1, '<predecessor id="1"/><successor id="-1"/>')
    lanes = f'<center><lane id="0" type="none" level="false"/></center><right>{lane}</right>'
    return _road(number, length, geometry, link, lanes, junction=100)


def _connection(number: int, incoming: int, over: int) -> str:
    ends = f'incomingRoad="{incoming}" connectingRoad="{over}" contactPoint="start"'
    return f'<connection id="{number}" {ends}><laneLink from="1" to="-1"/></connection>'


def opendrive() -> str:
    """A T of three roads: 1 to the east (line and arc), 2 to the west, 3 to the south."""
    quarter = 0.5 * math.pi
    arc = _geometry(LINE_M, LINE_M, 0.0, 0.0, ARC_M, 1.0 / RADIUS_M)
    roads = [
        _road(1, LINE_M + ARC_M, _geometry(0, 0, 0, 0, LINE_M) + arc, JOINED, BOTH, grade=GRADE),
        _road(2, OTHER_M, _geometry(0, -20, 0, math.pi, OTHER_M), JOINED, BOTH),
        _road(3, OTHER_M, _geometry(0, -10, -10, -quarter, OTHER_M), JOINED, BOTH),
        _through(10, 2, 1, _geometry(0, -20, 0, 0, 20.0), 20.0),
        _through(11, 1, 2, _geometry(0, 0, 0, math.pi, 20.0), 20.0),
        _through(12, 2, 3, _geometry(0, -20, 0, 0, 10.0 * quarter, -0.1), 10.0 * quarter),
        _through(13, 3, 1, _geometry(0, -10, -10, quarter, 10.0 * quarter, -0.1), 10.0 * quarter),
    ]
    connections = "".join(_connection(i, *pair) for i, pair in enumerate([(2, 10), (1, 11), (2, 12), (3, 13)]))
    junction = f'<junction name="" id="100">{connections}</junction>'
    return f'<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="4"/>{"".join(roads)}{junction}</OpenDRIVE>'


OSM = """<?xml version="1.0" encoding="UTF-8"?>
<osm version="0.6">
  <node id="1" lat="48.1400" lon="11.5700"/>
  <node id="2" lat="48.1400" lon="11.5720"/>
  <node id="3" lat="48.1400" lon="11.5740"/>
  <node id="4" lat="48.1410" lon="11.5720"/>
  <node id="5" lat="48.1390" lon="11.5720"/>
  <way id="10"><nd ref="1"/><nd ref="2"/><nd ref="3"/><tag k="highway" v="secondary"/><tag k="lanes" v="2"/></way>
  <way id="11"><nd ref="4"/><nd ref="2"/><nd ref="5"/><tag k="highway" v="residential"/></way>
</osm>
"""
"""Two streets that cross: 297 m from west to east, 222 m from north to south."""
