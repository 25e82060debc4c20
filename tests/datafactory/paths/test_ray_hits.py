"""What rays meet first: the numbers of shapes and triangles, distances, normals; and one kernel for all of them."""

from __future__ import annotations

import numpy as np
import pytest
from sionna_scenes import plate, scene_of, sionna_scene

from datafactory.paths.geometry import _lines, first_hits, mesh_of_shape, ray_margin_m
from datafactory.paths.unfold import unit

pytestmark = pytest.mark.usefixtures("variant")

TWO_WALLS = scene_of(
    plate("near", (5.0, 1.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), "metal"),
    plate("far", (9.0, 0.0, 0.0), (0.0, 3.0, 0.0), (0.0, 0.0, 3.0), "glass"),
)


def rays(count: int, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    towards = np.stack([np.full(count, 9.0), *generator.uniform(-4.0, 4.0, (2, count))], axis=1)
    return np.zeros((count, 3)), towards / np.linalg.norm(towards, axis=1, keepdims=True)


def test_the_first_of_two_walls_is_met_within_reach(generator):
    start, direction = rays(500, generator)
    reach = generator.uniform(4.0, 14.0, 500)
    geometry = sionna_scene(TWO_WALLS).mi_scene
    hits = first_hits(geometry, start, direction, reach)
    expected = np.full(500, np.inf)
    names = np.full(500, -1)
    for index, (x, y, half) in enumerate(((5.0, 1.0, 1.0), (9.0, 0.0, 3.0))):
        distance = x / direction[:, 0]
        at = distance[:, None] * direction
        met = (np.abs(at[:, 1] - y) < half) & (np.abs(at[:, 2]) < half) & (distance < np.minimum(reach, expected))
        expected[met], names[met] = distance[met], index
    np.testing.assert_array_equal(hits.valid, names >= 0)
    assert 0.1 < hits.valid.mean() < 0.9
    np.testing.assert_allclose(hits.distance[hits.valid], expected[hits.valid], rtol=1e-6)
    material = [part.material for part in TWO_WALLS.meshes]
    of_shape = mesh_of_shape(geometry)
    for number, name in enumerate(("metal", "glass")):
        here = hits.valid & (names == number)
        assert {material[of_shape[int(shape)]] for shape in hits.shape[here]} == {name}
    assert set(hits.primitive[hits.valid].tolist()) == {0, 1}
    without = first_hits(geometry, start, direction, reach, normals=False)
    for name in ("valid", "distance", "shape", "primitive"):
        np.testing.assert_array_equal(getattr(without, name)[hits.valid], getattr(hits, name)[hits.valid])
    np.testing.assert_allclose(np.abs(hits.normal[hits.valid, 0]), 1.0, atol=1e-6)


def test_lines_leave_their_ends_by_the_ray_casters_error(generator):
    """Float64, rounded to float32 last, byte for byte as the formula says; lines without a length among them."""
    start, end = generator.uniform(-80.0, 80.0, (2, 300, 3))
    start[:100], end[40] = 0.0, 0.0
    end[200] = start[200]
    first, direction, reach = _lines(start, end)
    length = np.linalg.norm(end - start, axis=1)
    towards = unit(end - start)
    ahead = 1e-4 + 2e-5 * np.linalg.norm(start, axis=1)
    left = length - ahead - ray_margin_m(np.linalg.norm(end, axis=1))
    np.testing.assert_array_equal(first, (start + ahead[:, None] * towards).T.astype(np.float32))
    np.testing.assert_array_equal(direction, towards.T.astype(np.float32))
    np.testing.assert_array_equal(reach, np.maximum(left, 0.0).astype(np.float32))


def test_all_that_is_read_of_a_cast_is_evaluated_in_one_kernel(generator):
    import drjit as dr  # not before the variant is chosen, and with it the LLVM that Dr.Jit loads

    geometry = sionna_scene(TWO_WALLS).mi_scene
    cast = (*rays(64, generator), np.full(64, np.inf))
    for normals in (True, False):
        first_hits(geometry, *cast, normals)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            first_hits(geometry, *cast, normals)
            assert len(dr.kernel_history((dr.KernelType.JIT,))) == 1
