"""Hard cases of right-angled corners: how they are cut, where they stand, and geometry that hardly makes one.

References are the same corner without what makes it hard; levels in dB are of the sum of its echoes.
"""

from collections.abc import Sequence

import numpy as np
from corner_scenes import dihedral, echoes, level_db, meshes_of, received
from hardcases.case import HardCase
from hardcases.tools import UTM, not_finite_paths, read_back
from sionna_scenes import mesh, plate, scene_of

from datafactory.paths.corners import corners_of
from datafactory.paths.planes import OFF_SQUARE_DEG
from datafactory.paths.table import PathTable
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import SceneObject

FACES = dihedral(20.0, 0.15, 0.2, 6.0)


def _echo(objects: Sequence[SceneObject], pose: Pose | None = None) -> complex:
    return received(echoes(scene_of(*objects), pose or Pose((0.0, 0.0, 0.0)))[:2])


def _cut() -> float:
    """Level error [dB] of faces of 18 and 200 triangles with uneven joints, against two."""
    whole = _echo(meshes_of(FACES))
    return max(abs(level_db(_echo(meshes_of(FACES, cuts)), whole)) for cuts in (3, 10))


def _far_away() -> float:
    """Level error [dB] of a corner 5500 km from its scene's origin."""
    moved = [mesh(item.name, item.vertices + np.array(UTM), item.triangles, "metal") for item in meshes_of(FACES)]
    return abs(level_db(_echo(moved, Pose(UTM)), _echo(meshes_of(FACES))))


def _centimetres() -> float:
    """Level error [dB] of a corner read from a file in centimetres."""
    meshes = {f"face{n}": (item.vertices, item.triangles) for n, item in enumerate(meshes_of(FACES))}
    read = [mesh(item.name, item.vertices, item.triangles, "metal") for item in read_back(meshes, 0.01)]
    return abs(level_db(_echo(read), _echo(meshes_of(FACES))))


def _at_the_limit() -> float:
    """Openings 1e-6 deg to either side of the limits that fall on the wrong side."""
    wrong = 0
    for side in (-1.0, 1.0):
        for off in (-1e-6, 1e-6):
            opening = 90.0 + side * (OFF_SQUARE_DEG + off)
            found = len(corners_of(scene_of(*meshes_of(dihedral(20.0, 0.15, 0.2, opening_deg=opening)))))
            wrong += found != (off < 0.0)
    return float(wrong)


def _without_width() -> float:
    """Level error [dB] of a corner with needles, triangles of no area and a face of 1 mm at its edge."""
    foot, up = FACES[0].corner, FACES[0].along
    flat = mesh("flat", [foot, foot + 0.5 * up, foot + up], [[0, 1, 2]], "metal")
    needle = mesh("needle", [foot, foot + up, foot + 0.5 * up + [0.0, 1e-9, 0.0]], [[0, 1, 2]], "metal")
    edge = plate("edge", foot + 0.5 * up + [0.0, 0.0005, 0.0], 0.5 * up, [0.0, 0.0005, 0.0], "metal")
    return abs(level_db(_echo([*meshes_of(FACES), flat, needle, edge]), _echo(meshes_of(FACES))))


def _doubled() -> float:
    """Level error [dB] of a corner whose faces lie there twice, wound either way, and once more in part."""
    faces = meshes_of(FACES)
    again = [mesh(f"again-{item.name}", item.vertices, item.triangles[:, ::-1], "metal") for item in faces]
    half = [
        mesh(f"half-{item.name}", item.vertices * [1.0, 1.0, 0.5], item.triangles, "metal")
        for item in meshes_of(FACES, 3)
    ]
    return abs(level_db(_echo([*faces, *again, *half]), _echo(faces)))


def _three_faces() -> float:
    """Level error [dB] of a corner whose edge a third face shares that goes on behind one of the two."""
    faces = meshes_of(FACES)
    behind = FACES[0].corner - FACES[0].into
    third = mesh("third", [behind, FACES[0].corner, FACES[0].corner + FACES[0].along, behind + FACES[0].along],
                 [[0, 1, 2], [0, 2, 3]], "metal")  # fmt: skip
    return abs(level_db(_echo([*faces, third]), _echo(faces)))


def _misplaced() -> float:
    """Values not finite in the echoes to a sensor on the edge, on a face, and in a face's plane beyond it."""
    of = scene_of(*meshes_of(FACES))
    face = FACES[0]
    into, up = face.into, face.along
    places = [face.corner + off for off in (0.5 * up, 0.5 * (up + into), 3.0 * into, -into)]
    wrong = 0
    for place in places:
        for yaw in (0.0, 180.0):
            scattered, specular, _ = echoes(of, Pose(tuple(place.tolist()), yaw_deg=yaw))
            wrong += not_finite_paths(PathTable(scattered, specular))
    return float(wrong)


CASES = (
    HardCase("corner of 2, 18 and 200 triangles", "the echo of pieces is not that of the whole", 0.01, "dB", _cut),
    HardCase("corner 5500 km away", "edges and planes are found with rounding errors", 0.01, "dB", _far_away),
    HardCase("corner in centimetres", "tolerances in metres", 0.01, "dB", _centimetres),
    HardCase("opening 1e-6 deg off the limit", "counted twice or never", 0.0, "wrong answers", _at_the_limit),
    HardCase("corner with faces of no width", "normals and edges of no length", 0.01, "dB", _without_width),
    HardCase("corner of overlapping coplanar meshes", "an echo for each pair of them", 0.01, "dB", _doubled),
    HardCase("edge shared by three faces", "no edge, or the wrong pair", 0.01, "dB", _three_faces),
    HardCase("sensor on a corner's edge and faces", "angles and distances of 0", 0.0, "not finite", _misplaced),
)
