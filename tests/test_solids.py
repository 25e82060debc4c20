"""The measure that the scenes' tests rest on: what boxes of known places have in common."""

import numpy as np
import pytest
import trimesh
from solids import Shape, Standing, containing, intersecting

BOX = Shape.box((-0.5, -0.5, 0.0), (0.5, 0.5, 1.0))
QUARTER = np.array([(0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])

FAR = np.array([5e5, 5e6, 100.0])


def beside(x_m: float) -> list[Standing]:
    return [Standing("one", BOX, place=FAR), Standing("other", BOX, QUARTER, np.add(FAR, (x_m, 0.0, 0.0)))]


@pytest.mark.parametrize(("x_m", "shared_m"), [(1.5, 0.0), (1.0, 0.0), (0.995, 0.0), (0.9, 0.1), (0.5, 0.5)])
def test_neighbours_share_nothing_and_what_is_shared_has_its_thickness(x_m: float, shared_m: float) -> None:
    """2 V / A of a slab of thickness t and side 1 is t / (1 + 2 t)."""
    found = intersecting(beside(x_m))
    assert bool(found) == (shared_m > 0.0)
    if found:
        (pair,) = found
        assert pair == ("one", "other", pytest.approx(shared_m / (1.0 + 2.0 * shared_m), rel=1e-4))


def test_points_within_are_told_from_points_beside() -> None:
    things = beside(0.5)
    assert containing(things, np.add(FAR, (-0.4, 0.0, 0.5))) == ["one"]
    assert containing(things, np.add(FAR, (0.3, 0.2, 0.5))) == ["one", "other"]
    assert containing(things, np.add(FAR, (0.3, 0.2, 1.1))) == []
    ring = trimesh.creation.annulus(0.4, 0.5, 1.0)
    assert containing([Standing("ring", Shape.of(ring.vertices, ring.faces))], (0.0, 0.1, 0.2)) == []


def test_what_is_open_counts_with_its_hull() -> None:
    """Two halves of a ball with a gap between them, and a closed box wound inwards."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    side = np.abs(ball.triangles_center[:, 0]) > 0.3
    inwards = trimesh.creation.box(bounds=[(2.0, 0.0, 0.0), (3.0, 1.0, 1.0)])
    shape = Shape.around([(ball.vertices, ball.faces[side]), (inwards.vertices, inwards.faces[:, ::-1])])
    assert len(shape.parts) == 2
    assert sorted(part.volume() for part in shape.parts) == pytest.approx([1.0, ball.convex_hull.volume], rel=0.05)
    assert containing([Standing("both", shape)], (0.0, 0.1, 0.2)) == ["both"]
    assert containing([Standing("both", shape)], (2.5, 0.5, 0.5)) == ["both"]
