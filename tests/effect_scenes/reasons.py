"""Which effects each effect scene calls for, and why: the content of ``expected.json``.

Figures hold for the first pose; the others stand within 1 m of it. Cross sections without a range are those that the
radar equation would say of an echo, so that echoes of one range compare at a glance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from effect_scenes import levels
from effect_scenes.verdicts import (
    ABSENT,
    BUDGET_DB,
    RULES,
    Echo,
    Expectation,
    Verdict,
    boresight,
    everything,
    motion,
    near_field,
    noise,
    nothing,
)

from datafactory.paths.facets import TAPER

CONVEX = nothing("one convex body has no second bounce")


def point(range_m: float, rcs_dbsm: float, speed_mps: float = 0.0) -> Expectation:
    """A point target alone, on boresight."""
    power = levels.point_dbw(range_m, rcs_dbsm)
    alone = nothing("there is no surface, only a point target in plain sight")
    verdicts = {
        **ABSENT,
        **motion(speed_mps),
        **dict.fromkeys(("specular", "diffuse", "multi_bounce", "diffraction", "corners"), alone),
        "near_field": near_field(range_m),
        "antenna_pattern": boresight(),
        "rcs_targets": everything(f"the only echo is a point target of {rcs_dbsm:g} dBsm"),
        "noise": noise(power),
    }
    return Expectation(verdicts, (Echo("point target, radar equation", range_m, power),))


def rough_patch(rough_dbsm: float, change_db: float) -> Verdict:
    """A rough surface beside a stronger echo."""
    return Verdict(change_db, f"the rough patch in one cell is {rough_dbsm:.1f} dBsm")


def mirror(range_m: float, mirror_dbsm: float, rough_dbsm: float, edge_dbsm: float, what: str) -> Expectation:
    """A facet square to the radar whose specular echo is all that counts."""
    power = levels.point_dbw(range_m, mirror_dbsm)
    verdicts = {
        **ABSENT,
        **motion(0.0),
        "specular": everything(f"the mirror's echo is {mirror_dbsm:.1f} dBsm: {what}"),
        "diffuse": rough_patch(rough_dbsm, rough_dbsm - mirror_dbsm),
        "multi_bounce": CONVEX,
        "diffraction": Verdict(edge_dbsm - mirror_dbsm, f"the strongest edge is {edge_dbsm:.1f} dBsm (Keller)"),
        "near_field": near_field(range_m, mirror=True),
        "antenna_pattern": boresight("the specular point lies"),
        "noise": noise(power),
    }
    return Expectation(verdicts, (Echo(f"specular, {what}", range_m, power),))


def cell_height_m(range_m: float) -> float:
    """Range cells on a wall square to the radar are rings: the first is a disc of radius sqrt(2 R dr) [m]."""
    return 2.0 * math.sqrt(2.0 * range_m * levels.RADAR.waveform.range_step_m)


def cell_across_m(turned_deg: float) -> float:
    """Width [m] of a range cell on an upright face that is turned away from square by this angle: dr / sin."""
    return levels.RADAR.waveform.range_step_m / math.sin(math.radians(turned_deg))


def wall() -> Expectation:
    mirror_dbsm = levels.plane_rcs_dbsm(60.0) + levels.mirror_db("concrete")
    rough = levels.diffuse_rcs_dbsm("concrete", cell_height_m(60.0) * levels.cell_width_m(60.0), 0.0)
    # The upper and lower edges, 5 m from the specular point: the line of sight is atan(5 / 60) off the face's normal.
    edge = levels.edge_rcs_dbsm(60.2, 1.5, 90.0 - 4.8, levels.normal_reflection("concrete"))
    return mirror(60.0, mirror_dbsm, rough, edge, "pi R^2 |Gamma|^2 (1 - S^2), far larger than the Fresnel zone")


def plate() -> Expectation:
    area = 0.2**2
    plate_dbsm = levels.plate_rcs_dbsm(area) + levels.mirror_db("metal")
    rough = levels.diffuse_rcs_dbsm("metal", area, 0.0)
    excess = levels.plane_rcs_dbsm(50.0) - levels.plate_rcs_dbsm(area)
    what = f"4 pi A^2 / lambda^2; an infinite plane has {excess:.1f} dB more"
    # The rims lie within the Fresnel zone: physical optics of the facet holds all of their wave but this share.
    angle = math.atan(0.1 / 50.0)
    zones = 2.0 * 50.0 * math.sin(angle) ** 2 / levels.WAVELENGTH_M
    left = 1.0 - math.exp(-zones / TAPER)
    rim = levels.edge_rcs_dbsm(50.0, 2.0, 90.0 - math.degrees(angle), -left) + levels.short_edge_db(0.2, 50.0)
    return mirror(50.0, plate_dbsm, rough, rim, what)


def dihedral() -> Expectation:
    """Two walls that open by 85 deg: the double bounce comes from R sin(5 deg) beside the edge, once each way round."""
    metal = 2.0 * levels.mirror_db("metal")
    one_way_round = levels.plane_rcs_dbsm(60.0) + metal
    # What one face mirrors onto the other all comes back from the range of the line where they meet: one cell holds a
    # strip of the face, 8 m high and a cell wide across the line of sight, once for each order of the two bounces.
    strip = levels.diffuse_rcs_dbsm("metal", 8.0 * levels.cell_width_m(60.0) / math.cos(math.radians(45.0)), 45.0)
    rough = strip + levels.mirror_db("metal") + 10.0 * math.log10(2.0)
    edge = levels.edge_rcs_dbsm(50.0, 2.0, 42.5, -1.0)
    power = levels.point_dbw(60.0 * math.cos(math.radians(5.0)), one_way_round)
    verdicts = {
        **ABSENT,
        **motion(0.0),
        "specular": everything("both bounces of the only strong echo are mirrors"),
        "diffuse": rough_patch(rough, rough - one_way_round),
        "multi_bounce": everything(
            f"no face looks at the radar; two bounces are {one_way_round:.1f} dBsm, once each way"
        ),
        "diffraction": Verdict(
            edge - one_way_round,
            f"the outer edges are {edge:.1f} dBsm (Keller); level rims, seen askew, more",
            True,
        ),
        "near_field": near_field(60.0, mirror=True),
        "antenna_pattern": boresight("the echoes come from", 7.0),
        "noise": noise(power),
    }
    return Expectation(
        verdicts, (Echo("two bounces, each way round, at u = +-0.087", 60.0 * math.cos(math.radians(5.0)), power),)
    )


def small_corner(
    corner_dbsm: float, bounces: int, rough_dbsm: float, rim: tuple[float, float], what: str
) -> Expectation:
    """A corner of metal sheets at 60 m, all of it in one resolution cell.

    :param rough_dbsm: of its faces, of which what the others mirror is as much again
    :param rim: length [m] of an outer edge that is met at a right angle, and its angle from the face [deg]
    """
    smooth_dbsm = corner_dbsm + bounces * levels.mirror_db("metal")
    twice = rough_dbsm + levels.mirror_db("metal") + 10.0 * math.log10(2.0)
    rim_dbsm = levels.edge_rcs_dbsm(60.0, 2.0, rim[1], -1.0) + levels.short_edge_db(rim[0], 60.0)
    power = levels.point_dbw(60.0, smooth_dbsm)
    verdicts = {
        **ABSENT,
        **motion(0.0),
        "specular": Verdict(twice - smooth_dbsm, f"what one face mirrors of another's roughness is {twice:.1f} dBsm"),
        "diffuse": Verdict(twice - smooth_dbsm, f"the rough faces are {rough_dbsm:.1f} dBsm, in the corner's own cell"),
        "multi_bounce": Verdict(twice - smooth_dbsm, "as for specular; the corner's own bounces count as corners"),
        "diffraction": Verdict(rim_dbsm - smooth_dbsm, f"its rims are {rim_dbsm:.1f} dBsm at most (Keller, Fresnel)"),
        "corners": everything(f"the only strong echo is the corner's, {smooth_dbsm:.1f} dBsm: {what}"),
        "near_field": near_field(60.0),
        "antenna_pattern": boresight(),
        "noise": noise(power),
    }
    return Expectation(verdicts, (Echo(f"corner, {what}", 60.167, power),))


def square_corner() -> Expectation:
    """Faces of 0.1 x 0.12 m, met at 45 deg: beyond 2 D^2 / lambda = 18 m the closed form holds."""
    corner_dbsm = 10.0 * math.log10(8.0 * math.pi * (0.1 * 0.12) ** 2 / levels.WAVELENGTH_M**2)
    rough = levels.diffuse_rcs_dbsm("metal", 2.0 * 0.1 * 0.12, 45.0)
    return small_corner(corner_dbsm, 2, rough, (0.12, 45.0), "8 pi a^2 b^2 / lambda^2")


def three_faces() -> Expectation:
    """Right-angled triangles with legs of 0.1 m, met 54.7 deg off their normals."""
    corner_dbsm = 10.0 * math.log10(4.0 * math.pi * 0.1**4 / (3.0 * levels.WAVELENGTH_M**2))
    rough = levels.diffuse_rcs_dbsm("metal", 3.0 * 0.5 * 0.1**2, 54.7)
    return small_corner(corner_dbsm, 3, rough, (0.1 * math.sqrt(2.0), 35.3), "4 pi a^4 / (3 lambda^2)")


def reflector_behind_pane() -> Expectation:
    through = 2.0 * levels.pane_db("glass", 30.0)
    mirror_dbsm = levels.plane_rcs_dbsm(80.0) + levels.mirror_db("metal") + through
    # Of the pane, whose nearer end stands at 71 m, a cell is dr / sin(30 deg) wide and all of 11 m high.
    pane = levels.diffuse_rcs_dbsm("glass", 11.0 * cell_across_m(30.0), 30.0) + 40.0 * math.log10(80.0 / 71.0)
    wall_behind = levels.diffuse_rcs_dbsm("metal", cell_height_m(80.0) * levels.cell_width_m(80.0), 0.0) + through
    edge = levels.edge_rcs_dbsm(80.2, 1.5, 90.0 - 3.6, 1.0) + through
    what = f"pi R^2 (1 - S^2), and {through:.1f} dB for the pane, out and back"
    expected = mirror(80.0, mirror_dbsm, max(pane, wall_behind), edge, what)
    verdicts = {
        **expected.verdicts,
        "refraction": everything("the only strong echo crosses the pane twice"),
        "multi_bounce": nothing("the pane, turned by 30 deg, mirrors nothing back; to cross it is no bounce"),
    }
    return Expectation(verdicts, expected.echoes)


def target_behind_pane() -> Expectation:
    through = 2.0 * levels.pane_db("acrylic", 30.0)
    power = levels.point_dbw(60.0, 26.51) + through
    rough = levels.diffuse_rcs_dbsm("acrylic", 8.0 * cell_across_m(30.0), 30.0)
    verdicts = {
        **ABSENT,
        **motion(0.0),
        "diffuse": rough_patch(rough, levels.point_dbw(50.0, rough) - power),
        "refraction": everything(f"the only strong echo crosses the pane twice: {through:.1f} dB"),
        "multi_bounce": nothing(
            "the pane, turned by 30 deg, mirrors the target nowhere that counts; to cross is no bounce"
        ),
        "diffraction": Verdict(
            levels.shadow_db(4.0, 50.0, 10.0),
            "the wave round the pane's edges, 4 m off the line (knife edge, one way); the pane's own edges stand in "
            "less than a tenth of the cells that its roughness fills",
        ),
        "near_field": near_field(60.0),
        "antenna_pattern": boresight(),
        "rcs_targets": everything("the only strong echo is a point target of 26.5 dBsm"),
        "noise": noise(power),
    }
    return Expectation(verdicts, (Echo("point target through the pane, out and back", 60.0, power),))


def corner() -> Expectation:
    """Out and back round the edge: the radar equation times the field of the shadow, squared twice."""
    shadow = 2.0 * levels.shadow_db(0.135, 30.0, 30.0)
    hidden = levels.point_dbw(60.0, 24.7) + shadow
    rough_dbsm = levels.diffuse_rcs_dbsm("concrete", 2.0 * levels.cell_width_m(30.0), 36.9)
    rough = levels.point_dbw(30.1, rough_dbsm)
    peak = max(hidden, rough)
    verdicts = {
        **ABSENT,
        **motion(0.0),
        "diffuse": Verdict(rough - peak, f"the wedge's face, {rough_dbsm:.1f} dBsm a cell, is as strong as the target"),
        "multi_bounce": nothing("the wedge is convex, and to bend round its edge is no bounce"),
        "refraction": nothing("0.8 m of concrete swallow the wave: two facets' slabs of 200 dB each"),
        "diffraction": Verdict(hidden - peak, f"the target is seen only round the edge, {shadow:.1f} dB out and back"),
        "near_field": near_field(30.0),
        "antenna_pattern": boresight("everything lies", 5.0),
        "rcs_targets": Verdict(hidden - peak, "what the edge leads to is a point target of 24.7 dBsm"),
        "noise": noise(peak),
    }
    return Expectation(
        verdicts,
        (Echo("point target round the edge, knife edge", 60.0, hidden), Echo("the wedge's rough face", 30.1, rough)),
    )


def parked_car() -> Expectation:
    """Its rear, 0.9 m high, is met at 30 deg, its side at 60 deg."""
    rough = levels.diffuse_rcs_dbsm("metal", 0.9 * cell_across_m(30.0), 30.0)
    power = levels.point_dbw(48.0, rough)
    verdicts = {
        **ABSENT,
        **motion(0.0),
        "diffuse": everything(f"the rough body is the only echo, {rough:.1f} dBsm a cell"),
        "multi_bounce": CONVEX,
        "diffraction": Verdict(
            levels.edge_rcs_dbsm(47.6, 1.5, 120.0, -1.0) + levels.edge_end_db(0.1, 47.6) - rough,
            "its upright edges end 0.1 m above the sensor: the wave along the rest of the nearest (Keller, Fresnel)",
        ),
        "near_field": near_field(48.0),
        "antenna_pattern": boresight("everything lies", 2.6),
        "noise": noise(power),
    }
    return Expectation(verdicts, (Echo("the rear's rough face, one cell", 48.0, power),))


def moving_ego() -> Expectation:
    """The van's rear at 7 m is the strongest cell; of its 1.8 m height the beam lights about 0.75 m."""
    van_m, azimuth = math.hypot(7.0, 2.8), math.degrees(math.atan2(2.8, 7.0))
    rough = levels.diffuse_rcs_dbsm(
        "metal", 0.75 * levels.cell_width_m(van_m) / math.cos(math.radians(azimuth)), azimuth
    )
    peak = levels.point_dbw(van_m, rough) + 2.0 * levels.pattern_db(azimuth, 0.0)
    nadir = levels.point_dbw(0.5, levels.plane_rcs_dbsm(0.5) + levels.mirror_db("asphalt")) + 2.0 * levels.pattern_db(
        0.0, -90.0
    )
    # By way of the road the wave meets it at 11 deg; with vertical polarisation that is near Brewster's angle.
    road = levels.grazing_mirror_db("asphalt", 11.3) + levels.pattern_db(0.0, -11.3)
    radial = round(11.0 * math.cos(math.radians(azimuth)), 1)
    verdicts = {
        **ABSENT,
        **motion(radial),
        "specular": Verdict(nadir - peak, "the road under the sensor, 0.5 m away, even in the pattern's sidelobe"),
        "diffuse": everything("walls, van, car and road are rough, and none of them looks at the radar"),
        "multi_bounce": Verdict(3.0 + road, f"the van by way of the road, out or back: {road:.1f} dB each"),
        "refraction": nothing("asphalt, concrete and metal let nothing through"),
        "diffraction": Verdict(
            levels.point_dbw(van_m, levels.edge_rcs_dbsm(van_m, 1.5, 90.0 + azimuth, -1.0))
            + levels.edge_end_db(0.1, van_m)
            + 2.0 * levels.pattern_db(azimuth, 0.0)
            - peak,
            "the van's upright edge, which ends 0.1 m above the sensor (Keller, Fresnel)",
        ),
        "corners": nothing(
            "the corners of road and walls begin 4 m beside the perpendicular on their edge, and with no height there"
        ),
        "near_field": near_field(0.5, mirror=True),
        "antenna_pattern": Verdict(
            levels.pattern_change_db(0.0, -90.0) - 2.0 * levels.pattern_db(0.0, -90.0) + nadir - peak,
            "with the gain of boresight the road below is 60 dB up",
        ),
        "noise": noise(peak),
    }
    return Expectation(
        verdicts,
        (Echo("the van's rough rear, one cell", van_m, peak), Echo("the road under the sensor, specular", 0.5, nadir)),
    )


def empty_field() -> Expectation:
    """Power a cell falls as R^-5 (sigma0 as sin^2) but rises out of the pattern's flank: the peak lies near 2.7 m."""
    depression = math.degrees(math.asin(0.5 / 2.7))
    patch = levels.cell_width_m(2.7) * levels.RADAR.waveform.range_step_m / math.cos(math.radians(depression))
    rough = levels.ground_rcs_dbsm("vegetation", patch, depression)
    cell = levels.point_dbw(2.7, rough) + 2.0 * levels.pattern_db(0.0, -depression)
    # A channel sees the whole row at once: 80 deg of the field's opening.
    row = cell + 10.0 * math.log10(2.0 * math.sin(math.radians(40.0)) * 2.7 / levels.cell_width_m(2.7))
    verdicts = {
        **ABSENT,
        **motion(0.0),
        "specular": nothing("the field begins 1 m ahead: the point below the sensor is not on it"),
        "diffuse": everything("rough ground is the only echo"),
        "multi_bounce": nothing("there is one flat surface"),
        "near_field": near_field(2.7),
        "antenna_pattern": Verdict(
            levels.pattern_change_db(0.0, -depression),
            f"the strongest cell lies {depression:.0f} deg below boresight, nearer ones further",
        ),
        "noise": noise(row),
    }
    return Expectation(
        verdicts,
        (Echo("rough ground, all of a channel's range cell", 2.7, row), Echo("rough ground, one cell", 2.7, cell)),
    )


def expectations(shows: Mapping[str, str]) -> dict[str, Any]:
    """The content of ``expected.json``.

    :param shows: what each scene is, in one sentence, by name
    """
    scenes = {
        "wall": wall(),
        "plate": plate(),
        "dihedral": dihedral(),
        "square_corner": square_corner(),
        "three_faces": three_faces(),
        "trihedral": point(60.0, 26.51),
        "reflector_behind_pane": reflector_behind_pane(),
        "target_behind_pane": target_behind_pane(),
        "corner": corner(),
        "parked_car": parked_car(),
        "moving_car": point(36.0, 14.6, 11.0),
        "creeping_target": point(60.0, -1.4, -0.1),
        "moving_ego": moving_ego(),
        "target_1m": point(1.0, -29.0),
        "target_80m": point(80.0, -1.4),
        "empty_field": empty_field(),
    }
    return {
        "budget_db": BUDGET_DB,
        "radar": levels.RADAR.name,
        "rules": RULES,
        "scenes": {name: expectation.to_json(shows[name]) for name, expectation in scenes.items()},
    }
