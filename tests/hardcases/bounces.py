"""Hard cases of targets over mirrors and of targets that move in themselves.

References are the two-ray model, the echo without its hazard, and counts of what must not be there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from hardcases.case import HardCase
from hardcases.tools import MIRROR, UTM, not_finite_paths, rectangle, traced
from mirrored_scenes import METAL, two_rays_db
from numpy.typing import NDArray
from sionna_scenes import WAVELENGTH_M

from datafactory.paths.table import TARGET, PathTable
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import PointTarget, SceneObject
from datafactory.scenes.targets.models import Car, Pedestrian


def _ground(material: str = MIRROR, half_m: float = 400.0) -> SceneObject:
    return rectangle("ground", (0.0, 0.0, 0.0), (half_m, 0.0, 0.0), (0.0, half_m, 0.0), material)


def _traced(objects: Sequence[SceneObject], targets: Sequence[PointTarget], pose: Pose) -> PathTable:
    return traced(objects, pose, rays=100, depth=2, targets=targets, diffuse=False)


def _post(x: float, z: float) -> PointTarget:
    return PointTarget("post", (x, 0.0, z), 0.0)


def _field(table: PathTable) -> complex:
    paths = table.scattered.take(table.scattered.kinds & TARGET > 0)
    return complex(np.sum(paths.amplitude * np.exp(4j * np.pi * paths.range_m() / WAVELENGTH_M)))


def _over_free_db(table: PathTable, range_m: float) -> float:
    free = WAVELENGTH_M / (4.0 * np.pi) ** 1.5 / range_m**2
    return float(20.0 * np.log10(abs(_field(table)) / free))


def _two_rays_db(range_m: float, radar_m: float, target_m: float) -> float:
    """Level over free space [dB] above metal, polarised vertically."""
    free = 20.0 * np.log10(WAVELENGTH_M / (4.0 * np.pi) ** 1.5 / np.hypot(range_m, target_m - radar_m) ** 2)
    return float(two_rays_db(METAL, np.array([range_m]), radar_m, target_m, "V")[0] - free)


def _touching() -> float:
    """Largest error [dB] of targets on metal, or a rounding error above or below it."""
    heights = (0.0, 1e-12, -1e-12, 1e-7, -1e-7)
    tables = [_traced([_ground()], [_post(20.0, z)], Pose((0.0, 0.0, 0.5))) for z in heights]
    return max(abs(_over_free_db(table, np.hypot(20.0, 0.5)) - _two_rays_db(20.0, 0.5, 0.0)) for table in tables)


def _grazing() -> float:
    """Largest error [dB] against the two-ray model at 0.1 to 0.5 deg of grazing, where rays in float32 slip."""
    worst = 0.0
    for range_m in (60.0, 120.0, 300.0):
        table = _traced([_ground(half_m=1e4)], [_post(range_m, 0.31)], Pose((0.0, 0.0, 0.3)))
        found = _over_free_db(table, np.hypot(range_m, 0.01))
        worst = max(worst, abs(found - _two_rays_db(range_m, 0.3, 0.31)))
    return worst


def _far_away() -> float:
    """Largest error of an image's place [m] for a scene 5500 km from its origin."""
    ground = _ground()
    moved = SceneObject("ground", ground.vertices + UTM, ground.triangles, MIRROR)
    x, y, z = (np.array(UTM) + np.array([14.0, 2.0, 0.7])).tolist()
    table = _traced([moved], [PointTarget("post", (x, y, z), 0.0)], Pose((UTM[0], UTM[1], UTM[2] + 0.5)))
    twice = table.scattered.take(table.scattered.depth == 3)
    return float(np.abs(twice.tx_point - [14.0, 2.0, -1.2]).max()) if len(twice) == 1 else np.inf


def _edge_of_the_ground() -> float:
    """Paths off by one: the point of reflection on the edge between two pieces, which both hold it."""
    left = rectangle("left", (-195.0, 0.0, 0.0), (205.0, 0.0, 0.0), (0.0, 400.0, 0.0))
    right = rectangle("right", (210.0, 0.0, 0.0), (200.0, 0.0, 0.0), (0.0, 400.0, 0.0))
    table = _traced([left, right], [_post(20.0, 0.5)], Pose((0.0, 0.0, 0.5)))
    return abs(int((table.scattered.kinds & TARGET > 0).sum()) - 4)


def _ends_before() -> float:
    """Bounced paths of ground that ends a millimetre before the point of reflection, and edges' echoes apart."""
    short = rectangle("short", (-195.0, 0.0, 0.0), (204.999, 0.0, 0.0), (0.0, 400.0, 0.0))
    table = _traced([short], [_post(20.0, 0.5)], Pose((0.0, 0.0, 0.5)))
    return float((table.scattered.depth > 1).sum())


def _on_top_of_each_other() -> float:
    """Difference [dB] that a second sheet on the ground, and 0.5 mm above it, makes at a lobe's peak."""
    alone = _field(_traced([_ground()], [_post(20.0, 0.464)], Pose((0.0, 0.0, 0.5))))
    worst = 0.0
    for height in (0.0, 5e-4):
        sheet = rectangle("again", (0.0, 0.0, height), (300.0, 0.0, 0.0), (0.0, 300.0, 0.0))
        both = _traced([_ground(), sheet], [_post(20.0, 0.464)], Pose((0.0, 0.0, 0.5)))
        paths = both.scattered.take(both.scattered.kinds & TARGET > 0)
        worst = max(worst, np.inf if len(paths) != 4 else abs(20.0 * np.log10(abs(_field(both)) / abs(alone))))
    return float(worst)


def _below_and_inside() -> float:
    """Values that are not finite, and bounces that cannot be: radar under the ground, in it, on it; target in it."""
    wrong = 0
    for height, depth in ((-0.5, 0.5), (0.0, 0.5), (1e-9, 0.5), (0.5, -0.3)):
        table = _traced([_ground()], [_post(12.0, depth)], Pose((0.0, 0.0, height)))
        wrong += not_finite_paths(table) + int((table.scattered.depth > 1).sum())
    return float(wrong)


def _no_area() -> float:
    """Values that are not finite of ground with needles and points among its triangles, and paths too many."""
    ground = _ground()
    vertices = np.concatenate([ground.vertices, [[10.0, 0.0, 0.0], [10.0, 1e-9, 0.0], [10.0, 0.0, 0.0]]])
    spoilt = SceneObject("ground", vertices, np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 4, 4]], np.int32), MIRROR)
    table = _traced([spoilt], [_post(20.0, 0.5)], Pose((0.0, 0.0, 0.5)))
    return not_finite_paths(table) + abs(float((table.scattered.kinds & TARGET > 0).sum()) - 4)


def _many_mirrors() -> float:
    """Mirrors of one target that are neither kept nor counted: thirty tilted plates that all reflect."""
    generator = np.random.default_rng(2)
    plates = []
    for number in range(30):
        # A plate whose plane mirrors the radar into a point from which the target is seen through the plate's middle.
        middle = np.array([6.0, 0.0, -2.0]) + generator.uniform(-1.0, 1.0, 3) * [2.0, 3.0, 0.5]
        normal = -middle / np.linalg.norm(middle) + _towards(np.array([12.0, 0.0, 0.0]) - middle)
        across = np.cross(normal, [1.0, 0.0, 0.0])
        up = np.cross(normal, across)
        plates.append(rectangle(f"p{number}", middle, 0.3 * _towards(across), 0.3 * _towards(up)))
    table = _traced(plates, [_post(12.0, 0.0)], Pose((0.0, 0.0, 0.0)))
    kept, left_out = table.counts["target_mirrors"], table.counts["target_mirrors_left_out"]
    return abs(kept - 4) + float(not 10 < kept + left_out <= 30)


def _towards(vector: NDArray) -> NDArray:
    return vector / np.linalg.norm(vector)


def _moving_parts() -> float:
    """Values that are not finite, and differences between runs of one seed, of walkers and wheels at odd times."""
    wrong = 0
    for speed in (0.0, 1e-9, 1.4, 2.5):
        for time in (0.0, 1e7, -3.0):
            human = PointTarget("h", (9.0, 0.0, -0.5), 0.0, (speed, 0.0, 0.0), Pedestrian(1.75))
            car = PointTarget("c", (20.0, 3.0, -0.5), 0.0, (10.0 * speed, 0.0, 0.0), Car(0.3))
            for target in (human, car):
                still = PointTarget(target.name, tuple(np.array(target.position) - time * np.array(target.velocity)),
                                    0.0, target.velocity, target.model)  # fmt: skip
                first, again = (_traced([], [still], Pose((0.0, 0.0, 0.0), time_s=time)) for _ in range(2))
                wrong += not_finite_paths(first)
                wrong += first.scattered.amplitude.tobytes() != again.scattered.amplitude.tobytes()
    return float(wrong)


CASES = (
    HardCase("a target that touches the ground", "the two legs' lengths are one; 1/0", 0.05, "dB", _touching),
    HardCase("bounces at 0.1 deg of grazing", "rays in float32 meet the ground itself", 0.1, "dB", _grazing),
    HardCase("bounces 5500 km away", "images in float32", 1e-6, "m", _far_away),
    HardCase("a bounce on an edge of two faces", "counted twice, or not at all", 0.0, "paths", _edge_of_the_ground),
    HardCase("ground that ends before the bounce", "an endless plane is taken", 0.0, "paths", _ends_before),
    HardCase("two sheets of ground", "an echo counted twice", 0.1, "dB", _on_top_of_each_other),
    HardCase("radar or target in the ground", "mirrors from behind", 0.0, "wrong values", _below_and_inside),
    HardCase("ground with faces of no area", "normals of no length", 0.0, "wrong values", _no_area),
    HardCase("thirty mirrors of one target", "paths without bound, or silently lost", 0.0, "mirrors", _many_mirrors),
    HardCase("walkers and wheels at odd times", "phases of 1e7 s, no speed", 0.0, "wrong values", _moving_parts),
)
