"""Trihedral corners: found in meshes, held against closed forms and against rays followed one by one."""

from __future__ import annotations

import numpy as np
import pytest
from corner_scenes import HERE, always, cross_section_dbsm, level_db, received
from oracles import corner_area
from sionna_scenes import WAVELENGTH_M, box, every_one, mesh, plate, scene_of, slabs, view_with

from datafactory.paths.corner_echoes import CornerPointEchoes
from datafactory.paths.corners import points_of
from datafactory.paths.merged_scene import MergedScene
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import CORNER
from datafactory.scenes.poses import Pose

AXIS = np.array([[-1.0, np.sqrt(2.0) * np.sin(t), np.sqrt(2.0) * np.cos(t)] for t in np.radians([10.0, 130.0, 250.0])])
AXIS /= np.sqrt(3.0)
"""Three edges at right angles about -x."""


def rotated(yaw_deg: float, pitch_deg: float = 0.0):
    return Pose((0.0, 0.0, 0.0), yaw_deg=yaw_deg, pitch_deg=pitch_deg).rotation()


def trihedral(distance_m: float, legs_m: float, square: bool = False, turn=None, bend_rad: float = 0.0, cuts: int = 1):
    """Three faces about a point on the x axis.

    :param turn: rotation [3, 3] about the point; :param bend_rad: one edge is turned by this in the plane of another
    :param cuts: each triangle is cut into so many squared
    """
    edges = AXIS.copy()
    edges[2] = np.cos(bend_rad) * edges[2] + np.sin(bend_rad) * edges[1]
    edges = edges @ (np.eye(3) if turn is None else turn).T
    apex, objects = np.array([distance_m, 0.0, 0.0]), []
    for i in range(3):
        one, other = legs_m * edges[(i + 1) % 3], legs_m * edges[(i + 2) % 3]
        index: dict[tuple[int, int], int] = {}
        points: list[np.ndarray] = []
        triangles: list[list[int]] = []
        for s in range(cuts + 1):
            for t in range(cuts + 1 if square else cuts + 1 - s):
                index[s, t] = len(points)
                points.append(apex + s / cuts * one + t / cuts * other)
        for s, t in index:
            if (s + 1, t) in index and (s, t + 1) in index:
                triangles.append([index[s, t], index[s + 1, t], index[s, t + 1]])
                if (s + 1, t + 1) in index:
                    triangles.append([index[s + 1, t], index[s + 1, t + 1], index[s, t + 1]])
        objects.append(mesh(f"face-{i}", points, triangles, "metal"))
    return objects


def echoes(of: MergedScene, pose: Pose = HERE, sight=always, polarization=("V", "V")):
    settings, points = TraceSettings(polarization=polarization), points_of(of).seen_from(pose)
    return every_one(CornerPointEchoes(view_with(slabs(of), sight, settings, corner_points=points)))


def section_dbsm(objects, distance_m: float) -> float:
    return cross_section_dbsm(received(echoes(scene_of(*objects))[:2]), distance_m)


@pytest.mark.parametrize("legs_m", [0.05, 0.1, 0.2])
@pytest.mark.parametrize(("square", "factor"), [(False, 4.0 / 3.0), (True, 12.0)], ids=["triangular", "square"])
def test_on_axis_far_away_it_has_its_cross_section(legs_m, square, factor):
    """4 pi a^4 / (3 lambda^2) and 12 pi a^4 / lambda^2, at 200 m."""
    expected = 10.0 * np.log10(factor * np.pi * legs_m**4 / WAVELENGTH_M**2)
    assert abs(section_dbsm(trihedral(200.0, legs_m, square), 200.0) - expected) < 0.3


@pytest.mark.parametrize("square", [False, True], ids=["triangular", "square"])
@pytest.mark.parametrize(("yaw_deg", "pitch_deg"), [(0.0, 0.0), (12.0, 0.0), (-8.0, 9.0)])
def test_off_axis_its_aperture_is_that_of_the_rays_that_come_back(square, yaw_deg, pitch_deg):
    turn, reach = rotated(yaw_deg, pitch_deg), np.max if square else np.sum
    objects = trihedral(500.0, 0.1, square, turn)
    cosines = AXIS @ turn.T @ [-1.0, 0.0, 0.0]
    area = corner_area(
        np.eye(3), lambda _, p: (p >= -1e-9).all(axis=1) & (reach(p, axis=1) <= 0.1), cosines, extent=0.2, count=800
    )
    expected = 10.0 * np.log10(4.0 * np.pi * area**2 / WAVELENGTH_M**2)
    assert abs(section_dbsm(objects, 500.0) - expected) < 0.3


def test_a_large_one_is_an_image_of_the_radar_inverted_in_its_point():
    scattered, specular, _ = echoes(scene_of(*trihedral(20.0, 5.0, True)))
    assert len(scattered) == 0
    np.testing.assert_allclose(specular.image, [[40.0, 0.0, 0.0]], atol=1e-9)
    np.testing.assert_allclose(specular.axes, [-np.eye(3)], atol=1e-12)
    endless = WAVELENGTH_M / (8.0 * np.pi * 20.0)
    assert abs(level_db(specular.amplitude[0], endless)) < 0.3
    assert specular.kinds[0] == CORNER
    assert specular.depth[0] == 3


def test_every_polarisation_comes_back_turned_by_three_mirrors():
    """Metal turns E into -(1 - 2 n n) E; three such mirrors give E again, 90 deg late as from all that is small."""
    of = scene_of(*trihedral(30.0, 0.1))
    vertical, level, crossed = (received(echoes(of, polarization=which)[:2]) for which in ("VV", "HH", "VH"))
    assert level / vertical == pytest.approx(1.0, abs=0.01)
    assert abs(crossed / vertical) < 0.01
    assert np.angle(1j * vertical * np.exp(-4j * np.pi * 30.0 / WAVELENGTH_M)) == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize("cuts", [3, 10])
@pytest.mark.parametrize("square", [False, True], ids=["triangular", "square"])
def test_cut_otherwise_it_sends_the_same_echo(cuts, square):
    turn = rotated(7.0, -5.0)
    whole, pieces = (section_dbsm(trihedral(40.0, 0.15, square, turn, cuts=n), 40.0) for n in (1, cuts))
    assert abs(whole - pieces) < 0.01


def test_moved_by_500_km_it_sends_the_same_echo():
    still = section_dbsm(trihedral(40.0, 0.15), 40.0)
    shift = np.array([500_000.0, 5_480_000.0, 320.0])
    far = [mesh(item.name, item.vertices + shift, item.triangles, "metal") for item in trihedral(40.0, 0.15)]
    scattered, specular, _ = echoes(scene_of(*far), Pose(tuple(shift)))
    assert abs(cross_section_dbsm(received((scattered, specular)), 40.0) - still) < 0.01


def test_a_corner_that_is_off_square_is_left_out_and_counted():
    """Across legs of 0.2 m, 0.5 deg turn the phase by about a cycle; 0.005 deg do not."""
    for bend_deg, echo_count in ((0.005, 1), (0.5, 0)):
        scattered, specular, counts = echoes(scene_of(*trihedral(40.0, 0.2, bend_rad=np.radians(bend_deg))))
        assert len(scattered) + len(specular) == echo_count
        assert counts["corner_points_off_square"] == 1 - echo_count


def test_what_stands_before_it_hides_it_and_is_counted():
    _, _, counts = echoes(scene_of(*trihedral(40.0, 0.2)), sight=lambda start, end: np.zeros(len(end), dtype=bool))
    assert counts["corner_points_hidden"] == 1


def test_a_house_on_the_ground_has_points_inside_only():
    """Eight of the box; on the ground its lower four are those of the ground as well, and outside there is none."""
    house = box("house", (2.0, 2.0, 0.0), (6.0, 5.0, 3.0), "metal")
    assert len(points_of(scene_of(house))) == 8
    ground = plate("ground", (0.0, 0.0, 0.0), (20.0, 0.0, 0.0), (0.0, 20.0, 0.0), "metal")
    points = points_of(scene_of(house, ground))
    inwards = [4.0, 3.5, 1.5] - points.apex
    assert (np.einsum("qi,qi->q", points.axes.sum(axis=1), inwards) > 0.0).all()


def test_a_room_corner_of_ground_and_two_walls_is_one_point():
    ground = plate("ground", (0.0, 0.0, 0.0), (5.0, 0.0, 0.0), (0.0, 5.0, 0.0), "metal")
    one = plate("one", (5.0, 0.0, 1.5), (0.0, 5.0, 0.0), (0.0, 0.0, 1.5), "metal")
    other = plate("other", (0.0, 5.0, 1.5), (5.0, 0.0, 0.0), (0.0, 0.0, 1.5), "metal")
    points = points_of(scene_of(ground, one, other))
    np.testing.assert_allclose(points.apex, [[5.0, 5.0, 0.0]], atol=1e-9)
    np.testing.assert_allclose(np.sort(points.axes[0].sum(axis=0)), [-1.0, -1.0, 1.0], atol=1e-9)
    assert len(points_of(scene_of(ground, one))) == 0
    assert len(points_of(scene_of())) == 0
