"""Random rooms, triangle soups and poses: what holds of every trace. One small trace costs a tenth of a second."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hardcases.tools import MATERIALS, MIRROR, not_finite_paths, rectangle, traced
from hypothesis import given, settings
from hypothesis import strategies as st

from datafactory.paths.rays import RayFan
from datafactory.paths.table import PathTable
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import SceneObject

pytestmark = pytest.mark.usefixtures("variant")

WAVELENGTH_M = 299_792_458.0 / 77.5e9
FEW = settings(max_examples=5)


class UnaimedFan(RayFan):
    """The same rays whatever the scene."""

    aimable = False


offsets = st.tuples(*[st.floats(-5e5, 5e5)] * 3)
angles = st.floats(-180.0, 180.0)


@st.composite
def rooms(draw: st.DrawFn) -> tuple[SceneObject, ...]:
    """A wall ahead, a wall to the left and the ground, each rough or a mirror, none closer than a metre."""
    ahead, left, below = draw(st.floats(4.0, 30.0)), draw(st.floats(2.0, 10.0)), draw(st.floats(1.0, 3.0))
    materials = [draw(st.sampled_from([MIRROR, "rough"])) for _ in range(3)]
    return (
        rectangle("ahead", (ahead, 0, 0), (0, 20, 0), (0, 0, 10), materials[0]),
        rectangle("left", (10, left, 0), (15, 0, 0), (0, 0, 10), materials[1]),
        rectangle("ground", (10, 0, -below), (20, 0, 0), (0, 20, 0), materials[2]),
    )


def power(paths: PathTable) -> float:
    """Sum of all paths' powers, as if they met by chance."""
    return float((np.abs(paths.scattered.amplitude) ** 2).sum() + (np.abs(paths.specular.amplitude) ** 2).sum())


def lengths(paths: PathTable) -> np.ndarray:
    return np.sort(2.0 * paths.specular.range_m())


@FEW
@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.floats(1e-3, 100.0))
def test_triangles_of_any_shape_give_finite_paths_and_the_same_twice(seed: int, count: int, size: float) -> None:
    """Soups around the radar, triangles through it among them."""
    generator = np.random.default_rng(seed)
    corners = generator.normal(size=(count, 1, 3)) * size + generator.normal(size=(count, 3, 3)) * size
    triangles = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    soup = SceneObject("soup", corners.reshape(-1, 3), triangles, str(generator.choice([MIRROR, "rough"])))
    once, again = (traced([soup], rays=3000, depth=2) for _ in range(2))
    assert not_finite_paths(once) == 0
    for kind in ("scattered", "specular"):
        for name in getattr(once, kind).__dataclass_fields__:
            assert getattr(getattr(once, kind), name).tobytes() == getattr(getattr(again, kind), name).tobytes()


@FEW
@given(rooms(), offsets, angles)
def test_scene_and_radar_moved_together_see_the_same(
    room: tuple[SceneObject, ...], offset: tuple[float, float, float], yaw_deg: float
) -> None:
    here = traced(room, rays=4000, depth=2)
    turn = Pose((0.0, 0.0, 0.0), yaw_deg).rotation()
    moved = [replace(item, vertices=item.vertices @ turn.T + np.array(offset)) for item in room]
    there = traced(moved, Pose(offset, yaw_deg), rays=4000, depth=2)
    np.testing.assert_allclose(lengths(there), lengths(here), atol=1e-4)
    assert abs(10.0 * np.log10(power(there) / power(here))) < 0.1


@FEW
@given(rooms(), st.sampled_from([0.5, 2.0, 4.0]))
def test_a_scene_of_another_size(room: tuple[SceneObject, ...], factor: float) -> None:
    """Lengths grow with the size; the power of plane walls, smooth or rough, falls with its square."""
    # Rays are aimed by the size of range cells, which do not grow with the scene: here the same ones are sent.
    fan = UnaimedFan(4000)
    plain = traced(room, rays=4000, fan=fan)
    scaled = traced([replace(item, vertices=item.vertices * factor) for item in room], rays=4000, fan=fan)
    np.testing.assert_allclose(lengths(scaled), factor * lengths(plain), rtol=1e-5)
    assert abs(10.0 * np.log10(power(scaled) / power(plain) * factor**2)) < 0.05


@FEW
@given(rooms())
def test_no_more_comes_back_than_a_lambertian_surface_can_return(room: tuple[SceneObject, ...]) -> None:
    """sigma0 <= 4 S^2 cos^2, so that from R_min on, over the front half space,

    P <= lambda^2 4 S^2 / (4 pi)^3 int cos(theta) / R^2 dOmega <= lambda^2 4 S^2 2 pi / ((4 pi)^3 R_min^2);

    a mirror at distance R returns at most lambda^2 / (4 pi 2 R)^2.
    """
    paths = traced(room, rays=4000)
    nearest = min(float(np.abs(item.vertices).max(axis=0).min()) for item in room)
    nearest = min(nearest, float(paths.scattered.range_m().min(initial=np.inf)))
    bound = 8.0 * np.pi * MATERIALS["rough"].scattering_coefficient ** 2 * WAVELENGTH_M**2 / (4.0 * np.pi) ** 3
    assert (np.abs(paths.scattered.amplitude) ** 2).sum() <= bound / nearest**2
    mirrors = WAVELENGTH_M / (4.0 * np.pi * 2.0 * paths.specular.range_m())
    assert (np.abs(paths.specular.amplitude) <= mirrors * (1.0 + 1e-5)).all()
