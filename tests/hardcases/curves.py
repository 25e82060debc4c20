"""Hard cases of curved mirrors: foci, limits of tessellation, units, degenerate triangles.

References are closed forms, or the same body without what makes it hard.
"""

from dataclasses import replace

import numpy as np
from curved_scenes import Mesh, cylinder, sphere, torus, tube
from hardcases.case import HardCase
from hardcases.tools import MIRROR, UTM, frame_of, not_finite, not_finite_paths, read_back, small_radar, traced
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from datafactory.paths.table import PathTable
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import SceneObject

LIMIT_DEG = 25.0
"""Between facets of a smooth surface, as the documentation states it."""


def _body(of: Mesh, centre: ArrayLike = (6.0, 0.0, 0.0)) -> SceneObject:
    return SceneObject("body", of[0] + np.asarray(centre, dtype=float), of[1], MIRROR)


def _echo(paths: PathTable) -> complex:
    """Sum of all amplitudes; NaN where there is none."""
    amplitudes = paths.every("amplitude")
    return complex(amplitudes.sum()) if len(amplitudes) else complex("nan")


def _level_db(paths: PathTable, reference: PathTable) -> float:
    return abs(float(20.0 * np.log10(abs(_echo(paths)) / abs(_echo(reference)))))


def _around_the_sensor() -> float:
    """Values not finite in paths and frame, and echoes above the power sent, with the sensor in a body's focus."""
    radar, wrong = small_radar(), 0
    for of, centre in (
        (sphere(3.0, 32), (0.0, 0.0, 0.0)),
        (sphere(3.0, 32), (1e-7, 0.0, 0.0)),
        (tube(3.0, 20.0, 40), (0.0, 0.0, 0.0)),
        (tube(3.0, 20.0, 40), (0.0, 1e-3, 0.0)),
    ):
        paths = traced([_body(of, centre)])
        every = paths.every("amplitude")
        frame = frame_of(paths.within(radar).illuminated(radar.front_end), radar, noise=False)
        wrong += not_finite_paths(paths) + not_finite(frame) + int((np.abs(every) > 1.0).sum())
    return float(wrong)


def _saddle() -> float:
    """Values not finite of a torus seen from twelve places within and around it."""
    ring = torus(3.0, 0.8, 60, 24)
    return float(
        sum(
            not_finite_paths(traced([_body(ring, (x, y, z))], rays=200))
            for x in (-1.5, 0.0, 6.0)
            for y in (0.0, 0.7)
            for z in (0.0, 0.4)
        )
    )


def _beside_the_limit() -> float:
    """Bodies whose folds are a millionth of a degree from the limit and that are not wholly curved, or wholly flat."""
    mixed = 0
    for beside in (-1e-6, 1e-6):
        fold = np.radians(LIMIT_DEG + beside)
        item = _body(tube(1.0, 1.0, 6, start=np.pi - 3.0 * fold, turn=6.0 * fold), (6.0, 0.0, 0.0))
        counts = traced([item]).counts
        mixed += (counts.get("curved_mirrors", 0), counts.get("facets_too_coarse", 0)) != (
            (1, 0) if beside < 0 else (0, 6)
        )
    return float(mixed)


def _centimetres_far_away() -> float:
    """Level error [dB] of a sphere and a cylinder from a file in centimetres, 500 km away, float32 points."""
    errors = []
    for of in (sphere(0.3, 40), cylinder(0.3, 1.0, 40)):
        (item,) = read_back({"body": of}, 0.01, UTM + np.array([6.0, 0.0, 0.0]))
        errors.append(_level_db(traced([replace(item, material=MIRROR)], Pose(UTM)), traced([_body(of)])))
    return max(errors)


def _broken_triangles() -> float:
    """Level error [dB] of a sphere with a sliver and a crack at its foot, doubled and flipped triangles."""
    vertices, triangles = sphere(0.5, 32)
    towards = np.array([6.0, 1.0, 0.5]) / np.linalg.norm([6.0, 1.0, 0.5])
    here = int(np.argmin(vertices[triangles].mean(axis=1) @ towards))
    a, b, c = triangles[here]
    near = vertices[a] + 0.02 * (vertices[b] - vertices[a])
    cut = np.array([[a, len(vertices), c], [len(vertices), b, c]])
    mixed = np.concatenate([np.delete(triangles, here, axis=0), cut, triangles[:40, ::-1]])
    mixed[::3] = mixed[::3, ::-1]
    hard = _body((np.concatenate([vertices, near[None]]), mixed.astype(np.int32)), (6.0, 1.0, 0.5))
    return _level_db(traced([hard]), traced([_body((vertices, triangles), (6.0, 1.0, 0.5))]))


def _foot_on_seams() -> float:
    """Spheres that do not have exactly one echo where the foot is a vertex, lies on a side of a triangle, or beside."""
    wrong = 0
    for segments in (16, 32):
        turn = 2.0 * np.pi / segments
        for angle in (0.0, 1e-12, 1e-7, 0.25 * turn, 0.5 * turn):
            for tilt in (0.0, 1e-9, 0.3 * turn):
                vertices, triangles = sphere(0.5, segments)
                turned = Rotation.from_euler("zy", (angle, tilt)).apply(vertices)
                wrong += len(traced([_body((turned, triangles))], rays=200)) != 1
    return float(wrong)


CASES = (
    HardCase(
        "sensor in the focus of a sphere or pipe", "all points are stationary", 0.0, "wrong values", _around_the_sensor
    ),
    HardCase("saddles seen from all sides", "roots of negative numbers, caustics", 0.0, "not finite", _saddle),
    HardCase("folds within 1e-6 deg of the limit", "half a body curved", 0.0, "mixed bodies", _beside_the_limit),
    HardCase("round bodies in cm, 500 km away", "curvature from rounded vertices", 0.01, "dB", _centimetres_far_away),
    HardCase("broken triangles on a sphere", "normals and curvature of slivers", 0.5, "dB", _broken_triangles),
    HardCase("feet on vertices and sides", "an echo lost or counted twice", 0.0, "wrong counts", _foot_on_seams),
)
