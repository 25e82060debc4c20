"""Hard cases of targets over mirrors and of targets that move in themselves.

References are the two-ray model, the echo without its hazard, and counts of what must not be there.
"""

from dataclasses import replace

import numpy as np
from hardcases.case import HardCase
from hardcases.tools import MIRROR, UTM, not_finite_paths
from mirrored_scenes import METAL, echoes, ground, level_db, point, two_rays_db
from numpy.typing import NDArray
from sionna_scenes import plate

from datafactory.paths.table import ScatteredPaths
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import PointTarget
from datafactory.scenes.targets.models import Car, Pedestrian

RADAR = Pose((0.0, 0.0, 0.5))


def _error_db(paths: ScatteredPaths, range_m: float, radar_m: float, target_m: float) -> float:
    """Against the two-ray model above metal, polarised vertically."""
    return abs(level_db(paths) - float(two_rays_db(METAL, np.array([range_m]), radar_m, target_m, "V")[0]))


def _touching() -> float:
    """Largest error [dB] of targets on metal, or a rounding error above or below it."""
    heights = (0.0, 1e-12, -1e-12, 1e-7, -1e-7)
    found = [echoes([ground()], [point((20.0, 0.0, z))], RADAR)[0] for z in heights]
    return max(_error_db(paths, 20.0, 0.5, 0.0) for paths in found)


def _grazing() -> float:
    """Largest error [dB] against the two-ray model at 0.1 to 0.5 deg of grazing, where rays in float32 slip."""
    worst = 0.0
    for range_m in (60.0, 120.0, 300.0):
        wide = ground(x=(-1e4, 1e4), y=(-1e4, 1e4))
        paths, _ = echoes([wide], [point((range_m, 0.0, 0.31))], Pose((0.0, 0.0, 0.3)))
        worst = max(worst, _error_db(paths, range_m, 0.3, 0.31))
    return worst


def _far_away() -> float:
    """Largest error of an image's place [m] for a scene 5500 km from its origin."""
    near = ground()
    moved = replace(near, vertices=near.vertices + UTM)
    post = point((np.array(UTM) + np.array([14.0, 2.0, 0.7])).tolist())
    _, table = echoes([moved], [post], Pose((UTM[0], UTM[1], UTM[2] + 0.5)))
    twice = table.scattered.take(table.scattered.depth == 3)
    return float(np.abs(twice.tx_point - [14.0, 2.0, -1.2]).max()) if len(twice) == 1 else np.inf


def _edge_of_the_ground() -> float:
    """Paths off by one: the point of reflection on the edge between two pieces, which both hold it."""
    pieces = [ground(x=(-400.0, 10.0), name="left"), ground(x=(10.0, 410.0), name="right")]
    return abs(len(echoes(pieces, [point((20.0, 0.0, 0.5))], RADAR)[0]) - 4)


def _ends_before() -> float:
    """Bounced paths of ground that ends a millimetre before the point of reflection, and edges' echoes apart."""
    _, table = echoes([ground(x=(-399.999, 9.999))], [point((20.0, 0.0, 0.5))], RADAR)
    return float((table.scattered.depth > 1).sum())


def _on_top_of_each_other() -> float:
    """Difference [dB] that a second sheet on the ground, and 0.5 mm above it, makes at a lobe's peak."""
    post, worst = point((20.0, 0.0, 0.464)), 0.0
    alone, _ = echoes([ground()], [post], RADAR)
    for height in (0.0, 5e-4):
        sheet = plate("again", (0.0, 0.0, height), (300.0, 0.0, 0.0), (0.0, 300.0, 0.0), MIRROR)
        both, _ = echoes([ground(), sheet], [post], RADAR)
        worst = max(worst, np.inf if len(both) != 4 else abs(level_db(both) - level_db(alone)))
    return worst


def _below_and_inside() -> float:
    """Values that are not finite, and bounces that cannot be: radar under the ground, in it, on it; target in it."""
    wrong = 0
    for height, depth in ((-0.5, 0.5), (0.0, 0.5), (1e-9, 0.5), (0.5, -0.3)):
        _, table = echoes([ground()], [point((12.0, 0.0, depth))], Pose((0.0, 0.0, height)))
        wrong += not_finite_paths(table) + int((table.scattered.depth > 1).sum())
    return float(wrong)


def _no_area() -> float:
    """Values that are not finite of ground with needles and points among its triangles, and paths too many."""
    whole = ground()
    vertices = np.concatenate([whole.vertices, [[10.0, 0.0, 0.0], [10.0, 1e-9, 0.0], [10.0, 0.0, 0.0]]])
    triangles = np.array([*whole.triangles, [4, 5, 6], [4, 4, 4]], dtype=np.int32)
    spoilt = replace(whole, vertices=vertices, triangles=triangles)
    paths, table = echoes([spoilt], [point((20.0, 0.0, 0.5))], RADAR)
    return not_finite_paths(table) + abs(len(paths) - 4.0)


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
        plates.append(plate(f"p{number}", middle, 0.3 * _towards(across), 0.3 * _towards(up), MIRROR))
    _, table = echoes(plates, [point((12.0, 0.0, 0.0))], Pose((0.0, 0.0, 0.0)))
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
                first, again = (echoes([], [still], Pose((0.0, 0.0, 0.0), time_s=time))[1] for _ in range(2))
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
