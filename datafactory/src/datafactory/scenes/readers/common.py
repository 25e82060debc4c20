"""What all readers share: how a file is to be read, their remarks, what a scene may hold, meshes in the world, solids.

float32 keeps 24 bits: at 500 km from the origin neighbouring numbers are 3 cm apart, eight wavelengths of 77 GHz. A
vertex rounded by half a spacing moves its echo's phase by up to 2 * 360 deg * (spacing / 2) / wavelength.

Solids are given by their parameters, and become triangle meshes. Round ones are solids of revolution with ``SEGMENTS``
chords to the full circle. Their corners lie on the true surface. The largest gap between chord and arc is r (1 - cos(pi
/ SEGMENTS)) = 0.0012 r around the axis. A facet of a sphere is curved in two directions, and its gap is at most twice
that (``CHORD_ERROR``). The tracer finds the curved surface behind such facets again
(:mod:`datafactory.paths.curved_surfaces`)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.chain import placed
from datafactory.scenes.scene import Scene, SceneObject
from shared.physics.errors import InputError
from shared.physics.units import FARTHEST_M, SPEED_OF_LIGHT

MAXIMUM_OBJECTS = 250_000
"""Objects and point targets: reading them takes about three minutes and 1 GB."""
MAXIMUM_TRIANGLES = 20_000_000
"""Merged and in the ray tracer they take about 8 GB."""
MAXIMUM_SAMPLED = 100_000_000
"""Coordinates of all samples of one mesh's moving points: 400 MB."""
MAXIMUM_NESTING = 64
"""Levels of instances within instances."""
PLAUSIBLE_METRES = (0.1, 50e3)
"""Of a scene's longest side: a tin can, a city."""
Y_UP_TO_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # (x, y, z) -> (x, -z, y)
FLAT = 1e-12  # twice a triangle's area over its longest edge squared: below this float64 cannot tell it from a line
WAVELENGTH_M = SPEED_OF_LIGHT / 77e9
COARSE_DEG = 10.0
"""Smaller phase errors of vertices are not noted. float32 vertices reach this about 1 km from the origin."""
Placed = tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int64]]
SEGMENTS = 64
CHORD_ERROR = 2 * (1 - np.cos(np.pi / SEGMENTS))  # largest distance to the true surface, in radii
Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]
PlainMesh = tuple[str, str, NDArray[np.floating], NDArray[np.integer], NDArray[np.float64]]


@dataclass(frozen=True)
class Reading:
    """How a scene is read, where that is not settled by the file.

    :param variants: (variant set, variant) of USD, selected on every prim that has the set, over what the file selects
    :param allow_missing: go on without geometry that cannot be opened
    """

    variants: tuple[tuple[str, str], ...] = ()
    allow_missing: bool = False


AS_WRITTEN = Reading()
"""What the file says, and nothing missing."""


def parse_variants(given: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """The ``--variant`` options, ``set=name`` each.

    :raises InputError: one that is not of this form, or a set that is given twice
    """
    found: dict[str, str] = {}
    for item in given:
        name, equals, variant = item.partition("=")
        if not (name and equals and variant):
            raise InputError("--variant", repr(item), "set=name, e.g. color=red")
        if found.setdefault(name, variant) != variant:
            raise InputError("--variant", f"{name!r} is given as {found[name]!r} and as {variant!r}", "one of the two")
    return tuple(found.items())


class Notes:
    """Counted remarks of one reading, what a file holds and the scene does not, in the order in which they came up."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()

    def count(self, remark: str, number: int = 1) -> None:
        """Add ``number`` to the count of one kind of remark.

        :param remark: the sentence, with ``#`` where the count goes, e.g. ``"# prims of type Points ignored"``
        """
        if number:
            self._counts[remark] += number

    def say(self, remark: str) -> None:
        """Add a remark that has no count; saying it twice changes nothing."""
        self._counts[remark] = 1

    def repeat(self, other: Notes) -> None:
        """Add the counts of other notes once more."""
        self._counts.update(other._counts)

    def sentences(self) -> tuple[str, ...]:
        """The remarks with their counts filled in."""
        return tuple(remark.replace("#", str(number), 1) for remark, number in self._counts.items())


def check_counts(source: object, what: str, objects: int, triangles: int) -> None:
    """Refuse more objects or triangles than a scene may hold: a few lines of nested instances can ask for millions.

    :param what: the part of the scene that they belong to, e.g. ``"point instancer /World/Trees"``
    :raises InputError: naming the part, the figure and the limit
    """
    for count, kind, limit in ((objects, "objects", MAXIMUM_OBJECTS), (triangles, "triangles", MAXIMUM_TRIANGLES)):
        if count > limit:
            raise InputError(source, f"{what} makes {count} {kind}", f"at most {limit}")


def with_remarks(scene: Scene, notes: Notes, remedy: str, always: bool = False) -> Scene:
    """The scene with the remarks of its reading, among them one on its size where that is implausible.

    :param remedy: what the user should check then
    :param always: say the size, whatever it is
    """
    if scene.objects or scene.targets:
        lower, upper = scene.bounds()
        sides = upper - lower
        low, high = PLAUSIBLE_METRES
        if always or sides.max() > high or (scene.objects and sides.max() < low):
            text = " x ".join(f"{side:.3g}" for side in sides)
            notes.say(f"the scene measures {text} m (x, y, z): check {remedy}")
    return replace(scene, warnings=notes.sentences())


def place_mesh(
    points: NDArray[np.floating], triangles: NDArray[np.integer], matrix: NDArray[np.float64], notes: Notes
) -> Placed:
    """Place a mesh in the world, in float64, outer sides outside also under a mirror.

    Left out and counted are triangles that no ray tracer can use; left out are points that no triangle uses.

    :param points: [P, 3] in local coordinates, in the precision of the file
    :param triangles: [T, 3] indices of points; counter-clockwise seen from outside
    :param matrix: [4, 4] to the world, acting on column vectors
    :return: vertices [V, 3]; triangles [T', 3] on them, in the order given; which points [V] the vertices are
    """
    world = placed(np.asarray(points).reshape(-1, 3), matrix)
    kept = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
    mirrors = np.linalg.det(matrix[:3, :3]) < 0
    kept = kept[:, ::-1] if mirrors else kept

    def of_use(good: NDArray[np.bool_], others: str) -> NDArray[np.int64]:
        notes.count(f"# triangles {others} dropped", int((~good).sum()))
        return kept[good]

    kept = of_use(np.all((kept >= 0) & (kept < len(world)), axis=1), "with a vertex index out of range")
    kept = of_use(np.all(np.isfinite(world[kept]), axis=(1, 2)), "with a NaN or infinite vertex")
    near = np.all(np.abs(world[kept]) <= FARTHEST_M, axis=(1, 2))
    kept = of_use(near, f"with a vertex beyond {FARTHEST_M:g} m")
    used, compact = np.unique(of_use(_has_area(world[kept]), "without area"), return_inverse=True)
    return world[used], compact.reshape(-1, 3).astype(np.int32), used


def _has_area(corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    edges = corners[:, [1, 2, 0]] - corners  # [T, 3, 3]
    doubled_area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    solid: NDArray[np.bool_] = doubled_area > FLAT * np.square(edges).sum(axis=2).max(axis=1, initial=0.0)
    return solid


def vertex_spacing_m(points: NDArray[np.floating], matrix: NDArray[np.float64]) -> float:
    """Spacing [m] of the numbers that a mesh's farthest vertex is written in; 0 for float64, which is always fine.

    :param points: [P, 3] in local coordinates, in the precision of the file
    :param matrix: [4, 4] to the world in metres; its offset is added in float64 and costs nothing
    """
    if points.dtype.itemsize > 4 or not np.isfinite(matrix).all():
        return 0.0
    largest = np.float32(np.max(np.abs(points), initial=0.0, where=np.isfinite(points)))
    # The largest number has infinity above it: its spacing is that to the number below.
    spacing = float(largest - np.nextafter(largest, np.float32(0.0)))
    found = spacing * float(np.linalg.norm(matrix[:3, :3], ord=2))
    return found if np.isfinite(found) else 0.0


def note_coarse_vertices(spacings_m: Sequence[float], notes: Notes) -> None:
    """Count the meshes whose vertices are too coarse for coherent echoes, with the largest phase error.

    :param spacings_m: :func:`vertex_spacing_m` of every mesh
    """
    worst_deg = 360.0 * max(spacings_m, default=0.0) / WAVELENGTH_M
    coarse = [spacing for spacing in spacings_m if 360.0 * spacing / WAVELENGTH_M > COARSE_DEG]
    if coarse:
        notes.count(
            f"# meshes have float32 vertices far from their origin, {max(coarse) * 1e3:.2g} mm apart: phases at 77 GHz "
            f"are wrong by up to {worst_deg:.0f} deg; hold the offset in a transform or in doubles",
            len(coarse),
        )


def scene_at_rest(path: Path, name: str, kind: str, meshes: Iterable[PlainMesh], notes: Notes) -> Scene:
    """The scene of a format in which nothing moves and that states no unit: metres.

    :param kind: what the format calls a mesh
    :param meshes: name, material, points and triangles in their own coordinates, [4, 4] to the world
    :raises InputError: more objects or triangles than a scene may hold
    """
    objects: list[SceneObject] = []
    spacings, total = [], 0
    for item, material, points, triangles, matrix in meshes:
        spacings.append(vertex_spacing_m(points, matrix))
        vertices, kept, _ = place_mesh(points, triangles, matrix, notes)
        if not len(kept):
            notes.count("# meshes without a usable triangle ignored")
            continue
        objects.append(SceneObject(item, vertices, kept, material))
        total += len(kept)
        check_counts(path, f"the scene as far as {kind} {item!r}", len(objects), total)
    note_coarse_vertices(spacings, notes)
    scene = Scene(name, tuple(objects), source=str(path))
    return with_remarks(scene, notes, "its units, which are taken as metres")


def _revolve(profile: NDArray[np.float64]) -> Mesh:
    """Revolve [n, 2] (radius, height), from bottom to top, about the z axis; normals point outwards."""
    from trimesh import creation  # where needed, as in box: it takes half a second, and few files hold solids

    # trimesh merges vertices on a grid of 1e-8: far from a size of 1, the solid is made smaller or larger first.
    size = float(np.abs(profile).max(initial=0.0))
    scale = 2.0 ** np.ceil(np.log2(size)) if size > 0.0 and not 1e-3 <= size <= 1e6 else 1.0  # exact, a power of two
    solid = creation.revolve(profile / scale, sections=SEGMENTS, process=False)
    solid.merge_vertices()  # the corners on the axis, once for each segment until here
    return np.asarray(solid.vertices, dtype=np.float64) * scale, np.asarray(solid.faces, dtype=np.int64)


def _arc(radius: float, start: float, stop: float, height: float) -> NDArray[np.float64]:
    """(radius, height) along a sphere's meridian between two latitudes [rad], its centre at ``height``."""
    latitude = np.linspace(start, stop, max(2, round(abs(stop - start) / (2 * np.pi) * SEGMENTS) + 1))
    arc = np.column_stack([radius * np.cos(latitude), height + radius * np.sin(latitude)])
    arc[np.isclose(np.abs(latitude), np.pi / 2), 0] = 0.0
    return arc


def sphere(radius: float) -> Mesh:
    """A sphere about the origin."""
    return _revolve(_arc(radius, -np.pi / 2, np.pi / 2, 0.0))


def cylinder(radius_bottom: float, radius_top: float, height: float, closed: bool = True) -> Mesh:
    """A cylinder along z about the origin; with one radius 0 a cone, with ``closed`` False an open tube."""
    tube = np.array([[radius_bottom, -height / 2], [radius_top, height / 2]])
    if closed:
        tube = np.concatenate([[[0.0, -height / 2]], tube, [[0.0, height / 2]]])
    return _revolve(_without_repeats(tube))


def capsule(radius_bottom: float, radius_top: float, height: float) -> Mesh:
    """A tube of this height along z about the origin, with half a sphere on each end."""
    lower = _arc(radius_bottom, -np.pi / 2, 0.0, -height / 2)
    upper = _arc(radius_top, 0.0, np.pi / 2, height / 2)
    return _revolve(_without_repeats(np.concatenate([lower, upper])))


def disk(radius: float) -> Mesh:
    """A flat disk in the plane z = 0, its normal along +z."""
    return _revolve(np.array([[radius, 0.0], [0.0, 0.0]]))


def _without_repeats(profile: NDArray[np.float64]) -> NDArray[np.float64]:
    """The profile without repeated points, which would make triangles of no area."""
    return profile[np.concatenate([[True], (np.diff(profile, axis=0) != 0).any(axis=1)])]


def box(size: float) -> Mesh:
    """A cube of this edge about the origin."""
    from trimesh import creation

    solid = creation.box(extents=[size] * 3)
    return np.asarray(solid.vertices, dtype=np.float64), np.asarray(solid.faces, dtype=np.int64)


def rectangle(width: float, length: float) -> Mesh:
    """``width`` along x, ``length`` along y, in the plane z = 0, its normal along +z."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [width / 2, length / 2, 0.0]
    return corners.astype(np.float64), np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int64)
