"""Curved mirrors: levels against closed forms and physical optics, delays against shortest paths, what is degenerate.

Levels are those of one metal body; the bound of 0.5 dB is for k r > 50.
"""

import numpy as np
import pytest
from curved_scenes import (
    GLASS,
    METAL,
    WAVENUMBER,
    Real,
    amplitudes,
    body,
    cylinder,
    cylinder_amplitude,
    ellipsoid,
    icosphere,
    joined,
    level_db,
    rounded_box,
    sphere,
    sphere_amplitude,
    torus,
    traced,
    tube,
    turned,
)
from hardcases.tools import not_finite_paths
from oracles import path_length
from scipy.optimize import brentq, minimize
from scipy.spatial.transform import Rotation
from scipy.special import fresnel
from sionna_scenes import WAVELENGTH_M, mesh, plate

from datafactory.paths.table import PathTable, ScatteredPaths, SpecularPaths

pytestmark = pytest.mark.usefixtures("variant")


PLACES = ((0.05, 2.0), (0.4, 7.0), (5.0, 100.0))


@pytest.mark.parametrize(
    ("made", "facets", "bound_db", "radius", "times"),
    [*((*of, *place) for of in ((sphere, 16, 0.1), (icosphere, 2, 0.05)) for place in PLACES),
     (sphere, 200, 0.02, *PLACES[1]), (icosphere, 4, 0.05, *PLACES[1])],
)  # fmt: skip
def test_a_sphere_has_its_divergence_near_and_far(made, facets, bound_db, radius, times):
    for seed in range(2):
        table = traced(body(made(radius, facets), (times * radius, 0.0, 0.0), turned(seed)))
        assert abs(level_db(table, sphere_amplitude(radius, times * radius))) < bound_db


@pytest.mark.parametrize(
    ("radius", "length", "distance"),
    [(0.05, 0.1, 8.0), (0.05, 1.2, 0.4), (0.3, 0.05, 30.0), (0.3, 2.0, 3.0), (2.0, 0.5, 60.0), (5.0, 0.3, 12.0)],
)
@pytest.mark.parametrize(("segments", "rings"), [(15, 1), (200, 1), (40, 40)])
def test_a_cylinder_seen_broadside(radius, length, distance, segments, rings):
    of = cylinder(radius, length, segments, rings)
    for turn in (0.0, 0.1, 0.37):
        table = traced(body(of, (distance, 0.0, 0.0), Rotation.from_euler("z", turn)))
        assert abs(level_db(table, cylinder_amplitude(radius, length, distance))) < 0.25
    lying = traced(body(of, (distance, 0.0, 0.0), Rotation.from_euler("zx", [turn, 0.5 * np.pi])))
    assert abs(amplitudes(lying)[0]) == pytest.approx(abs(amplitudes(table)[0]), rel=1e-6, abs=0.0)


@pytest.mark.parametrize(("radius", "segments", "distance", "end_deg"), [(0.5, 24, 5.0, 0.05), (2.0, 90, 12.0, 0.024)])
def test_a_half_cylinder_ends(radius, segments, distance, end_deg):
    """Its middle reflects as a cylinder's does, the line at its end half as much, and beyond it there is none."""
    half, centre = tube(radius, 1.0, segments, turn=np.pi), (distance, 0.0, 0.0)  # from +x over +y to -x
    whole = amplitudes(traced(body(cylinder(radius, 1.0, 2 * segments), centre)))[0]

    def seen(degrees: float) -> PathTable:
        return traced(body(half, centre, Rotation.from_euler("z", degrees, degrees=True)))

    assert amplitudes(seen(90.0))[0] == pytest.approx(whole, rel=1e-3)
    assert amplitudes(seen(end_deg))[0] == pytest.approx(0.5 * whole, rel=0.06)
    assert seen(-0.1).scattered.range_m() == pytest.approx([distance + radius])  # the hollow of the far side is left
    for degrees in (0.3, 0.8, 1.5, 3.0):  # towards its end the share fades as the Fresnel integral does
        end_m, curved = radius * np.sin(np.radians(degrees)), 1.0 / radius + 1.0 / (distance - radius)
        sine, cosine = fresnel(2.0 * end_m * np.sqrt(curved / WAVELENGTH_M))
        expected = ((0.5 + cosine) + 1j * (0.5 + sine)) / (1.0 + 1.0j)
        assert abs(amplitudes(seen(degrees))[0] / whole - expected) < 0.05


@pytest.mark.parametrize(("segments", "bound_db"), [(48, 0.4), (72, 0.2), (120, 0.1)])
@pytest.mark.parametrize("seed", range(3))
def test_an_ellipsoid_as_long_as_a_car(segments, bound_db, seed):
    """From the curvatures at its point p nearest to the radar, h the distance of the tangent plane from the centre.

    The Gaussian curvature is h^4 / (a b c)^2 and the mean curvature h^3 (a^2 + b^2 + c^2 - |p|^2) / (2 (a b c)^2) (do
    Carmo).
    """
    radii, turn, centre = (2.2, 0.9, 0.7), turned(seed), np.array([9.0, 1.0, -0.5])
    a2, eye = np.square(radii), turn.inv().apply(-centre)
    point = a2 * eye / (a2 + brentq(lambda t: np.sum(a2 * (eye / (a2 + t)) ** 2) - 1.0, 0.0, 100.0))
    h, range_m = 1.0 / np.linalg.norm(point / a2), np.linalg.norm(eye - point)
    gauss, twice_mean = h**4 / np.prod(a2), h**3 * (a2.sum() - point @ point) / np.prod(a2)
    expected = WAVELENGTH_M / (8.0 * np.pi * range_m) / np.sqrt(1.0 + twice_mean * range_m + gauss * range_m**2)
    assert abs(level_db(traced(body(ellipsoid(radii, segments), centre, turn)), expected)) < bound_db


@pytest.mark.parametrize("steps", [4, 40])
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


def test_the_inside_of_a_cylinder_beyond_its_focus():
    """A pipe's far wall, 1 + kappa R = 1 - R / r: the line focus takes a quarter of a cycle."""
    pipe = tube(2.0, 0.2, 90, start=-0.5 * np.pi, turn=np.pi)
    for range_m in (1.0, 1.7, 3.0, 9.0):
        table = traced(body(pipe, (range_m - 2.0, 0.0, 0.0)))
        sine, cosine = fresnel(np.sqrt(2.0) * 0.1 * np.sqrt(2.0 / (range_m * WAVELENGTH_M)))
        along = np.sqrt(2.0) * (cosine + 1j * sine) * np.exp(-0.25j * np.pi)
        gain = along / np.sqrt(abs(1.0 - range_m / 2.0)) * (1.0 if range_m < 2.0 else -1j)
        infinite = -WAVELENGTH_M / (8.0 * np.pi * range_m)
        echoes = amplitudes(table)
        assert len(echoes) == 1
        assert abs(20.0 * np.log10(abs(echoes[0] / (infinite * gain)))) < 0.6
        assert abs(np.angle(echoes[0] / (infinite * gain))) < 0.15


def test_a_saddle_has_its_two_curvatures():
    """The inner side of a torus, seen along its plane from within its hole, off its axis."""
    ring, thick, eye = 3.0, 0.8, 1.5
    table = traced(body(torus(ring, thick, 120, 48), (-eye, 0.0, 0.0)))
    assert not_finite_paths(table) == 0
    range_m = table.range_m()
    here = np.argmin(np.abs(range_m - (ring - thick - eye)))
    kappa = np.array([1.0 / thick, -1.0 / (ring - thick)])
    gain = 1.0 / np.sqrt(np.prod(1.0 + kappa * range_m[here]))
    expected = WAVELENGTH_M / (8.0 * np.pi * range_m[here]) * gain
    assert abs(20.0 * np.log10(abs(amplitudes(table)[here]) / expected)) < 0.3


def test_two_spheres_of_one_mesh_are_two_mirrors():
    vertices, triangles = sphere(0.5, 32)
    two = joined((vertices, triangles), (vertices + np.array([0.0, 3.0, 0.0]), triangles))
    assert len(traced(body(two, (5.0, 0.3, 0.2)))) == 2


def shortest(surface, start: Real, tx: Real, rx: Real) -> float:
    """Length of the shortest path over a surface, ``surface(parameters)`` [3]."""

    def length(parameters: Real) -> float:
        point = surface(parameters)
        return float(np.linalg.norm(point - tx) + np.linalg.norm(point - rx))

    found = minimize(length, start, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-13, "maxiter": 4000})
    return float(found.fun)


def law_error_m(tx: Real, rx: Real, range_m: float, k: float, law: type) -> float:
    """The bound of the module's docstring."""
    a, b = float(np.linalg.norm(tx)), float(np.linalg.norm(rx))
    if law is SpecularPaths:
        return (a + b) ** 2 * k / 4.0
    s = 2.0 * range_m / (1.0 + range_m * k)
    return a * b * abs(1.0 / range_m - k) / 2.0 + a**2 * abs(1.0 / s - 1.0 / (2.0 / k - s)) / 2.0


@pytest.mark.parametrize(("radius", "range_m"), [(0.3, 1.5), (1.0, 4.0), (5.0, 3.0), (40.0, 4.0)])
def test_the_path_of_every_tx_and_rx_over_a_sphere(radius, range_m):
    direction = np.array([0.9, 0.3, 0.1]) / np.linalg.norm([0.9, 0.3, 0.1])
    centre = (range_m + radius) * direction
    table = traced(body(sphere(radius, 48), centre, turned(2)))
    path = table.scattered if len(table.scattered) else table.specular

    def surface(parameters: Real) -> Real:
        level, turn = parameters
        away = np.array([np.cos(level) * np.cos(turn), np.cos(level) * np.sin(turn), np.sin(level)])
        return centre - radius * away

    start = np.array([np.arcsin(direction[2]), np.arctan2(direction[1], direction[0])])
    for tx_y, rx_y in ((0.0, 0.25), (0.0, -0.25), (-0.05, 0.05), (-0.05, -0.25), (0.05, 0.05)):
        tx, rx = np.array([0.0, tx_y, 0.0]), np.array([0.0, rx_y, 0.0])
        true = shortest(surface, start, tx, rx)
        bound = law_error_m(tx, rx, range_m, 1.0 / (range_m + radius), type(path))
        cubic = (abs(tx_y) + abs(rx_y)) ** 3 / range_m**2
        assert abs(path_length(path, tx, rx) - true) < bound + cubic
        plain = 2.0 * range_m - direction[1] * (tx_y + rx_y)
        assert abs(path_length(path, tx, rx) - true) < 0.5 * abs(plain - true) + cubic  # the law does help


@pytest.mark.parametrize("upright", [True, False])
def test_the_path_of_every_tx_and_rx_over_a_cylinder(upright):
    radius, range_m = 0.5, 3.0
    turn = Rotation.identity() if upright else Rotation.from_euler("x", 90.0, degrees=True)
    table = traced(body(cylinder(radius, 6.0, 60), (range_m + radius, 0.0, 0.0), turn))
    path = table.scattered if upright else table.specular
    assert len(path) == 1

    def surface(parameters: Real) -> Real:
        turned_by, along = parameters
        local = np.array([-radius * np.cos(turned_by), radius * np.sin(turned_by), along])
        return np.array([range_m + radius, 0.0, 0.0]) + turn.apply(local)

    for tx_y, rx_y in ((0.0, 0.25), (-0.05, 0.05), (-0.05, -0.25)):
        tx, rx = np.array([0.0, tx_y, 0.0]), np.array([0.0, rx_y, 0.0])
        true = shortest(surface, np.zeros(2), tx, rx)
        bound = law_error_m(tx, rx, range_m, 1.0 / (range_m + radius), ScatteredPaths) if upright else 0.0
        assert abs(path_length(path, tx, rx) - true) < bound + (abs(tx_y) + abs(rx_y)) ** 4 / range_m**3 + 1e-9


@pytest.mark.parametrize("radius", [0.3, 1.5, 60.0])
def test_a_moving_sphere_has_the_delay_of_its_own_geometry(radius):
    centre, velocity = np.array([5.0 + radius, 1.0, 0.2]), np.array([-8.0, 14.0, 3.0])
    table = traced(body(sphere(radius, 64), centre, turned(3), velocity=tuple(velocity)))
    path = table.scattered if len(table.scattered) else table.specular
    nowhere, distance = np.zeros(3), np.linalg.norm(centre)
    across = np.linalg.norm(velocity - velocity @ centre / distance**2 * centre)
    for time_s in (-0.01, 0.005, 0.01):
        true = 2.0 * (np.linalg.norm(centre + velocity * time_s) - radius)
        cubic = 4.0 * np.linalg.norm(velocity) ** 3 * abs(time_s) ** 3 / 25.0
        bound = cubic if isinstance(path, ScatteredPaths) else across**2 * time_s**2 / distance
        assert abs(path_length(path, nowhere, nowhere, time_s) - true) < bound + 1e-7
