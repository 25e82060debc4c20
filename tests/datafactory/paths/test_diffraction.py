"""Edges before a radar: closed forms, exact lengths, Sionna's own wedge, and what must not diffract at all."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from edge_scenes import HOME, RADAR, WAVENUMBER, only_edge_at, shortest_over
from oracles import path_length
from scipy.special import fresnel
from sionna_scenes import (
    FREQUENCY_HZ,
    MATERIALS,
    WAVELENGTH_M,
    channel,
    every_one,
    everything,
    plate,
    scene_of,
    sionna_scene,
    slabs,
    view_of,
    view_with,
)
from town_scenes import box

from datafactory.paths.diffraction import EdgeEchoes, field_over_edges, rays_over_edges
from datafactory.paths.edges import edges_of
from datafactory.paths.facets import TAPER, reflected_share
from datafactory.paths.geometry import clear_between
from datafactory.paths.merged_scene import MergedScene
from datafactory.paths.mirrors import single_mirrors
from datafactory.paths.slabs import Slabs
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import DIFFRACTED, ScatteredPaths, SpecularPaths
from datafactory.paths.view import polarization_axis
from datafactory.scenes.poses import Pose

pytestmark = pytest.mark.usefixtures("variant")


def echoes(*objects, sight=everything, pose=HOME, **options):
    of = scene_of(*objects)
    return edge_echoes(edges_of(of).seen_from(pose), slabs(of), sight, **options)


def edge_echoes(edges, slabs, sight, feet=(), **options):
    """:param feet: where mirrors have the feet of the perpendiculars from the radar"""
    mirrors = np.zeros(len(feet), dtype=np.int64), np.array(feet, dtype=float).reshape(-1, 3)
    return every_one(EdgeEchoes(view_with(slabs, sight, TraceSettings(**options), edges=edges, feet=mirrors)))


def upright_edge(x=10.0, y=0.0, half=50.0, of="metal", length=30.0, turned=0.0):
    """A sheet whose rim at (x, y) stands upright; it lies to the left of it, away from the radar by ``turned``."""
    along = 0.5 * length * np.array([np.sin(turned), np.cos(turned), 0.0])
    return plate("sheet", np.array([x, y, 0.0]) + along, along, (0.0, 0.0, half), of)


def keller(angle: float, sign: float) -> float:
    """|D| of a metal half plane seen back along the ray, without its transition: Keller 1962."""
    return abs(1.0 + sign / np.cos(angle)) / (2.0 * np.sqrt(2.0 * np.pi * WAVENUMBER))


@pytest.mark.parametrize(("polarization", "sign"), [("V", -1.0), ("H", 1.0)])
def test_an_upright_rim_has_kellers_backscatter(polarization, sign):
    """1e-3 is what the transition function leaves at k L = 8000 and 50 deg from the mirror direction."""
    turned = np.radians(50.0)
    scattered, specular, _ = echoes(upright_edge(turned=turned), polarization=(polarization,) * 2, finite_mirrors=False)
    near = np.argmin(np.linalg.norm(scattered.rx_point, axis=1))
    np.testing.assert_allclose(scattered.rx_point[near], [10.0, 0.0, 0.0], atol=1e-9)
    exact = WAVELENGTH_M / (4.0 * np.pi) * keller(0.5 * np.pi + turned, sign) / np.sqrt(2.0 * 10.0**3)
    assert abs(scattered.amplitude[near]) == pytest.approx(exact, rel=1.5e-2)
    assert scattered.kinds[near] == DIFFRACTED
    assert len(specular) == 0


def test_the_share_of_a_finite_edge_is_its_line_integral():
    """exp(-2jkr) summed along the edge against the endless one, phases from exact distances; errors of order 1/kh."""
    distance = 12.0
    step = np.sqrt(WAVELENGTH_M * distance)
    fine = np.linspace(-40.0 * step, 40.0 * step, 2_000_001)
    wave = np.exp(-2j * WAVENUMBER * (np.hypot(distance, fine) - distance))
    fade = np.exp(-((fine / (12.0 * step)) ** 2))  # ends the endless edge softly
    endless = (wave * fade).sum()
    for low, high in ((-4.0, 0.0), (-0.3, 0.9), (0.2, 1.5), (-2.0, -0.6)):
        part = (fine >= low * step) & (fine <= high * step)
        exact = (wave * part).sum() / endless
        line = plate("line", (distance, 5.0, 0.5 * (low + high) * step), (0.0, 5.0, 0.0),
                     (0.0, 0.0, 0.5 * (high - low) * step), "metal")  # fmt: skip
        rim = only_edge_at(edges_of(scene_of(line)), (distance, 0.0, 0.0))
        rays = rays_over_edges(rim, RADAR, RADAR, WAVELENGTH_M)
        delay = np.linalg.norm(rays.point[0]) - distance
        # The table adds the phase of the path over the point, which beyond an end is that end.
        assert rays.share[0] * np.exp(-2j * WAVENUMBER * delay) == pytest.approx(exact, abs=0.012)
        assert rays.at_end[0] == (low > 0.0 or high < 0.0)


@pytest.mark.parametrize(
    ("objects", "kind", "error_m"),
    [
        ((upright_edge(x=6.0, y=1.0),), ScatteredPaths, 1e-9),
        ((plate("s", (6.0, 0.0, 8.0), (0.0, 20.0, 0.0), (0.0, 0.0, 7.0), "metal"),), SpecularPaths, 1e-9),
        ((plate("s", (12.0, 8.0, -8.0), (0.0, 20.0, 20.0), (0.0, 8.0, -8.0), "metal"),), None, 0.25**2 / 24.0),
    ],
    ids=["upright", "level", "at 45 deg"],
)
def test_the_delay_law_is_that_of_the_edge(objects, kind, error_m):
    """TX and RX up to 0.25 m apart along y; between upright and level within the stated error."""
    of = scene_of(*objects)
    edges = edges_of(of).seen_from(HOME)
    nearest = rays_over_edges(edges, RADAR, RADAR, WAVELENGTH_M)
    edge = edges.take(nearest.edge[np.argmin(nearest.geometry.source_distance_m)][None])
    scattered, specular, _ = edge_echoes(edge, slabs(of), everything)
    path = scattered if len(scattered) else specular
    if kind:
        assert isinstance(path, kind)
    for y_tx, y_rx in ((0.0, 0.25), (-0.005, 0.09), (0.0, -0.25), (0.2, 0.2)):
        tx, rx = np.array([0.0, y_tx, 0.0]), np.array([0.0, y_rx, 0.0])
        assert path_length(path, tx, rx) == pytest.approx(shortest_over(edge, tx, rx), abs=error_m)


@pytest.mark.parametrize(("height", "beside"), [(5.0, 0.15), (10.0, 0.4), (20.0, 0.6)])
def test_beyond_the_end_of_an_edge_the_wave_comes_from_the_end(height, beside):
    """A level rim that begins beside the foot, against Fresnel's integral along it: the phase of elements at one place
    and at others."""
    half = 3.0
    of = scene_of(plate("s", (height, beside + half, 3.0), (0, half, 0), (0, 0, 2.0), "metal"))
    edges = edges_of(of).seen_from(HOME)
    rim = edges.take((np.abs(edges.start[:, 2] - 1.0) < 1e-9) & (np.abs(edges.end[:, 2] - 1.0) < 1e-9))
    path, images, _ = edge_echoes(rim, slabs(of), everything)
    assert (len(path), len(images)) == (1, 0)
    y = np.linspace(beside, beside + 2.0 * half, 200_001)
    fades = np.where(y > beside + half, np.cos(0.5 * np.pi * (y - beside - half) / half) ** 2, 1.0)

    def field(y_tx: float, y_rx: float) -> complex:
        length = np.sqrt(height**2 + 1.0 + (y - y_tx) ** 2) + np.sqrt(height**2 + 1.0 + (y - y_rx) ** 2)
        return np.sum(fades * np.exp(1j * WAVENUMBER * (length - 2.0 * np.hypot(height, 1.0))))

    for y_tx, y_rx in ((-0.05, 0.0), (0.05, 0.0), (-0.05, 0.045)):
        tx, rx = np.array([0.0, y_tx, 0.0]), np.array([0.0, y_rx, 0.0])
        longer = WAVENUMBER * (path_length(path, tx, rx) - path_length(path, RADAR, RADAR))
        off = np.angle(np.exp(1j * longer) * field(0.0, 0.0) / field(y_tx, y_rx)) / (2.0 * np.pi)
        assert abs(off) < 0.08, (y_tx, y_rx)


def test_motion_along_an_edge_changes_nothing_and_across_it_the_range():
    pose = Pose((0.0, 0.0, 0.0), velocity=(3.0, 0.0, 2.0))
    (path, _, _), (_, level, _) = (
        echoes(item, pose=pose)
        for item in (upright_edge(turned=0.5), plate("s", (6.0, 0.0, 8.0), (0.0, 20.0, 0.0), (0.0, 0.0, 7.0), "metal"))
    )
    np.testing.assert_allclose(path.rx_velocity[0], [-3.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(level.image_velocity[0], [-6.0, 0.0, -4.0], atol=1e-12)


def test_mirror_and_edge_together_are_as_before_inside_the_mirror():
    """A finite mirror's share and what the rim keeps beside it, against an endless mirror and the whole rim's wave.

    Physical optics and the uniform theory agree near the mirror direction; within 6 Fresnel zones to 2 % of the mirror.
    """
    distance, mirror = 10.0, WAVELENGTH_M / (4.0 * np.pi * 20.0)
    for inside in (0.02, 0.1, 0.2, 0.33):
        of = scene_of(upright_edge(x=distance, y=-inside))
        # The endless mirror less the rim's wave, which paths.facets fades out with distance; phases of the path table.
        zones = 2.0 * inside**2 / (WAVELENGTH_M * distance)
        sine, cosine = fresnel(np.sqrt(2.0 * zones))
        missing = ((0.5 - cosine) + 1j * (0.5 - sine)) / (1.0 + 1j)
        share = 1.0 - missing * np.exp(-zones / TAPER)
        theirs = reflected_share(of, np.array([0]), np.array([[distance, 0.0, 0.0]]),
                                 np.array([[1.0, 0.0, 0.0]]), np.array([distance]), np.array([distance]),
                                 WAVELENGTH_M)[0]  # fmt: skip
        assert abs(theirs) == pytest.approx(abs(share), rel=0.01)
        rim = only_edge_at(edges_of(of), (distance, -inside, 0.0))
        delay = np.exp(2j * WAVENUMBER * (np.hypot(distance, inside) - distance))
        whole, rest = (
            edge_echoes(rim, slabs(of), everything, [(distance, 0.0, 0.0)], finite_mirrors=ends)[0].amplitude[0]
            for ends in (False, True)
        )
        # Metal reflects with -1 (V on an upright wall: TE).
        assert -share * mirror + rest * delay == pytest.approx(-mirror + whole * delay, abs=0.02 * mirror)
        assert abs(rest) < abs(whole)


@pytest.mark.parametrize("turned_deg", [0.0, 0.3, 0.6, 0.9, 1.5, 2.5])
def test_a_small_plate_is_its_edges_beside_its_mirror_direction(turned_deg):
    """26 wavelengths at 30 m, whose echo has its first null at 1.1 deg: against Kirchhoff's integral over it.

    Where the foot lies beyond the plate both rims send in full, though the far one has it on the side of the face.
    """
    turned, half, distance = np.radians(turned_deg), 13.0 * WAVELENGTH_M, 30.0
    across, up = half * np.array([np.sin(turned), np.cos(turned), 0.0]), np.array([0.0, 0.0, half])
    view = view_of(scene_of(plate("plate", (distance, 0.0, 0.0), across, up, "metal")), HOME)
    parts = [single_mirrors(view)[0], *every_one(EdgeEchoes(view))[:2]]
    total = sum((part.amplitude * np.exp(2j * WAVENUMBER * (part.range_m() - distance))).sum() for part in parts)
    place = (np.arange(400) + 0.5) / 200.0 - 1.0
    far = np.linalg.norm([distance, 0.0, 0.0] + place[:, None, None] * across + place[::8, None] * up, axis=2)
    field = (np.exp(2j * WAVENUMBER * (far - distance)) / far**2).mean()
    exact = np.cos(turned) * abs(field) * 4.0 * half**2 / (4.0 * np.pi)
    assert 20.0 * np.log10(abs(total) / exact) == pytest.approx(0.0, abs=0.15)


UPRIGHT, ASIDE = np.array([0.0, 0.0, 3.0]), np.array([0.0, 1.0, 0.0])
ENDS = {
    "plate": (plate("plate", (5.0, 3.0, 0.0), 3.0 * ASIDE, UPRIGHT, "metal"), 6.0),
    "box": (box("box", (5.0, 0.0, -3.0), (11.0, 6.0, 3.0), "metal"), 6.0),
    "strip": (plate("strip", (5.0, 0.02, 0.0), 0.02 * ASIDE, UPRIGHT, "metal"), 0.04),
}
"""Faces 5 m ahead that begin at y = 0, and their widths."""
BESIDE_ZERO_M = (-0.05, -1e-3, -1e-6, -1e-7, -1e-9, 0.0, 1e-9, 1e-7, 1e-6, 1e-3, 0.01)


@pytest.mark.parametrize("polarization", ["V", "H"])
@pytest.mark.parametrize("name", ENDS)
def test_before_the_end_of_a_face_mirror_and_edges_are_together_its_field(name, polarization):
    """Against Fresnel's integral over the face, with the radar on both sides of the end and straight before it.

    Half of a whole mirror there, as wide faces have it. What is within rounding of the end changes by no more.
    """
    face, width = ENDS[name]
    of, full, levels_db = scene_of(face), WAVELENGTH_M / (4.0 * np.pi * 10.0), []
    for y in BESIDE_ZERO_M:
        view = view_of(of, Pose((0.0, y, 0.0)), TraceSettings(polarization=(polarization, polarization)))
        parts = [single_mirrors(view)[0], *every_one(EdgeEchoes(view))[:2]]
        heard = [(part.range_m() - 5.0, part.amplitude) for part in parts]
        # The back of the box, which is seen along its side within rounding of the end, is an echo of its own.
        total = sum((amplitude * np.exp(2j * WAVENUMBER * off))[off < 1.0].sum() for off, amplitude in heard)
        sine, cosine = fresnel(np.array([-y, width - y]) * 2.0 / np.sqrt(5.0 * WAVELENGTH_M))
        exact = full * abs(np.diff(cosine + 1j * sine)[0]) / np.sqrt(2.0)
        levels_db.append(float(20.0 * np.log10(abs(total) / exact)))
    assert np.abs(levels_db).max() < 0.25, levels_db


def test_hidden_edges_and_walls_that_go_on_in_another_mesh_are_silent():
    sheet = upright_edge(turned=0.3, half=1.0)
    free = scene_of(sheet)
    hidden = scene_of(sheet, plate("screen", (5.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 2.0), "metal"))
    # The same plane, from the rim to the right, its vertices nowhere near those of the sheet.
    back = np.array([-np.sin(0.3), -np.cos(0.3), 0.0])
    goes_on = scene_of(
        sheet, plate("more", np.array([10.0, 0.0, 0.0]) + 5.0 * back, 5.0 * back, (0.0, 0.0, 7.0), "metal")
    )
    found = []
    for of in (free, hidden, goes_on):
        sight = partial(clear_between, sionna_scene(of).mi_scene)
        rim = only_edge_at(edges_of(of), (10.0, 0.0, 0.0))
        paths, _, counts = edge_echoes(rim, slabs(of), sight)
        found.append((len(paths), counts["edge_rays_hidden"] > 0))
    assert found == [(1, False), (0, True), (0, True)]


def test_a_corner_seen_from_outside_diffracts_and_from_within_does_not():
    house = box("house", (5.0, -2.0, -3.0), (9.0, 2.0, 3.0), "metal")
    room = box("room", (-4.0, -4.0, -3.0), (4.0, 4.0, 3.0), "metal")
    of = scene_of(house)
    scattered, specular, counts = echoes(house, sight=partial(clear_between, sionna_scene(of).mi_scene))
    # The four edges of the near side; the radar stands inside the angle of those behind.
    np.testing.assert_allclose(np.sort(scattered.rx_point[:, 1]), [-2.0, 2.0])
    np.testing.assert_allclose(np.sort(specular.image[:, 2]), [-6.0, 6.0])
    assert counts == {"edge_rays": 4, "edge_rays_hidden": 0}
    inside = echoes(room)
    assert (len(inside[0]), len(inside[1])) == (0, 0)


def test_a_rough_face_reflects_less_at_its_rim_too():
    """Straight before the rim the reflected wave is nearly all of it: sqrt(1 - S^2) of the smooth one's."""
    edges = only_edge_at(edges_of(scene_of(upright_edge())), (10.0, 0.0, 0.0))
    smooth, rough = (
        edge_echoes(
            edges, Slabs([replace(MATERIALS["metal"], scattering_coefficient=s)], FREQUENCY_HZ), everything,
            finite_mirrors=False,
        )[0].amplitude[0]
        for s in (0.0, 0.6)
    )  # fmt: skip
    assert abs(rough) / abs(smooth) == pytest.approx(0.8, abs=0.005)


# One way over an edge.


def bistatic(of: MergedScene, tx, rx, polarization="V"):
    x, y, z = (float(value) for value in tx)
    edges = edges_of(of).seen_from(replace(HOME, position=(x, y, z)))
    observer = np.array(rx, dtype=float) - np.array(tx)
    rays = rays_over_edges(edges, RADAR, observer, WAVELENGTH_M)
    field = field_over_edges(
        edges, rays, slabs(of),
        polarization_axis(rays.inward, polarization), polarization_axis(rays.outward, polarization),
    )  # fmt: skip
    return edges, rays, field


@pytest.mark.parametrize("rx", [(-3.0, 8.0, 0.7), (2.0, 6.0, 0.3), (12.0, -2.0, 0.5), (20.0, 0.0, 0.0)])
def test_one_wedge_is_sionnas(rx):
    """Amplitude within 0.2 % of PathSolver(diffraction=True): a metal corner of which the TX sees both faces, V.

    Only there. With one face lit, Sionna 2.2.0 gives the faces coefficients of opposite signs (0.9 to 1.3 dB too much
    for V); and H gets the coefficient of V, although a metal face does not short that field. The eigenfunctions of the
    wedge in ``tests/shared/physics/test_wedge.py`` decide for ours in both cases.
    """
    of = scene_of(box("house", (5.0, 0.5, -40.0), (30.0, 40.0, 40.0), "metal"))
    tx = (0.0, -4.0, 0.0)
    amplitude, kinds = channel(sionna_scene(of), tx, rx, diffraction=True)
    theirs = np.abs(amplitude[(kinds == 8).any(axis=0)])
    _, rays, field = bistatic(of, tx, rx)
    ours = WAVELENGTH_M / (4.0 * np.pi) * np.abs(field)
    best = np.argmax(ours)
    np.testing.assert_allclose((rays.point[best] + tx)[:2], [5.0, 0.5], atol=1e-9)
    assert ours[best] == pytest.approx(theirs.max(), rel=2e-3)


@pytest.mark.parametrize("of", ["metal", "glass"])
@pytest.mark.parametrize("polarization", ["V", "H"])
def test_source_and_observer_may_change_places(of, polarization):
    house = scene_of(box("house", (5.0, 0.5, -40.0), (30.0, 40.0, 40.0), of))
    here, there = np.array([0.0, 4.0, 0.0]), np.array([12.0, -2.0, 0.7])
    (_, _, one), (_, _, two) = (bistatic(house, a, b, polarization) for a, b in ((here, there), (there, here)))
    assert np.abs(one).max() == pytest.approx(np.abs(two).max(), rel=1e-10)


def test_crossed_polarisations_hear_nothing_of_an_upright_edge():
    scattered, _, _ = echoes(upright_edge(turned=0.6), polarization=("V", "H"))
    assert len(scattered) > 0
    assert np.abs(scattered.amplitude).max() < 1e-15


def test_a_sheet_of_air_has_no_edges_and_glass_fainter_ones_than_metal():
    air, glass, metal = (
        np.abs(echoes(upright_edge(turned=0.4, of=of))[0].amplitude[0]) for of in ("air", "glass", "metal")
    )
    assert air < 1e-12 * metal
    assert 0.02 * metal < glass < metal
