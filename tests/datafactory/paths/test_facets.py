"""The finite mirror against the Fresnel integrals, the plate's cross section, and the geometry that edges come from."""

import itertools

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import fresnel
from sionna_scenes import MATERIALS

from datafactory.paths import facets, planes
from datafactory.paths.facets import reflected_share
from datafactory.paths.merged_scene import MergedMesh, MergedScene
from datafactory.paths.planes import Rim
from datafactory.paths.scattering import SURFACE_CELL_M, surface_phase

WAVELENGTH_M = 299_792_458.0 / 77.5e9
DISTANCE_M = 10.0
SCALE = np.sqrt(2.0 / DISTANCE_M / WAVELENGTH_M)


METAL = MATERIALS["metal"]


def mesh(vertices, triangles, velocity=(0.0, 0.0, 0.0)) -> MergedMesh:
    triangles = np.array(triangles, dtype=np.int32)
    return MergedMesh(
        METAL, np.array(velocity), np.array(vertices, float), triangles, np.zeros(len(triangles), np.int32)
    )


def plate(y: tuple[float, float], z: tuple[float, float]) -> MergedMesh:
    """A rectangle at x = DISTANCE_M."""
    corners = ((y[0], z[0]), (y[1], z[0]), (y[1], z[1]), (y[0], z[1]))
    return mesh([(DISTANCE_M, a, b) for a, b in corners], [(0, 1, 2), (0, 2, 3)])


def share(*meshes: MergedMesh, at=(DISTANCE_M, 0.0, 0.0), arrival=(1.0, 0.0, 0.0)) -> complex:
    one = np.array([DISTANCE_M])
    return reflected_share(
        MergedScene(meshes, ()), np.array([0]), np.array([at]), np.array([arrival]), one, one, WAVELENGTH_M
    )[0]


def fresnel_share(y: tuple[float, float], z: tuple[float, float]) -> complex:
    """Without taper: a product of two Fresnel integrals (Goodman, eq. 4-34)."""

    def one(low: float, high: float) -> complex:
        sine, cosine = fresnel(np.array([low, high]) * SCALE * np.sqrt(2.0))
        return complex(np.diff(cosine)[0], np.diff(sine)[0]) / np.sqrt(2.0)

    return -1j * one(*y) * one(*z)


@pytest.mark.parametrize("half_m", [0.003, 0.06])
@pytest.mark.parametrize("aside", [0.0, 0.4, 0.9])
def test_a_plate_within_a_few_zones_agrees_with_the_fresnel_integrals(half_m, aside):
    y, z = (-half_m * (1.0 - aside), half_m * (1.0 + aside)), (-half_m, half_m)
    # The taper takes rho^2 / TAPER off what lies at rho, and changes the plane's own integral by 1 / (pi TAPER).
    farthest = (half_m * SCALE) ** 2 * ((1.0 + aside) ** 2 + 1.0)
    bound = (2.0 * half_m * SCALE) ** 2 * (min(farthest / facets.TAPER, 1.0) + 1.0 / (np.pi * facets.TAPER))
    assert abs(share(plate(y, z)) - fresnel_share(y, z)) < bound


def test_a_plate_much_smaller_than_the_zone_has_the_plates_cross_section():
    side = 0.004
    expected = 4.0 * np.pi * side**4 / WAVELENGTH_M**2
    infinite = WAVELENGTH_M / (8.0 * np.pi * DISTANCE_M)
    amplitude = abs(share(plate((-side / 2, side / 2), (-side / 2, side / 2)))) * infinite
    sigma = amplitude**2 * (4.0 * np.pi) ** 3 * DISTANCE_M**4 / WAVELENGTH_M**2
    assert abs(10.0 * np.log10(sigma / expected)) < 0.01


def test_the_share_is_continuous_across_an_edge_and_fades_outside():
    offsets = np.linspace(-0.02, 0.02, 401)
    values = np.array([share(plate((offset, 9.0), (-9.0, 9.0))) for offset in offsets])
    assert np.abs(np.diff(values)).max() < 2.0 * SCALE * (offsets[1] - offsets[0])
    assert abs(share(plate((0.6, 9.0), (-9.0, 9.0)))) < 0.05


def test_pieces_with_shifted_joints_are_one_mirror():
    upper = [plate((-0.2, 0.0), (0.0, 0.1)), plate((0.0, 0.2), (0.0, 0.1))]
    lower = [plate((-0.2, 0.05), (-0.1, 0.0)), plate((0.05, 0.2), (-0.1, 0.0))]
    assert share(*upper, *lower) == pytest.approx(share(plate((-0.2, 0.2), (-0.1, 0.1))), abs=1e-9)


def boundary_of(scene: MergedScene, triangle: int) -> np.ndarray:
    """The slow way: every triangle is held against this one's plane, every edge against all others."""
    normal, origin = scene.normals[triangle], scene.corners[triangle, 0]
    body = [scene.meshes[mesh].rigid_body for mesh in scene.mesh_of_triangle]
    edges = []
    for corners, other, own in zip(scene.corners, scene.normals, body, strict=True):
        flat = np.abs((corners - origin) @ normal).max() < planes.COPLANAR_M
        if own == body[triangle] and flat and abs(other @ normal) > planes.COPLANAR_COSINE:
            turned = corners[::-1] if other @ normal < 0.0 else corners
            edges += [np.stack([turned[k], turned[(k + 1) % 3]]) for k in range(3)]
    grid = [tuple(map(tuple, np.rint(edge / 1e-4).astype(int))) for edge in edges]
    free = {grid[n]: edges[n] for n in range(len(edges)) if grid[n][::-1] not in grid}
    return np.array(list(free.values()))


def test_the_boundary_of_a_plane_is_found_once_and_is_that_of_each_of_its_triangles(generator, monkeypatch):
    """Tiles of a floor wound either way, doubled ones, a hole, a step of 1.5 mm, a wall, and a tile that moves."""
    tiles = [
        (x, y, 0.0 if (x, y) != (4, 4) else 1.5e-3)
        for x in range(6)
        for y in range(5)
        if (x, y) not in ((2, 2), (3, 1))
    ]
    floor = []
    for x, y, z in [*tiles, tiles[3], tiles[8]]:
        square = [(x, y, z), (x + 1, y, z), (x + 1, y + 1, z), (x, y + 1, z)]
        turned = generator.random() < 0.5
        floor.append(mesh(square, [[0, 2, 1], [0, 2, 3]] if turned else [[0, 1, 2], [0, 3, 2]]))
    wall = mesh([(0, 0, 0), (6, 0, 0), (6, 0, 3), (0, 0, 3)], [[0, 1, 2], [0, 2, 3]])
    moving = mesh([(2, 2, 0), (3, 2, 0), (3, 3, 0), (2, 3, 0)], [[0, 1, 2], [0, 2, 3]], velocity=(1.0, 0.0, 0.0))
    scene = MergedScene((*floor, wall, moving), ())
    found: list[int] = []
    slow = planes.free_edges

    def counted(triangles: np.ndarray) -> np.ndarray:
        found.append(len(triangles))
        return slow(triangles)

    monkeypatch.setattr(planes, "free_edges", counted)
    for triangle in range(len(scene.normals)):
        rim, _, normals, _ = facets._rims_of_each(scene, np.array([triangle]))
        away = normals[0] @ scene.normals[triangle] < 0.0
        expected, edges = boundary_of(scene, triangle), rim.edges[:, ::-1] if away else rim.edges

        def sorted_rows(of: np.ndarray) -> np.ndarray:
            rows = np.rint(of.reshape(-1, 6) / 1e-6)
            return rows[np.lexsort(rows.T)]

        np.testing.assert_array_equal(sorted_rows(edges), sorted_rows(expected))
    assert len(found) == 4  # floor, step, wall and the tile that moves


@pytest.mark.parametrize("height", [1e-9, 0.3, 6.0])
@pytest.mark.parametrize("end", [0.05, 1.4, 1.6, 40.0])
def test_the_edge_integral_agrees_with_quadrature(height, end):
    def integrand(u: float) -> complex:
        square = height**2 + u**2
        return height / square * (1.0 - np.exp(-facets.RATE * square))

    edges = np.linspace(0.0, end, max(2, int(end * 10)))
    parts = [quad(integrand, low, high, complex_func=True)[0] for low, high in itertools.pairwise(edges)]
    assert abs(facets._integral_from_foot(height, end) - sum(parts)) < 2.0 * np.pi * 2e-4


def test_a_surface_cell_keeps_its_phase_and_neighbours_have_their_own():
    generator = np.random.default_rng(1)
    corner = np.floor(generator.uniform(-1e3, 1e3, (4000, 3)) / SURFACE_CELL_M) * SURFACE_CELL_M
    inside, elsewhere = corner + 0.3 * SURFACE_CELL_M, corner + 0.6 * SURFACE_CELL_M
    index = generator.integers(0, 9, 4000)
    phase = surface_phase(inside, index)
    np.testing.assert_array_equal(phase, surface_phase(elsewhere, index))
    for other in (
        surface_phase(inside + np.array([SURFACE_CELL_M, 0.0, 0.0]), index),
        surface_phase(inside, index + 1),
    ):
        assert abs(np.mean(np.exp(1j * (phase - other)))) < 4.0 / np.sqrt(4000)
    assert abs(np.mean(np.exp(1j * phase))) < 4.0 / np.sqrt(4000)
    assert phase.min() >= 0.0
    assert phase.max() < 2.0 * np.pi


def along_edges(edges: np.ndarray) -> tuple[complex, float]:
    """The slow way, with the angle of every edge [E, 2, 2] by itself."""
    total, turned = 0.0j, 0.0
    for (ax, ay), (bx, by) in edges:
        (tx, ty), cross, dot = (bx - ax, by - ay) / np.hypot(bx - ax, by - ay), ax * by - ay * bx, ax * bx + ay * by
        start, stop, size = ax * tx + ay * ty, bx * tx + by * ty, abs(ax * ty - ay * tx)
        angle = np.arctan2(cross, dot)
        nearest = size**2 + (0.0 if start * stop < 0.0 else min(start**2, stop**2))
        ends = [facets._integral_from_foot(size, end) for end in (stop, start)]
        total += angle if nearest > facets.CUT else np.sign(cross) * (ends[0] - ends[1])
        turned += angle
    return total, turned


@pytest.mark.parametrize("spread", [1.0, 100.0])
@pytest.mark.parametrize("winding", [-3, 0, 1, 4])
def test_the_angles_of_far_edges_add_up_whatever_the_turns_and_whether_they_close(generator, spread, winding):
    """Up to 400 edges: a polygon of many turns around or beside the point, then edges that belong to none."""
    steps = np.linspace(0.0, 2.0 * np.pi * (winding or 1), 301)
    centre = np.array([0.0 if winding else 6.0, 1.0])
    corners = spread * (
        centre + np.stack([np.cos(steps), np.sin(steps)], axis=1) * generator.uniform(2.0, 4.0, (301, 1))
    )
    alone = generator.normal(scale=10.0 * spread, size=(99, 2, 2))
    edges = np.concatenate([np.stack([corners[:-1], corners[1:]], axis=1), alone])
    in_space = np.concatenate([edges, np.zeros((*edges.shape[:2], 1))], axis=2)
    total, turned, through = facets._along_edges(in_space, np.zeros(3), np.eye(3)[0], np.eye(3)[1])
    slow_total, slow_turned = along_edges(edges)
    assert not through
    assert abs(total - slow_total) < 1e-9
    assert abs(turned - slow_turned) < 1e-9


@pytest.mark.parametrize(
    ("y", "z", "expected"),
    [((-9.0, 9.0), (-9.0, 9.0), 1.0), ((0.0, 9.0), (-9.0, 9.0), 0.5), ((0.0, 9.0), (0.0, 9.0), 0.25)],
)
def test_whole_plane_edge_and_corner(y, z, expected):
    assert share(plate(y, z)) == pytest.approx(expected, abs=1e-6)


def test_far_stretches_of_a_rim_count_as_their_chords(generator: np.random.Generator) -> None:
    """A floor with a jagged outline of 300 edges and a hole, against the integral along every edge."""
    angle = 2.0 * np.pi * np.arange(300) / 300
    outline = (20.0 + 2.0 * (np.arange(300) % 2) + generator.uniform(0.0, 1.0, 300)) * np.exp(1j * angle)
    hole = 3.0 * np.exp(-2j * np.pi * np.arange(40) / 40) + 8.0
    edges = np.concatenate([np.stack([loop, np.roll(loop, -1)], axis=1) for loop in (outline, hole)])
    edges = np.stack([edges.real, edges.imag, np.zeros(edges.shape)], axis=2)[generator.permutation(len(edges))]
    vertices, ends = np.unique(edges.reshape(-1, 3), axis=0, return_inverse=True)
    rim = Rim.of(vertices, ends.reshape(-1, 2))
    assert len(rim.radius) < len(edges) / 8
    for seen in (rim, Rim.joined([rim, rim])):
        assert sum(np.diff(seen.begins)) == len(seen.edges)
        for first, last in itertools.pairwise(seen.begins):
            assert np.abs(seen.edges[first + 1 : last, 0] - seen.edges[first : last - 1, 1]).max(initial=0.0) < 1e-9
    one, buffer = np.array([[0, len(rim.radius)]]), np.empty_like(rim.edges)
    places = [*np.c_[generator.uniform(-25.0, 25.0, (60, 2)), np.zeros(60)], *(edges[:20].mean(axis=1) + 1e-3)]
    for point in places:
        slope = generator.uniform(0.05, 1.0)
        arrival = np.array([np.sqrt(1.0 - slope**2), 0.0, -slope])
        scale = np.array([SCALE])
        share = facets._mirror_shares(
            rim, one, point[None], arrival[None], np.array([[0.0, 0.0, 1.0]]), np.zeros(1, dtype=np.int64), scale
        )[0]
        total, turned, _ = facets._along_edges(
            edges, point, np.array([slope, 0.0, 0.0]) * SCALE, np.array([0.0, SCALE, 0.0])
        )
        assert share == pytest.approx(total / max(turned, 2.0 * np.pi), abs=1e-9)
        assert facets._as_seen(rim, one[0], point, 1.0, buffer) < len(edges) / 2
