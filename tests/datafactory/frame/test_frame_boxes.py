"""The boxes of a frame: carried to mid-frame as targets are, kept where the radar looks; the power of their paths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from datafactory.frame.measurement import boxes_of
from datafactory.frame.points import target_list
from datafactory.paths.table import PathTable, ScatteredPaths, SpecularPaths
from datafactory.scenes.boxes import SeenThing
from shared.radar import Radar

RADAR = Radar()
AXES = {"forward": (1.0, 0.0, 0.0), "left": (0.0, 1.0, 0.0), "up": (0.0, 0.0, 1.0)}
CAR = SeenThing("/Car", "car", (20.0, 4.0, 0.2), (4.0, 2.0, 1.5), velocity=(-8.0, 3.0, 0.0), indices=(0, 2), **AXES)
NOTHING = PathTable(ScatteredPaths.none(), objects=("body", "wall", "wheel"))


def test_a_box_and_a_target_at_one_place_agree_at_mid_frame() -> None:
    ((box,), _) = boxes_of([CAR], NOTHING, RADAR)
    (target,) = target_list(np.array([CAR.center]), np.array([CAR.velocity]), np.zeros(1), ["/Car"], RADAR)
    range_m = float(np.linalg.norm(box.center))
    assert range_m == pytest.approx(target.range_m, abs=1e-12)
    assert box.center[1] / range_m == pytest.approx(target.u, abs=1e-12)
    assert np.dot(box.center, box.velocity) / range_m == pytest.approx(target.velocity_mps, abs=1e-12)
    assert (box.size, box.class_name, box.object, box.yaw) == (CAR.size, "car", "/Car", 0.0)


def test_yaw_is_the_heading_in_the_radar_frame() -> None:
    turned = replace(CAR, forward=(0.0, -1.0, 0.0), left=(1.0, 0.0, 0.0))
    ((box,), _) = boxes_of([turned], NOTHING, RADAR)
    assert box.yaw == pytest.approx(-np.pi / 2)


def test_power_is_that_of_the_paths_off_its_own_parts() -> None:
    """Two off the body, one off the wheel, one mirrored by the wheel; the wall's and the unknown's are not its own."""
    index = np.array([0, 0, 1, 2, -1], dtype=np.int32)
    scattered = ScatteredPaths.of_points(
        np.ones((5, 3)), np.zeros((5, 3)), 1j * np.array([1.0, 2.0, 5.0, 3.0, 7.0]), index
    )
    one = np.ones(1)
    specular = SpecularPaths(
        np.ones((1, 3)), np.zeros((1, 3)), np.eye(3)[None], amplitude=4.0 * one.astype(np.complex128),
        depth=one.astype(np.int8), object_index=np.array([2], dtype=np.int32), kinds=one.astype(np.uint8),
    )  # fmt: skip
    ((box,), _) = boxes_of([CAR], replace(NOTHING, scattered=scattered, specular=specular), RADAR)
    assert box.power == pytest.approx(1.0 + 4.0 + 9.0 + 16.0)
    ((hidden,), _) = boxes_of([CAR], NOTHING, RADAR)
    assert hidden.power == 0.0


@pytest.mark.parametrize(
    ("center", "kept"),
    [
        ((20.0, 4.0, 0.0), True),
        ((-20.0, 4.0, 0.0), False),  # behind
        ((200.0, 0.0, 0.0), False),  # beyond the range
        ((96.0, 0.0, 0.0), True),  # its rear is within
        ((4.0, 16.0, 0.0), False),  # u = 0.97
        ((5.0, 9.2, 0.0), True),  # u = 0.88, a corner at 0.8
    ],
)
def test_what_is_out_of_view_is_counted(center: tuple[float, float, float], kept: bool) -> None:
    thing = replace(CAR, center=center, velocity=(0.0, 0.0, 0.0))
    boxes, counts = boxes_of([thing], NOTHING, RADAR)
    assert (len(boxes), counts) == (int(kept), {"boxes": int(kept), "boxes_out_of_view": int(not kept)})
