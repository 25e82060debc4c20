"""Paths as lines: what the unfolded table says is drawn where the wave went."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from datafactory.paths.merged_scene import MergedMesh, MergedScene
from datafactory.paths.table import (
    CORNER,
    DIFFRACTED,
    DIFFUSE,
    REFRACTED,
    SPECULAR,
    TARGET,
    PathTable,
    ScatteredPaths,
    SpecularPaths,
)
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose
from datafactory.view.strongest import kinds_of, shown_paths, strongest
from datafactory.view.subject import DIFFRACTION, DIRECT, KINDS, MIRROR, REFRACTION, SEVERAL, RayCaster

NO_TARGETS = np.zeros((0, 3))
ORIGIN = np.zeros(3)
FLOAT32_M = 1e-5
"""Error of a place that a ray meets within 30 m."""


def wall(corner: tuple[float, float], along: tuple[float, float], length: float) -> MergedMesh:
    """An upright wall from a corner (x, y), 20 m high."""
    foot, end = np.array(corner), np.array(corner) + length * np.array(along)
    corners = np.array([[*foot, -10.0], [*end, -10.0], [*end, 10.0], [*foot, 10.0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    return MergedMesh(
        load_materials().materials["concrete"], np.zeros(3), corners, triangles, np.zeros(2, dtype=np.int32)
    )


AHEAD = wall((10.0, -30.0), (0.0, 1.0), 60.0)
"""x = 10 m."""


def caster(*meshes: MergedMesh) -> RayCaster:
    return RayCaster(MergedScene(meshes, ("wall",)), Pose((0.0, 0.0, 0.0)))


Place = Sequence[float] | np.ndarray


def scattered(
    tx_point: Place, rx_point: Place, kinds: int, between_m: float = 0.0, depth: int = 1, owner: int = 0
) -> ScatteredPaths:
    point, still = np.array([tx_point], float), np.zeros((1, 3))
    path = ScatteredPaths.of_points(point, still, 1e-6, np.full(1, owner, np.int32), kinds, depth)
    return replace(path, rx_point=np.array([rx_point], float), between_m=np.full(1, between_m))


def specular(image: Place, depth: int, kinds: int = SPECULAR) -> SpecularPaths:
    place, owner = np.array([image], float), np.zeros(1, np.int32)
    return SpecularPaths.of(place, np.zeros((1, 3)), np.eye(3)[None], np.array([1e-6 + 0j]), owner, kinds, depth)


def only_line(table: PathTable, meshes: tuple[MergedMesh, ...], targets: np.ndarray = NO_TARGETS) -> np.ndarray:
    shown = shown_paths(table, caster(*meshes), targets)
    assert shown.not_drawn == 0
    (path,) = shown.paths
    return path.points


def test_a_single_bounce_goes_out_and_back():
    table = PathTable(scattered([4.0, 3.0, -0.5], [4.0, 3.0, -0.5], DIFFUSE), objects=("road",))
    np.testing.assert_allclose(only_line(table, (AHEAD,)), [[0.0, 0.0, 0.0], [4.0, 3.0, -0.5], [0.0, 0.0, 0.0]])


def test_a_leg_over_a_mirror_meets_it_where_the_image_is_seen():
    """Scattering point (4, 3, 0), its image in x = 10 is (16, 3, 0): the leg turns at x = 10, y = 3 * 10 / 16."""
    turn, point = [10.0, 1.875, 0.0], [4.0, 3.0, 0.0]
    table = PathTable(scattered([16.0, 3.0, 0.0], point, SPECULAR | DIFFUSE, depth=2), objects=("wall",))
    line = only_line(table, (AHEAD,))
    np.testing.assert_allclose(line, [[0.0, 0.0, 0.0], turn, point, [0.0, 0.0, 0.0]], atol=FLOAT32_M)
    assert np.linalg.norm(np.diff(line, axis=0), axis=1).sum() == pytest.approx(np.hypot(16.0, 3.0) + 5.0, abs=1e-5)
    reverse = PathTable(table.scattered.reversed(), objects=("wall",))
    np.testing.assert_allclose(only_line(reverse, (AHEAD,)), line[::-1], atol=FLOAT32_M)


def test_a_leg_that_does_not_end_where_the_other_begins_is_not_drawn():
    """The table says a mirror at x = 10 m; the scene has it at x = 11 m."""
    table = PathTable(scattered([16.0, 3.0, 0.0], [4.0, 3.0, 0.0], SPECULAR | DIFFUSE, depth=2), objects=("wall",))
    shown = shown_paths(table, caster(wall((11.0, -30.0), (0.0, 1.0), 60.0)), NO_TARGETS)
    assert (shown.paths, shown.not_drawn, shown.found[SEVERAL]) == ((), 1, 1)


def test_two_mirrors_by_reflections_of_the_origin():
    """Walls that meet at 75 deg in (12, 6): the sensor's image in one, and of that in the other (Householder)."""
    edge, angle = np.array([12.0, 6.0, 0.0]), np.radians(-165.0)
    along = np.array([np.cos(angle), np.sin(angle), 0.0])
    normals = [np.array([1.0, 0.0, 0.0]), np.array([-along[1], along[0], 0.0])]
    image = ORIGIN
    for normal in normals:
        image = image - 2.0 * normal * float(normal @ (image - edge))
    none = scattered([1.0, 0.0, 0.0], [1.0, 0.0, 0.0], DIFFUSE).take(np.zeros(0, int))
    walls = (wall((12.0, -30.0), (0.0, 1.0), 36.0), wall((12.0, 6.0), (along[0], along[1]), 30.0))
    line = only_line(PathTable(none, specular(image, 2)), walls)
    assert len(line) == 4
    np.testing.assert_allclose(line[[0, -1]], 0.0, atol=1e-3)
    # The RX sees the second mirror first.
    for point, normal in zip(line[1:3], reversed(normals), strict=True):
        assert float(normal @ (point - edge)) == pytest.approx(0.0, abs=1e-4)
    assert np.linalg.norm(np.diff(line, axis=0), axis=1).sum() == pytest.approx(float(np.linalg.norm(image)), rel=1e-6)


@pytest.mark.parametrize("forms", [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_an_echo_round_a_corner_turns_at_the_edges(forms):
    """The table has a leg by the point on the edge and the rest of its length, or by a point at the whole length."""
    target, edges = np.array([9.0, 6.0, 0.2]), [np.array([6.0, 1.0, 0.1]), np.array([5.0, 2.0, 0.4])]
    points, between = [], 0.0
    for form, edge in zip(forms, edges, strict=True):
        rest = float(np.linalg.norm(target - edge))
        points.append(edge if form == 0 else edge * (1.0 + rest / np.linalg.norm(edge)))
        between += rest if form == 0 else 0.0
    path = scattered(points[0], points[1], DIFFRACTED | TARGET, between, depth=3, owner=1)
    line = only_line(PathTable(path, objects=("wall", "cyclist")), (AHEAD,), target[None])
    np.testing.assert_allclose(line, np.stack([ORIGIN, edges[0], target, edges[1], ORIGIN]), atol=1e-9)


def test_every_path_has_the_kind_of_its_rarest_interaction():
    parts = [
        scattered([1, 0, 0], [1, 0, 0], DIFFUSE), scattered([1, 0, 0], [1, 0, 0], TARGET),
        scattered([1, 0, 0], [1, 0, 0], SPECULAR | DIFFUSE, depth=2),
        scattered([1, 0, 0], [1, 0, 0], DIFFUSE | REFRACTED, depth=2), scattered([1, 0, 0], [1, 0, 0], DIFFRACTED),
        scattered([1, 0, 0], [1, 0, 0], DIFFRACTED | TARGET | REFRACTED, depth=3),
    ]  # fmt: skip
    table = PathTable(ScatteredPaths.joined(parts), specular([2.0, 0.0, 0.0], 1))
    assert kinds_of(table).tolist() == [DIRECT, DIRECT, SEVERAL, REFRACTION, DIFFRACTION, DIFFRACTION, MIRROR]


def test_every_kind_has_its_share_and_the_strongest_take_the_rest():
    kinds = np.array([DIRECT] * 90 + [MIRROR] * 5 + [SEVERAL] * 5)
    level = -np.arange(100.0)
    chosen = strongest(level, kinds, 50)
    assert len(chosen) == len(set(chosen.tolist())) == 50
    assert (np.diff(level[chosen]) < 0.0).all()
    assert {kind: int((kinds[chosen] == kind).sum()) for kind in KINDS} == {
        DIRECT: 40, MIRROR: 5, SEVERAL: 5, DIFFRACTION: 0, REFRACTION: 0,
    }  # fmt: skip
    assert chosen.tolist()[:40] == list(range(40))
    assert len(strongest(level[:3], kinds[:3], 50)) == 3


def test_scattered_paths_and_mirrors_stand_in_one_list():
    """The second of two scattered paths is the strongest, then the mirror, then the first."""
    paths = ScatteredPaths.joined(
        [scattered([2.0 + index, 0.0, 0.0], [2.0 + index, 0.0, 0.0], DIFFUSE, owner=index) for index in (0, 1)]
    )
    paths = replace(paths, amplitude=np.array([1e-8, 1e-5], dtype=complex))
    shown = shown_paths(PathTable(paths, specular([20.0, 0.0, 0.0], 1), ("road", "kerb")), caster(AHEAD), NO_TARGETS)
    assert [path.kind for path in shown.paths] == [DIRECT, MIRROR, DIRECT]
    assert [path.points[1, 0] for path in shown.paths] == pytest.approx([3.0, 10.0, 2.0], abs=FLOAT32_M)
    assert [round(path.level_db) for path in shown.paths] == [-100, -120, -160]
    assert [path.range_m for path in shown.paths] == [3.0, 10.0, 2.0]
    assert [path.object for path in shown.paths] == ["kerb", "road", "road"]


def test_a_curved_mirror_and_a_corner_are_met_where_they_stand():
    """A sphere, R = 8 m away, k = 0.1: S = 2 R / (1 + R k), p = (2 / k - S) u, b = 2 R - 2 / k."""
    sight, range_m, k = np.array([0.8, 0.6, 0.0]), 8.0, 0.1
    far = 2.0 * range_m / (1.0 + range_m * k)
    curved = scattered((2.0 / k - far) * sight, far * sight, SPECULAR, 2.0 * range_m - 2.0 / k)
    assert kinds_of(PathTable(curved)).tolist() == [MIRROR]
    line = only_line(PathTable(curved, objects=("ball",)), (AHEAD,))
    np.testing.assert_allclose(line, np.stack([ORIGIN, range_m * sight, ORIGIN]), atol=1e-9)
    none = curved.take(np.zeros(0, int))
    line = only_line(PathTable(none, specular([12.0, 6.0, 0.0], 2, CORNER), ("corner",)), (AHEAD,))
    np.testing.assert_allclose(line, np.stack([ORIGIN, [6.0, 3.0, 0.0], ORIGIN]), atol=1e-9)
