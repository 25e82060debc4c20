"""Echoes scattered once and twice: patterns and powers against Sionna's and closed forms, in parts, through panes."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from path_tables import different_columns
from sionna_scenes import FREQUENCY_HZ, WAVELENGTH_M, mapping, material, plate, slab_transmission, slabs, view_of

from datafactory.paths import solver as solver_module
from datafactory.paths.arrivals import Arrivals, Echoes
from datafactory.paths.geometry import placed
from datafactory.paths.merged_scene import MergedScene, merge_scene
from datafactory.paths.rays import RayFan
from datafactory.paths.rows import mirror_normals, scattered_rows
from datafactory.paths.scattered import behind_panes, over_mirrors, scattered_twice
from datafactory.paths.scattering import has_lobes, share_at
from datafactory.paths.solver import Bundle, TraceSettings
from datafactory.paths.table import DIFFUSE, REFRACTED, SPECULAR, PathTable
from datafactory.paths.trace import trace
from datafactory.scenes.materials.reflectivity import fresnel_reflectivity, lambertian_sigma0
from datafactory.scenes.materials.table import Pattern
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import Scene, SceneObject
from shared.physics.units import power_to_db
from shared.physics.vectors import dots, unit

HERE = Pose((0.0, 0.0, 0.0))
ROUGHNESS = {"concrete": 0.6, "metal": 0.5, "lobed": 0.4, "glass": 0.0}
MATERIALS = mapping(
    material("concrete", 5.24, 1.38, 0.1, ROUGHNESS["concrete"]),
    material("metal", 1.0, 1e7, 0.1, ROUGHNESS["metal"]),
    material("lobed", 5.24, 1.38, 0.1, ROUGHNESS["lobed"], "backscattering"),
    material("glass", 6.31, 1.211, 0.006),
)

CORNER = (
    plate("ahead", (10.0, 0.0, 0.0), (1.0, 8.0, 0.0), (0.0, 0.0, 8.0), "concrete", velocity=(-3.0, 1.0, 0.0)),
    plate("side", (10.0, 6.0, 0.0), (10.0, 0.0, 0.0), (0.0, 1.0, 10.0), "metal"),
    plate("ground", (10.0, 0.0, -2.0), (12.0, 0.0, 0.3), (0.0, 12.0, 0.0), "lobed"),
)


def merged_of(*objects: SceneObject) -> MergedScene:
    return merge_scene(Scene("test", objects), MATERIALS)


pytestmark = pytest.mark.usefixtures("variant")


def once_of(*objects: SceneObject, rays: int, pose: Pose = HERE, fan: RayFan | None = None, **settings) -> list[Bundle]:
    merged = merged_of(*objects)
    chosen = TraceSettings(rays=rays, **{"depth": 1, "paths_a_cell": 0, **settings})
    first = Arrivals.first(view_of(merged, pose, chosen), fan or RayFan(rays))
    bundles = [group.thinned(1) for group in (first.echoes(), *over_mirrors(first))]
    if chosen.refraction:
        bundles[0] = Bundle.joined([bundles[0], behind_panes(first).thinned(1)])
    return bundles


def solved(*objects: SceneObject, rays: int, pose: Pose = HERE, **settings) -> Bundle:
    """The solver's own paths."""
    merged = merged_of(*objects)
    chosen = TraceSettings(rays=rays, solver_share=1, **settings)
    geometry = placed(merged, pose)
    scene = solver_module.radio_scene(geometry, slabs(merged), chosen)
    return solver_module.solve(scene, merged, chosen, RayFan(rays), 1)[0]


def chance_of(part: Bundle, merged: MergedScene) -> NDArray[np.float64]:
    """[n] probability with which the solver follows these bounces: 1 - S^2 a mirror, S^2 the diffuse one, last."""
    squared = np.concatenate([np.full(len(mesh.triangles), ROUGHNESS[mesh.material] ** 2) for mesh in merged.meshes])
    share = squared[part.triangles]
    return np.asarray(np.prod(np.where(part.interactions == DIFFUSE, share, 1.0 - share), axis=1))


def kind(bundle: Bundle, bounces: int) -> Bundle:
    """The paths with mirrors and then, as the last of so many bounces, a diffuse one."""
    part = bundle.take((bundle.interactions > 0).sum(axis=1) == bounces).cut(bounces)
    wanted = np.array([SPECULAR] * (bounces - 1) + [DIFFUSE])
    return part.take((part.interactions == wanted).all(axis=1))


def nearest(ours: Bundle, theirs: Bundle) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """For each of theirs the index of ours whose vertices are nearest, and how far [m]."""
    from scipy.spatial import cKDTree

    distance, index = cKDTree(ours.vertices.reshape(len(ours.vertices), -1)).query(
        theirs.vertices.reshape(len(theirs.vertices), -1)
    )
    return index, distance


@pytest.mark.parametrize("polarization", [("V", "V"), ("H", "H")])
def test_every_path_of_the_solver_is_found_with_its_amplitude(polarization):
    # The solver's rays scatter with a known probability; its amplitudes have the root of the inverse.
    settings = {"depth": 3, "polarization": polarization}
    once = once_of(*CORNER, rays=20_000, **settings)
    bundle = solved(*CORNER, rays=20_000, **settings)
    assert [part.interactions.shape[1] for part in once] == [1, 2, 3]
    for ours in once:
        theirs = kind(bundle, ours.interactions.shape[1])
        assert len(ours.amplitude) > 1.5 * len(theirs.amplitude) > 100
        index, distance = nearest(ours, theirs)
        # A ray within float32 of an edge may go either way. The solver's float32 vertices stray by centimetres after
        # two mirrors seen at a small angle, and its amplitudes by 4e-4.
        here = distance < 0.05
        assert here.mean() > 0.99
        index, theirs = index[here], theirs.take(here)
        expected = theirs.amplitude * np.sqrt(chance_of(theirs, merged_of(*CORNER)))
        bound = 1e-4 if ours.interactions.shape[1] == 1 else 1e-3
        error = np.abs(ours.amplitude[index] - expected) / np.abs(expected)
        assert np.percentile(error, 95) < bound
        assert np.sqrt(np.sum((error * np.abs(expected)) ** 2) / np.sum(np.abs(expected) ** 2)) < 10.0 * bound
        np.testing.assert_array_equal(ours.triangles[index], theirs.triangles)


def test_rings_on_a_plane_have_the_integrals_power():
    # Height h, the half plane ahead: lambda^2 / (4 pi)^3 int sigma0 / R^4 pi R dR, sigma0 = 4 S^2 |Gamma|^2 (h / R)^2.
    height, rays = 1.5, 200_000
    road = plate("road", (0.0, 0.0, -height), (300.0, 0.0, 0.0), (0.0, 300.0, 0.0), "metal")
    fan = RayFan(rays)
    (bundle,) = once_of(road, rays=rays, fan=fan)
    range_m = np.linalg.norm(bundle.vertices[:, 0], axis=1)
    power = np.abs(bundle.amplitude) ** 2 * fan.solid_angle_ratio(bundle.vertices[:, 0])
    edges = np.array([1.5, 2.0, 3.0, 5.0, 8.0, 13.0, 21.0, 34.0, 55.0])
    rings = np.histogram(range_m, edges, weights=power)[0]
    ranges = np.linspace(edges[:-1], edges[1:], 2_001)
    gamma = fresnel_reflectivity(1.0, 1e7, FREQUENCY_HZ, np.arccos(height / ranges), "tm")
    sigma0 = lambertian_sigma0(ROUGHNESS["metal"], gamma, np.arccos(height / ranges))
    expected = WAVELENGTH_M**2 / (4.0 * np.pi) ** 3 * np.trapezoid(sigma0 / ranges**3 * np.pi, ranges, axis=0)
    np.testing.assert_allclose(10.0 * np.log10(rings / expected), 0.0, atol=0.05)


def test_points_lie_on_their_planes_to_float64_far_from_the_scenes_origin():
    shift = np.array([5e5, -5e5, 100.0])
    there = tuple(replace(item, vertices=item.vertices + shift) for item in CORNER)
    pose = Pose((1.0, 0.5, 0.2), yaw_deg=20.0)
    far = replace(pose, position=tuple(np.array(pose.position) + shift))
    one, other = (once_of(*scene, pose=p, rays=3_000)[0] for scene, p in ((CORNER, pose), (there, far)))
    assert len(one.amplitude) == len(other.amplitude) > 1000
    np.testing.assert_allclose(one.vertices, other.vertices, atol=1e-7)  # the shifted vertices have 6e-11 m a digit
    for bundle, scene, seen in ((one, CORNER, pose), (other, there, far)):
        corners = np.concatenate([mesh.vertices[mesh.triangles] for mesh in merged_of(*scene).meshes])
        first, second, third = np.moveaxis(corners[bundle.triangles[:, 0]] - np.asarray(seen.position), 1, 0)
        normal = np.cross(second - first, third - first)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        world = bundle.vertices[:, 0] @ seen.rotation().T
        assert np.abs(np.einsum("ki,ki->k", normal, world - first)).max() < 1e-9


def test_what_stands_behind_a_pane_is_heard_through_it_twice():
    pane = plate("pane", (5.0, 0.0, 0.0), (0.0, 20.0, 0.0), (0.0, 0.0, 20.0), "glass")
    wall = plate("wall", (8.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 2.0), "concrete")
    open_air = once_of(wall, rays=5_000)[0]
    behind = once_of(pane, wall, rays=5_000, refraction=True)[0]
    np.testing.assert_allclose(behind.vertices, open_air.vertices, atol=1e-4)
    assert set(behind.crossings) == {2}
    assert once_of(pane, wall, rays=5_000)[0].amplitude.size == 0
    # At the radar's height the plane of incidence is level, and theta^ stands across it: TE.
    direction = behind.vertices[:, 0] / np.linalg.norm(behind.vertices[:, 0], axis=1)[:, None]
    level = np.abs(direction[:, 2]) < 0.01
    te, _ = slab_transmission(6.31, 1.211, 0.006, FREQUENCY_HZ, direction[level, 0])
    ratio = behind.amplitude[level] / open_air.amplitude[level]
    np.testing.assert_allclose(np.abs(ratio), np.abs(te) ** 2, rtol=0.02)
    assert level.sum() > 50
    few, many = (
        np.sum(np.abs(once_of(pane, wall, rays=n, refraction=True)[0].amplitude) ** 2) for n in (4_000, 16_000)
    )
    assert 10.0 * np.log10(many / few) == pytest.approx(0.0, abs=0.3)


CANYON = (
    plate("left", (20.0, 6.0, 3.0), (25.0, 0.0, 0.0), (0.0, 0.0, 6.0), "concrete"),
    plate("right", (20.0, -6.0, 3.0), (25.0, 0.0, 0.0), (0.0, 0.0, 6.0), "concrete"),
    plate("road", (20.0, 0.0, -1.5), (25.0, 0.0, 0.0), (0.0, 6.0, 0.0), "concrete"),
)
HALL = (
    plate("left", (10.0, 6.0, 0.0), (12.0, 0.0, 0.0), (0.0, 0.0, 4.0), "lobed"),
    plate("right", (10.0, -6.0, 0.0), (12.0, 0.0, 0.0), (0.0, 0.0, 4.0), "concrete"),
    plate("ceiling", (10.0, 0.0, 4.0), (12.0, 0.0, 0.0), (0.0, 6.0, 0.0), "lobed"),
    plate("end", (20.0, 0.0, 0.0), (0.0, 6.0, 0.0), (0.0, 0.0, 4.0), "metal"),
)
SHOP = (
    *CORNER,
    plate("pane", (6.0, -2.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), "glass"),
    plate("behind", (8.0, -2.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), "metal"),
)
EVERY = TraceSettings(solver_share=1, twice_share=1, paths_a_cell=0, depth=2)


def first_hits(objects: tuple[SceneObject, ...], settings: TraceSettings, fan: RayFan) -> Arrivals:
    merged = merged_of(*objects)
    return Arrivals.first(view_of(merged, HERE, settings), fan)


def powers(bundle: Bundle, fan: RayFan) -> float:
    return float(np.sum(np.abs(bundle.amplitude) ** 2 * fan.solid_angle_ratio(bundle.vertices[:, 0])))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("objects", "polarization"),
    [(CORNER, ("V", "V")), (CORNER, ("H", "H")), (CANYON, ("V", "V")), (HALL, ("V", "V"))],
    ids=["corner", "corner, level", "canyon", "hall"],
)
def test_power_is_sionnas_own(objects, polarization):
    rays, merged = 2_000_000, merged_of(*objects)
    settings = replace(EVERY, rays=rays, polarization=polarization)
    geometry = placed(merged, HERE)
    scene = solver_module.radio_scene(geometry, slabs(merged), settings)
    ours, theirs = 0.0, 0.0
    for seed in (1, 2):
        fan = RayFan(rays, (0.37 * seed, 0.11 * seed))
        (twice,) = scattered_twice(first_hits(objects, settings, fan), seed)
        ours += float(twice.power.sum())
        solved = solver_module.solve(scene, merged, settings, fan, seed)[0].of_bounces(2)
        theirs += powers(solved.take((solved.interactions == DIFFUSE).all(axis=1)), fan)
    assert power_to_db(ours / theirs) == pytest.approx(0.0, abs=0.2)


def test_three_bounces_are_followed_in_all_their_orders():
    settings = replace(EVERY, rays=20_000, depth=3)
    fan = RayFan(20_000)
    found = {group.kinds: group.thinned(1) for group in scattered_twice(first_hits(CORNER, settings, fan), 1)}
    two, three = (DIFFUSE, DIFFUSE), {(DIFFUSE, DIFFUSE, DIFFUSE), (DIFFUSE, SPECULAR, DIFFUSE), (1, 2, 2)}
    assert set(found) == {two, *three}
    assert min(len(part.amplitude) for part in found.values()) > 1_000
    # Each bounce more costs as much as a surface keeps to itself.
    assert all(powers(found[kinds], fan) < powers(found[two], fan) for kinds in three)
    mirrors_off = first_hits(CORNER, replace(settings, specular=False), fan)
    assert {group.kinds for group in scattered_twice(mirrors_off, 1)} == {two, (2, 2, 2)}


def unfolded_m(
    part: Bundle, velocities: NDArray[np.float64], kinds: tuple[int, ...], time_s: float
) -> NDArray[np.float64]:
    """[n] lengths of the paths when the surfaces at their bounces have moved on, mirrors as planes."""
    length, last = np.zeros(len(part.vertices)), np.zeros((len(part.vertices), 3))
    normals = mirror_normals(part.vertices)
    for step, kind in enumerate(kinds):
        here = part.vertices[:, step] + time_s * velocities[:, step]
        if kind == DIFFUSE:
            length, last = length + np.linalg.norm(here - last, axis=1), here
        else:
            last = last + 2.0 * np.sum((here - last) * normals[:, step], axis=1)[:, None] * normals[:, step]
    return length + np.linalg.norm(last, axis=1)


@pytest.mark.parametrize("kinds", [(2, 2), (1, 2), (1, 2, 2), (2, 2, 2), (2, 1, 2)])
def test_the_length_between_bounces_changes_as_their_surfaces_move(kinds):
    speeds = ((-3.0, 1.0, 0.0), (2.0, -6.0, 0.5), (0.0, 0.4, 3.0))
    moving = tuple(replace(item, velocity=speed) for item, speed in zip(CORNER, speeds, strict=True))
    merged, fan = merged_of(*moving), RayFan(20_000)
    view = view_of(merged, HERE, replace(EVERY, rays=20_000, depth=3))
    first = Arrivals.first(view, fan)
    groups = {group.kinds: group.thinned(1) for group in (*over_mirrors(first), *scattered_twice(first, 1))}
    part = groups[kinds]
    of = np.array(speeds)[merged.owner[part.triangles]]
    assert len(part.vertices) > 500
    (paths, *_), step_s = scattered_rows(part, view, fan), 1e-6
    rate = dots(unit(paths.tx_point), paths.tx_velocity) + dots(unit(paths.rx_point), paths.rx_velocity)
    before, now, after = (unfolded_m(part, of, kinds, time_s) for time_s in (-step_s, 0.0, step_s))
    np.testing.assert_allclose(2.0 * paths.range_m(), now, rtol=1e-9)
    np.testing.assert_allclose(rate + paths.between_rate_mps, (after - before) / (2.0 * step_s), atol=1e-4)


@pytest.mark.parametrize("depth", [2, 3])
def test_parts_are_the_whole(depth):
    settings = replace(EVERY, rays=20_000, depth=depth, twice_share=4)
    first = first_hits(CORNER, settings, RayFan(20_000))
    thin, rest = first.share(64), first.rest(64)
    assert 0 < len(thin.ray) < len(rest.ray) / 32
    parts = zip(scattered_twice(thin, 1), scattered_twice(rest, 1), strict=True)
    for whole, (some, others) in zip(scattered_twice(first, 1), parts, strict=True):
        joined = Echoes.joined([others, some]).by_ray()
        for item in ("amplitude", "power", "cell"):
            np.testing.assert_array_equal(getattr(joined, item), getattr(whole, item))
        one, other = joined.thinned(1), whole.thinned(1)
        for field in fields(Bundle):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


def test_a_share_of_the_rays_says_what_all_would():
    first = first_hits(CANYON, replace(EVERY, rays=400_000), RayFan(400_000))
    (whole,) = scattered_twice(first, 1)
    (some,) = scattered_twice(first.share(16), 1)
    assert power_to_db(16.0 * some.power.sum() / whole.power.sum()) == pytest.approx(0.0, abs=0.5)
    few, many = (
        scattered_twice(first_hits(CANYON, replace(EVERY, rays=400_000, twice_share=n), RayFan(400_000)), 1)[0]
        for n in (16, 1)
    )
    assert power_to_db(few.power.sum() / many.power.sum()) == pytest.approx(0.0, abs=0.5)
    assert len(few.power) == pytest.approx(len(many.power) / 16.0, rel=0.1)


def uncrossed(table: PathTable) -> tuple[PathTable, int]:
    """The table without the paths through panes, and how many those are."""
    scattered = table.scattered.take(np.flatnonzero((table.scattered.kinds & REFRACTED) == 0))
    specular = table.specular.take(np.flatnonzero((table.specular.kinds & REFRACTED) == 0))
    return replace(table, scattered=scattered, specular=specular), len(table) - len(scattered) - len(specular)


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_panes_change_no_path_that_does_not_cross_them(depth):
    settings = TraceSettings(rays=20_000, depth=depth, diffraction=True, corners=True)
    without, through = (
        trace(merged_of(*SHOP), HERE, FREQUENCY_HZ, replace(settings, refraction=on), RayFan(20_000), 1)
        for on in (False, True)
    )
    kept, crossing = uncrossed(through)
    assert crossing > 20
    assert uncrossed(without)[1] == 0
    # A candidate is a number in a list that is longer with panes.
    assert set(different_columns(kept, without)) <= {"scattered.candidate", "specular.candidate"}


def test_across_the_polarization_a_surface_scatters_nothing():
    crossed = once_of(*CORNER, rays=2_000, depth=1, polarization=("V", "H"))
    assert sum(len(part.amplitude) for part in crossed) == 0


NORMAL = np.array([0.0, 0.0, 1.0])


def share(pattern, arrival, departure):
    arrival, departure = np.broadcast_arrays(np.atleast_2d(arrival), np.atleast_2d(departure))
    turned = np.einsum("ki,ki->k", arrival, departure)
    lobes = has_lobes(pattern)
    return np.array(
        [share_at(lobes, -a @ NORMAL, d @ NORMAL, c) for a, d, c in zip(arrival, departure, turned, strict=True)]
    )


@pytest.mark.parametrize("pattern", ["lambertian", "backscattering"])
@pytest.mark.parametrize("angle_deg", [0.0, 20.0, 45.0, 70.0, 89.0])
def test_nothing_is_lost_and_nothing_won(pattern, angle_deg):
    # Gauss-Legendre in cos(theta), trapezoid in azimuth: exact for these polynomials to rounding.
    node, weight = np.polynomial.legendre.leggauss(40)
    cosine, azimuth = 0.5 * (node + 1.0), 2.0 * np.pi * np.arange(64) / 64
    c, a = (grid.ravel() for grid in np.meshgrid(cosine, azimuth, indexing="ij"))
    s = np.sqrt(1.0 - c**2)
    angle = np.radians(angle_deg)
    arrival = np.array([np.sin(angle), 0.0, -np.cos(angle)])
    values = share(pattern, arrival, np.stack([s * np.cos(a), s * np.sin(a), c], axis=1))
    total = (values.reshape(40, 64).mean(axis=1) * 2.0 * np.pi * 0.5 * weight).sum()
    assert total == pytest.approx(1.0, abs=1e-4)


def test_patterns_are_sionnas():
    import mitsuba as mi
    from sionna.rt.radio_materials.scattering_pattern import BackscatteringPattern, LambertianPattern

    random = np.random.default_rng(1)
    arrival, departure = random.normal(size=(2, 500, 3))
    arrival[:, 2], departure[:, 2] = -np.abs(arrival[:, 2]), np.abs(departure[:, 2])
    arrival, departure = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (arrival, departure))
    theirs: dict[Pattern, Any] = {"lambertian": LambertianPattern(), "backscattering": BackscatteringPattern(4, 4, 0.5)}
    for pattern, own in theirs.items():
        expected = own(mi.Vector3f(*arrival.T.astype(np.float32)), mi.Vector3f(*departure.T.astype(np.float32))).numpy()
        np.testing.assert_allclose(share(pattern, arrival, departure), expected, rtol=2e-5)
