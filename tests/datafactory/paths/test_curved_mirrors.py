"""Levels of curved mirrors against closed forms and physical optics, tessellated in many ways.

Levels are those of one metal body; the bound of 0.5 dB is for k r > 50.
"""

from __future__ import annotations

import numpy as np
import pytest
from curved_bodies import (
    capsule,
    cylinder,
    ellipsoid,
    icosphere,
    rounded_box,
    sphere,
    tube,
)
from curved_scenes import (
    GLASS,
    METAL,
    WAVENUMBER,
    Real,
    amplitudes,
    body,
    cylinder_amplitude,
    level_db,
    rcs_dbsm,
    sphere_amplitude,
    traced,
    turned,
)
from scipy.spatial.transform import Rotation
from scipy.special import fresnel
from sionna_scenes import WAVELENGTH_M, mesh, plate

from datafactory.paths.table import PathTable
from datafactory.scenes.poses import Pose

pytestmark = pytest.mark.usefixtures("variant")


@pytest.mark.parametrize(("radius", "times"), [(0.05, 2.0), (0.05, 100.0), (0.4, 7.0), (5.0, 2.0), (5.0, 100.0)])
@pytest.mark.parametrize("segments", [16, 33])
def test_a_sphere_has_its_divergence_near_and_far(radius, times, segments):
    for seed in range(3):
        table = traced(body(sphere(radius, segments), (times * radius, 0.0, 0.0), turned(seed)))
        assert abs(level_db(table, sphere_amplitude(radius, times * radius))) < 0.1


def test_a_sphere_of_many_facets():
    table = traced(body(sphere(1.0, 200), (20.0, 3.0, -1.0), turned(1)))
    assert abs(level_db(table, sphere_amplitude(1.0, np.sqrt(410.0)))) < 0.02


def test_a_sphere_far_away_has_pi_r_squared():
    table = traced(body(icosphere(0.5, 3), (150.0, 10.0, 5.0)))
    assert rcs_dbsm(table) == pytest.approx(10.0 * np.log10(np.pi * 0.25), abs=0.1)


@pytest.mark.parametrize("subdivisions", [2, 3, 4])
@pytest.mark.parametrize("seed", range(2))
def test_an_icosphere_is_a_sphere(subdivisions, seed):
    table = traced(body(icosphere(0.3, subdivisions), (4.0, 1.0, 0.5), turned(seed)))
    assert abs(level_db(table, sphere_amplitude(0.3, float(np.linalg.norm([4.0, 1.0, 0.5]))))) < 0.05


@pytest.mark.parametrize("segments", [16, 200])
def test_the_echo_comes_from_the_sphere_and_not_from_its_chords(segments):
    table = traced(body(sphere(1.0, segments), (6.0, 2.0, 1.0), turned(5)))
    centre = np.array([6.0, 2.0, 1.0])
    distance = np.linalg.norm(centre)
    assert table.scattered.range_m()[0] == pytest.approx(distance - 1.0, abs=1e-6)
    sight = table.scattered.rx_point[0] / np.linalg.norm(table.scattered.rx_point)
    np.testing.assert_allclose(sight, centre / distance, atol=1e-6)


@pytest.mark.parametrize(
    ("radius", "length", "distance"),
    [(0.05, 0.1, 8.0), (0.05, 1.2, 0.4), (0.3, 0.05, 30.0), (0.3, 2.0, 3.0), (2.0, 0.5, 60.0), (5.0, 0.3, 12.0)],
)
@pytest.mark.parametrize("segments", [15, 200])
def test_a_cylinder_seen_broadside(radius, length, distance, segments):
    for turn in (0.0, 0.1, 0.37):
        table = traced(body(cylinder(radius, length, segments), (distance, 0.0, 0.0), Rotation.from_euler("z", turn)))
        assert abs(level_db(table, cylinder_amplitude(radius, length, distance))) < 0.25


def test_a_short_cylinder_far_away_has_k_r_l_squared():
    table = traced(body(cylinder(0.5, 0.02, 32), (60.0, 0.0, 0.0)))
    expected = WAVENUMBER * 0.5 * 0.02**2
    assert rcs_dbsm(table) == pytest.approx(10.0 * np.log10(expected), abs=0.2)


@pytest.mark.parametrize("rings", [1, 3, 40])
def test_a_cylinder_cut_into_rings_is_the_same(rings):
    table = traced(body(cylinder(0.4, 1.0, 40, rings), (5.0, 0.0, 0.0)))
    assert abs(level_db(table, cylinder_amplitude(0.4, 1.0, 5.0))) < 0.25


@pytest.mark.parametrize("degrees", [30.0, 45.0, 90.0])
def test_a_cylinder_seen_off_broadside_and_end_on(degrees):
    """Off broadside no normal of the side goes through the radar; end on there is the flat lid alone."""
    table = traced(body(cylinder(0.4, 1.0, 40), (9.0, 0.0, 0.0), Rotation.from_euler("y", degrees, degrees=True)))
    assert table.counts["curved_mirrors"] == 0
    assert len(table.specular) == (degrees == 90.0)


def test_the_lying_cylinder_is_as_strong_as_the_standing_one():
    standing = traced(body(cylinder(0.4, 1.0, 40), (9.0, 0.0, 0.0)))
    lying = traced(body(cylinder(0.4, 1.0, 40), (9.0, 0.0, 0.0), Rotation.from_euler("x", 90.0, degrees=True)))
    assert abs(amplitudes(lying)[0]) == pytest.approx(abs(amplitudes(standing)[0]), rel=1e-6)
    assert (len(standing.scattered), len(lying.specular)) == (1, 1)  # the array lies across the one, along the other


def test_a_half_cylinder_ends():
    """Its middle reflects as a cylinder's does, the line at its end half as much, and beyond it there is none."""
    half = tube(0.5, 1.0, 24, turn=np.pi)  # from +x over +y to -x
    whole = amplitudes(traced(body(cylinder(0.5, 1.0, 48), (5.0, 0.0, 0.0))))[0]

    def seen(degrees: float) -> PathTable:
        return traced(body(half, (5.0, 0.0, 0.0), Rotation.from_euler("z", degrees, degrees=True)))

    assert amplitudes(seen(90.0))[0] == pytest.approx(whole, rel=1e-3)
    assert amplitudes(seen(0.05))[0] == pytest.approx(0.5 * whole, rel=0.06)
    (inside,) = seen(-0.1).scattered.range_m()  # what is left is the hollow of the far side
    assert inside == pytest.approx(5.5)


def test_the_share_fades_towards_the_end_as_the_fresnel_integral_does():
    half = tube(2.0, 1.0, 90, turn=np.pi)
    whole = amplitudes(traced(body(cylinder(2.0, 1.0, 180), (12.0, 0.0, 0.0))))[0]
    for degrees in (0.3, 0.8, 1.5, 3.0):
        turn = Rotation.from_euler("z", degrees, degrees=True)
        share = amplitudes(traced(body(half, (12.0, 0.0, 0.0), turn)))[0] / whole
        zones = 2.0 * np.sin(np.radians(degrees)) * np.sqrt(2.0 * 6.0 / (10.0 * WAVELENGTH_M))
        sine, cosine = fresnel(np.sqrt(2.0) * zones)
        expected = ((0.5 + cosine) + 1j * (0.5 + sine)) / (1.0 + 1.0j)
        assert abs(share - expected) < 0.05


def test_a_capsule_is_a_cylinder_from_the_side_and_a_sphere_from_its_ends():
    side = traced(body(capsule(0.3, 1.5, 32), (6.0, 0.0, 0.0)))
    assert abs(level_db(side, cylinder_amplitude(0.3, 1.5, 6.0))) < 0.3
    for degrees in (90.0, 60.0, 25.0):
        turn = Rotation.from_euler("y", -degrees, degrees=True)
        end = traced(body(capsule(0.3, 1.5, 32), (6.0, 0.0, 0.0), turn))
        to_end = np.array([6.0, 0.0, 0.0]) - np.abs(turn.apply([0.0, 0.0, 0.75])) * np.sign([1.0, 0.0, 0.0])
        centre = min(
            (np.array([6.0, 0.0, 0.0]) + s * turn.apply([0.0, 0.0, 0.75]) for s in (-1.0, 1.0)), key=np.linalg.norm
        )
        assert to_end[0] == pytest.approx(centre[0])
        assert abs(level_db(end, sphere_amplitude(0.3, float(np.linalg.norm(centre))))) < 0.3


def ellipsoid_amplitude(radii: tuple[float, float, float], eye: Real) -> float:
    """From the curvature of (x/a)^2 + (y/b)^2 + (z/c)^2 = 1 at its point nearest to ``eye``.

    The Gaussian curvature is h^4 / (a b c)^2 and the mean curvature h^3 (a^2 + b^2 + c^2 - |p|^2) / (2 (a b c)^2), h
    the distance of the tangent plane from the centre (do Carmo).
    """
    a2 = np.array(radii) ** 2
    low, high = -a2.min() + 1e-9, np.linalg.norm(eye) * max(radii)
    for _ in range(200):
        t = 0.5 * (low + high)
        low, high = (t, high) if np.sum((np.sqrt(a2) * eye / (a2 + t)) ** 2) > 1.0 else (low, t)
    point = a2 * eye / (a2 + t)
    h = 1.0 / np.linalg.norm(point / a2)
    gauss = h**4 / np.prod(a2)
    mean = h**3 * (a2.sum() - point @ point) / (2.0 * np.prod(a2))
    range_m = np.linalg.norm(eye - point)
    return WAVELENGTH_M / (8.0 * np.pi * range_m) / np.sqrt(1.0 + 2.0 * mean * range_m + gauss * range_m**2)


@pytest.mark.parametrize(("segments", "bound_db"), [(48, 0.4), (72, 0.2), (120, 0.1)])
@pytest.mark.parametrize("seed", range(3))
def test_an_ellipsoid_as_long_as_a_car(segments, bound_db, seed):
    radii = (2.2, 0.9, 0.7)
    turn, centre = turned(seed), np.array([9.0, 1.0, -0.5])
    table = traced(body(ellipsoid(radii, segments), centre, turn))
    assert abs(level_db(table, ellipsoid_amplitude(radii, turn.inv().apply(-centre)))) < bound_db


@pytest.mark.parametrize("steps", [4, 8, 40])
def test_a_rounded_box_has_flat_faces_cylindrical_edges_and_spherical_corners(steps):
    half, radius, distance = (2.0, 0.8, 0.6), 0.25, 12.0
    of = rounded_box(half, radius, steps)
    face = traced(body(of, (distance, 0.0, 0.0)))
    assert face.counts["curved_mirrors"] == 0
    assert np.abs(face.specular.image[0]) == pytest.approx([2.0 * (distance - 2.0), 0.0, 0.0], abs=1e-9)
    # From 2.7 deg on, the upright rounded edge: a cylinder of the height that is straight.
    for degrees in (2.8, 4.0, 30.0, 70.0):
        turn = Rotation.from_euler("z", degrees, degrees=True)
        edge = traced(body(of, (distance, 0.0, 0.0), turn))
        axes = turn.apply([[-1.75, 0.55, 0.0], [-1.75, -0.55, 0.0]])
        to_axis = float(np.linalg.norm(axes + np.array([distance, 0.0, 0.0]), axis=1).min())
        assert abs(level_db(edge, cylinder_amplitude(radius, 0.7, to_axis))) < 0.5
    # From a corner, a sphere.
    turn = Rotation.from_euler("zy", [35.0, 30.0], degrees=True)
    corner = traced(body(of, (distance, 0.0, 0.0), turn))
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    centres = turn.apply(signs * (np.array(half) - radius)) + np.array([distance, 0.0, 0.0])
    nearest = np.linalg.norm(centres, axis=1).min()
    assert abs(level_db(corner, sphere_amplitude(radius, nearest))) < 0.5


@pytest.mark.parametrize("seed", range(3))
def test_turned_and_far_from_the_origin_the_echo_is_the_same(seed):
    of, turn = ellipsoid((2.2, 0.9, 0.7), 48), turned(seed)
    shift = np.array([500_000.0, 5_480_000.0, 320.0])
    here = traced(body(of, (9.0, 1.0, 0.0), turn))
    there = traced(body(of, np.array([9.0, 1.0, 0.0]) + shift, turn), pose=Pose(tuple(shift)))
    yaw = Rotation.from_euler("z", 40.0, degrees=True)
    aside = traced(body(of, yaw.apply([9.0, 1.0, 0.0]), yaw * turn), pose=Pose((0.0, 0.0, 0.0), yaw_deg=40.0))
    for other in (there, aside):
        assert amplitudes(other)[0] == pytest.approx(amplitudes(here)[0], rel=1e-4)
        np.testing.assert_allclose(other.scattered.rx_point, here.scattered.rx_point, atol=1e-5)


def test_winding_and_meshes_of_several_materials_change_nothing():
    vertices, triangles = sphere(0.5, 32)
    flipped = triangles.copy()
    flipped[::3] = flipped[::3, ::-1]
    whole = amplitudes(traced(body((vertices, triangles), (5.0, 0.3, 0.2))))
    assert amplitudes(traced(body((vertices, flipped), (5.0, 0.3, 0.2)))) == pytest.approx(whole)
    upper = vertices[triangles].mean(axis=1)[:, 2] > 0.05
    parts = [
        mesh(name, vertices + np.array([5.0, 0.3, 0.2]), triangles[which], of)
        for name, which, of in (("upper", upper, "metal"), ("lower", ~upper, "glass"))
    ]
    cut = amplitudes(traced(*parts))
    assert abs(cut[0]) == pytest.approx(abs(GLASS / METAL * whole[0]), rel=1e-6)


def test_what_stands_before_a_sphere_hides_it():
    ball = body(sphere(0.5, 32), (6.0, 0.0, 0.0))
    screen = plate("screen", (3.0, 0.0, 0.5), (0.0, 1.0, 0.0), (0.2, 0.0, 1.0), "metal")  # tilted: no echo of its own
    table = traced(ball, screen)
    assert len(table) == 0
    assert table.counts["curved_mirrors_hidden"] > 0


def test_a_pane_before_a_sphere_takes_its_share():
    ball = body(sphere(0.5, 32), (6.0, 0.0, 0.0))
    pane = plate("pane", (3.0, 0.0, 0.5), (0.0, 2.0, 0.0), (0.4, 0.0, 2.0), "air")
    clear, behind = traced(ball), traced(ball, pane, refraction=True)
    strongest = np.abs(amplitudes(behind)).max()
    assert strongest == pytest.approx(abs(amplitudes(clear)[0]), rel=1e-6)


def test_the_material_reflects_at_normal_incidence():
    metal, glass = (traced(body(sphere(0.5, 32), (6.0, 0.0, 0.0), material=of)) for of in ("metal", "glass"))
    assert amplitudes(glass)[0] / amplitudes(metal)[0] == pytest.approx(np.conj(GLASS / METAL), rel=1e-9)
    assert len(traced(body(sphere(0.5, 32), (6.0, 0.0, 0.0)), polarization=("V", "H"))) == 0


def physical_optics(point: Real, area: Real, wanted: Real) -> complex:
    """Slow reference: amplitude of a lit metal surface by the sum over its elements, as the table has it.

    A = j / (4 pi) int cos(theta) exp(2 j k (rho - R)) / rho^2 dS, Gamma = -1, which is -lambda / (8 pi R) of a plane.

    :param point: [..., 3]; :param area: [..., 3] area vectors, outwards; :param wanted: [...] weight of the elements
    """
    rho = np.linalg.norm(point, axis=-1)
    facing = -np.einsum("...i,...i->...", area, point) / rho
    phase = 2.0 * WAVENUMBER * (rho - rho.min())
    return complex(1j / (4.0 * np.pi) * np.sum(wanted * np.maximum(facing, 0.0) * np.exp(1j * phase) / rho**2))


def test_an_ellipsoid_near_by_agrees_with_physical_optics():
    """The shadow's edge, of which physical optics makes too much, is faded out."""
    radii, centre, turn = np.array([0.14, 0.09, 0.07]), np.array([0.5, 0.05, 0.02]), turned(11)
    steps = 1400
    level = (np.arange(steps) + 0.5) / steps * np.pi - 0.5 * np.pi
    around = (np.arange(2 * steps) + 0.5) / steps * np.pi
    z, phi = np.meshgrid(level, around, indexing="ij")
    unit = np.stack([np.cos(z) * np.cos(phi), np.cos(z) * np.sin(phi), np.sin(z)], axis=-1)
    area = unit * np.prod(radii) / radii * (np.cos(z) * (np.pi / steps) ** 2)[..., None]
    point, area = unit * radii @ turn.as_matrix().T + centre, area @ turn.as_matrix().T
    cosine = -np.einsum("...i,...i->...", area, point) / np.linalg.norm(area, axis=-1) / np.linalg.norm(point, axis=-1)
    fade = np.clip(cosine / 0.7, 0.0, 1.0)
    slow = physical_optics(point, area, fade**2 * (3.0 - 2.0 * fade))
    table = traced(body(ellipsoid(tuple(radii), 96), centre, turn))
    fast = amplitudes(table)[0] / np.abs(METAL)
    assert abs(20.0 * np.log10(abs(fast / slow))) < 0.2
    assert abs(np.angle(fast / slow)) < 0.1


@pytest.mark.parametrize(("turn_deg", "up_m"), [(0.0, 0.0), (5.0, 0.01), (7.0, 0.0), (7.9, 0.02)])
def test_a_piece_of_a_cylinder_that_ends_near_the_foot_agrees_with_physical_optics(turn_deg, up_m):
    radius, length, half_deg, distance = 0.4, 0.06, 8.0, 1.2
    phi = np.radians(turn_deg + half_deg * (2.0 * (np.arange(800) + 0.5) / 800 - 1.0)) + np.pi
    z = up_m + length * ((np.arange(400) + 0.5) / 400 - 0.5)
    around, up = np.meshgrid(phi, z, indexing="ij")
    out = np.stack([np.cos(around), np.sin(around), np.zeros_like(up)], axis=-1)
    point = radius * out + np.stack([np.full_like(up, distance), np.zeros_like(up), up], axis=-1)
    area = out * radius * np.radians(2.0 * half_deg) / 800 * length / 400
    slow = physical_optics(point, area, np.ones_like(up))
    start = np.pi + np.radians(turn_deg - half_deg)
    piece = tube(radius, length, 10, start=start, turn=np.radians(2.0 * half_deg))
    fast = amplitudes(traced(body(piece, (distance, 0.0, up_m))))[0] / np.abs(METAL)
    nearest = np.exp(2j * WAVENUMBER * (np.linalg.norm(point, axis=-1).min() - (distance - radius)))
    whole = WAVELENGTH_M / (8.0 * np.pi * (distance - radius)) / np.sqrt(1.0 + (distance - radius) / radius)
    assert abs(fast - slow * nearest) < 0.06 * whole
