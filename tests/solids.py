"""Whether bodies are inside one another: volumes that closed meshes have in common, and points within them.

Boxes say what may meet, exact booleans of the meshes say what does (Manifold, https://github.com/elalish/manifold).
What two bodies share counts by its thickness, 2 V / A, which is t for a slab of thickness t: neighbours that touch
share nothing, or a film.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import trimesh
from manifold3d import Error, Manifold, Mesh
from numpy.typing import ArrayLike, NDArray

Real = NDArray[np.float64]

TOUCH_M = 0.01
"""Bodies that share a film of less stand beside each other, as the generator of cities has it."""


class Shape:
    """Closed bodies in a frame of their own.

    :param parts: one or more of them
    """

    def __init__(self, parts: Sequence[Manifold]) -> None:
        self.parts = tuple(parts)
        boxes = np.array([part.bounding_box() for part in self.parts]).reshape(-1, 2, 3)
        corner = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        self.corners: Real = boxes[:, 0, None] + corner * (boxes[:, 1] - boxes[:, 0])[:, None]
        """[B, 8, 3] of each body's box."""

    @staticmethod
    def of(vertices: ArrayLike, triangles: ArrayLike) -> Shape:
        """The bodies that a mesh bounds, wound outwards.

        :param vertices: [V, 3] [m]; :param triangles: [T, 3]
        :raises ValueError: one of them is open, or wound inwards
        """
        bodies = trimesh.Trimesh(vertices, triangles, process=False).split(only_watertight=False, repair=False)
        for body in bodies:
            if not body.is_watertight or body.volume <= 0.0:
                raise ValueError(f"a body of {len(body.faces)} triangles is not closed")
        return Shape([_solid(body) for body in bodies])

    @staticmethod
    def around(parts: Sequence[tuple[ArrayLike, ArrayLike]]) -> Shape:
        """Of several meshes whose corners at one place are one: closed bodies, and one hull that holds all open ones.

        The shipped cars have no floor, and their wheels no inner side.
        """
        whole = trimesh.util.concatenate([trimesh.Trimesh(*part, process=False) for part in parts])
        whole.merge_vertices()
        bodies = whole.split(only_watertight=False, repair=False)
        solids, loose = [], []
        for body in bodies:
            if not body.is_watertight:
                loose.append(np.asarray(body.vertices))
                continue
            if body.volume < 0.0:
                body.invert()
            solids.append(_solid(body))
        if loose:
            solids.append(Manifold.hull_points(np.concatenate(loose)))
        return Shape(solids)

    @staticmethod
    def box(low: ArrayLike, high: ArrayLike) -> Shape:
        """Between two corners [3] [m]."""
        return Shape([_solid(trimesh.creation.box(bounds=[low, high]))])


def _solid(body: trimesh.Trimesh) -> Manifold:
    solid = Manifold(Mesh(np.asarray(body.vertices, dtype=np.float32), np.asarray(body.faces, dtype=np.uint32)))
    if solid.status() != Error.NoError:
        raise ValueError(f"a body of {len(body.faces)} triangles is no manifold: {solid.status()}")
    return solid


@dataclass(frozen=True, eq=False)
class Standing:
    """A shape in its place at one time.

    :param name: of the thing; its own bodies may be in each other
    :param turn: [3, 3] from its frame to the world; :param place: [3] of its origin [m]
    :param moves: whether it is elsewhere at other times
    """

    name: str
    shape: Shape
    turn: Real = field(default_factory=lambda: np.eye(3))
    place: Real = field(default_factory=lambda: np.zeros(3))
    moves: bool = False

    @cached_property
    def corners(self) -> Real:
        """[B, 8, 3] of each body's box, in the world [m]; what stands still is asked at many times."""
        return self.shape.corners @ self.turn.T + self.place

    def body(self, number: int, origin: Real) -> Manifold:
        """One of its bodies about an origin [3] near it: float32 is fine there."""
        return self.shape.parts[number].transform(np.hstack([self.turn, (self.place - origin)[:, None]]))


def intersecting(things: Sequence[Standing], moving_only: bool = False) -> list[tuple[str, str, float]]:
    """Pairs of things whose bodies have more in common than a touch, and how thick the thickest of it is [m].

    :param moving_only: leave out pairs of which neither moves
    """
    owner, number, corners = _bodies(things)
    low, high = corners.min(axis=1) + TOUCH_M, corners.max(axis=1) - TOUCH_M
    moves = np.array([thing.moves for thing in things])[owner]
    found: dict[tuple[str, str], float] = {}
    for i in np.flatnonzero(moves) if moving_only else range(len(owner)):
        near = np.flatnonzero(((low < high[i]) & (high > low[i])).all(axis=1) & (owner != owner[i]))
        for j in near[(near > i) | (moving_only & ~moves[near])]:
            one, other = things[owner[i]], things[owner[j]]
            common = one.body(number[i], one.place) ^ other.body(number[j], one.place)
            area = common.surface_area()
            if area > 0.0 and (thickness := 2.0 * common.volume() / area) > TOUCH_M:
                pair = (one.name, other.name)
                found[pair] = max(thickness, found.get(pair, 0.0))
    return [(*pair, thickness) for pair, thickness in found.items()]


def containing(things: Sequence[Standing], point: ArrayLike) -> list[str]:
    """Names of the things that a point [3] is within: a ray from it leaves them once more often than it enters."""
    here = np.asarray(point, dtype=float)
    owner, number, corners = _bodies(things)
    within = ((corners.min(axis=1) <= here) & (corners.max(axis=1) >= here)).all(axis=1)
    beyond = (300.0, 171.0, 83.0)  # along no edge of anything
    names = []
    for n in np.flatnonzero(within):
        hits = things[owner[n]].body(number[n], here).ray_cast((0.0, 0.0, 0.0), beyond)
        if len(hits) % 2:
            names.append(things[owner[n]].name)
    return names


def _bodies(things: Sequence[Standing]) -> tuple[NDArray[np.int64], NDArray[np.int64], Real]:
    """Of all bodies whose they are, [N], which of its bodies, [N], and the corners of their boxes, [N, 8, 3]."""
    owner = np.repeat(np.arange(len(things)), [len(thing.shape.parts) for thing in things])
    number = np.concatenate([np.arange(len(thing.shape.parts)) for thing in things])
    corners = np.concatenate([thing.corners for thing in things])
    return owner, number, corners
