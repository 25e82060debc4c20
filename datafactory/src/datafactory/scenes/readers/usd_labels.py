"""Which USD prims are things of their own, with a box and a class, and which are targets of known cross section.

- ``radar:class`` (string or token): class of the prim and everything below it, e.g. ``"car"``. The thing is the prim
  itself where it has a transform. A Scope or a point instancer has none of its own: there each prim directly below, or
  each instance, is a thing.
- Without a class the thing is the prim that states ``radar:velocity``, or the outermost one with samples that differ,
  or the skeleton's root above a skinned mesh; below it a road user with a model is one of its own.
- ``radar:target`` (string or token) names a model; ``"none"`` exempts a prim from the name rule. That rule holds below
  a prim with ``radar:targets_by_name``: placed prims named car, pedestrian or cyclist are those targets. A name may go
  on with anything but a letter: ``Car``, ``car_17`` and ``Pedestrian2``, but neither ``Cars`` nor ``Carport``.

A model's x (forward) and z (up) are those of the USD stage: with Y up they lie along the prim's x and y. The prim's
scale does not change a model's size.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.chain import Chain
from datafactory.scenes.motion import Vector, upright_axes
from datafactory.scenes.readers.common import Notes
from datafactory.scenes.readers.usd_motion import Frame, Transforms
from datafactory.scenes.targets.bodies import Extent
from datafactory.scenes.targets.models import MODELS, OPTIONS, ROAD_USERS, SIZES, RcsModel, target_model
from datafactory.scenes.things import Label
from datafactory.scenes.usd_library import Usd, UsdGeom, UsdSkel
from shared.physics.errors import InputError, meant

EXEMPT = "none"
_BY_NAME = re.compile(rf"({'|'.join(ROAD_USERS)})(?![a-z])", re.IGNORECASE)


@dataclass(frozen=True)
class Labelling:
    """What a prim passes to the prims below it.

    :param label: the thing that they are parts of; None where they are of none
    :param class_name: as an ancestor states it; "" without one
    :param pending: the next prim with a transform is a thing
    """

    label: Label | None = None
    class_name: str = ""
    pending: bool = False

    def below(
        self, prim: Usd.Prim, class_name: str | None, frame: Frame, transforms: Transforms, straight: bool
    ) -> Labelling:
        """What holds for a prim and below it.

        :param class_name: that the prim itself states
        :param straight: ``radar:velocity`` holds here, so that samples do not count
        """
        states_velocity = prim.HasAttribute("radar:velocity")
        if class_name is None and self.label is not None and (self.class_name or not states_velocity):
            return self
        found = self
        if class_name is not None:
            found = Labelling(None, class_name, True)
        elif states_velocity or transforms.moves(prim) or (prim == frame.root and frame.chain is not None):
            found = replace(self, pending=True)
        if not found.pending or prim.IsA(UsdGeom.PointInstancer) or not prim.IsA(UsdGeom.Xformable):
            return found
        return Labelling(label_of(prim, frame, transforms, straight, found.class_name), found.class_name)

    def of_target(
        self, prim: Usd.Prim, kind: str | None, frame: Frame, transforms: Transforms, straight: bool
    ) -> Label | None:
        """The label of a target of this kind: a road user is a thing of its own, not its group's, but for a class."""
        if self.label is None or self.class_name or kind not in ROAD_USERS:
            return self.label
        return label_of(prim, frame, transforms, straight, "")

    def of_shape(self, prim: Usd.Prim, frame: Frame, transforms: Transforms, sampled: bool) -> Label | None:
        """The label of a shape.

        :param sampled: its points have samples
        """
        if self.label is not None or not sampled:
            return self.label
        root = prim
        while root != frame.root and not root.IsPseudoRoot() and not root.IsA(UsdSkel.Root):
            root = root.GetParent()
        thing = root if root.IsA(UsdSkel.Root) else prim
        return label_of(thing, frame, transforms, False, self.class_name)


UNLABELLED = Labelling()


def label_of(prim: Usd.Prim, frame: Frame, transforms: Transforms, straight: bool, class_name: str) -> Label:
    """The label of a prim that is a thing.

    :param straight: see :meth:`Labelling.below`
    """
    chain = transforms.chain(prim, frame)
    if chain is None or straight:
        way = Chain((transforms.to_world @ transforms.matrix(prim, frame),))
    else:
        way = Chain((transforms.to_world,)).then(*chain.factors)
    return Label(frame.name(prim), way, class_name)


OF_PRIMS = ("class", "material", "rcs_dbsm", "target", "targets_by_name", "velocity")
"""What any prim may state in the namespace ``radar:``."""
OF_SUBSETS = ("material", "velocity")
"""What of it a subset of a mesh's faces may state for itself."""
OF_MODELS = (*SIZES, *OPTIONS)
"""What a prim may state there that is the model of a target."""


def note_unread(prim: Usd.Prim, kind: str | None, notes: Notes) -> None:
    """Count the ``radar:`` attributes of a prim that nothing reads, and those that are read at the start alone.

    :param kind: the model that the prim calls for
    """
    for item in prim.GetAuthoredPropertiesInNamespace("radar"):
        name = item.GetName().removeprefix("radar:")
        if isinstance(item, Usd.Attribute) and item.ValueMightBeTimeVarying():
            notes.count(f"# attributes radar:{name} have time samples: taken as at the start")
        if name not in (*OF_PRIMS, *OF_MODELS):
            near = meant(name, (*OF_PRIMS, *OF_MODELS))
            notes.count(f"# attributes radar:{name} ignored: there is no such name{near}")
        elif name in OF_MODELS and kind is None:
            notes.count(f"# attributes radar:{name} ignored: their prim is no radar:target that has a model")
        elif name not in OF_SUBSETS and prim.IsA(UsdGeom.Subset):
            notes.count(f"# attributes radar:{name} ignored: a mesh may state it, a subset of its faces not")


def target_kind(path: Path, prim: Usd.Prim, time: Usd.TimeCode, by_name: bool) -> str | None:
    """The model that a prim calls for, by attribute or else by name; None where it calls for none.

    :param by_name: whether the name rule holds here
    :raises InputError: a ``radar:target`` that names no model, or stands beside ``radar:rcs_dbsm``
    """
    if prim.HasAttribute("radar:target"):
        kind = prim.GetAttribute("radar:target").Get(time)
        if kind == EXEMPT:
            return None
        if not isinstance(kind, str) or kind not in MODELS:
            expected = f"one of {', '.join(MODELS)} or {EXEMPT}"
            raise InputError(path, f"{prim.GetPath()}.radar:target = {kind!r}", expected)
        if prim.HasAttribute("radar:rcs_dbsm"):
            raise InputError(path, f"{prim.GetPath()} has radar:target and radar:rcs_dbsm", "one of the two")
        return kind
    if prim.HasAttribute("radar:rcs_dbsm") or not by_name or not prim.IsA(UsdGeom.Xformable):
        return None
    named = _BY_NAME.match(prim.GetName())
    return named.group(1).lower() if named else None


def prim_model(path: Path, prim: Usd.Prim, time: Usd.TimeCode, kind: str) -> RcsModel:
    """The model of this kind with the sizes that the prim states.

    :raises InputError: a size that is missing, not wanted, or no usable length
    """
    sizes = {}
    for name in OF_MODELS:
        if prim.HasAttribute(f"radar:{name}"):
            value = prim.GetAttribute(f"radar:{name}").Get(time)
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise InputError(path, f"{prim.GetPath()}.radar:{name} = {value!r}", "a length [m], or a number")
            sizes[name] = float(value)
    try:
        return target_model(kind, sizes)
    except ValueError as error:
        raise InputError(path, f"{prim.GetPath()}.radar:target = {error}") from error


def model_axes(local: NDArray[np.float64], turn: NDArray[np.float64]) -> tuple[Vector, Vector, Vector] | None:
    """World directions of a model's x, y and z, right-handed and orthonormal; None where the transform is flat.

    :param local: [3, 3] from the prim to the USD stage, columns the prim's axes; scale, shear and mirrors have no
        effect
    :param turn: [3, 3] rotation from the USD stage's axes to the world's
    """
    # The model's axes are the world's. ``turn.T`` brings them to the USD stage's, ``turn`` brings the result back.
    matrix = turn @ local @ turn.T
    return upright_axes(matrix[:, 0], matrix[:, 2]) if np.isfinite(matrix).all() else None


def occupied_below(
    prim: Usd.Prim, time: Usd.TimeCode, linear: NDArray[np.float64], axes: tuple[Vector, Vector, Vector]
) -> Extent | None:
    """Lower and upper corner along ``axes`` [m] of the geometry that a point target stands for; None where it is empty.

    :param linear: [3, 3] from the prim's axes to the world's, scale included
    """
    bound = UsdGeom.Imageable(prim).ComputeUntransformedBound(time, UsdGeom.Tokens.default_, UsdGeom.Tokens.render)
    box = bound.ComputeAlignedRange()
    if box.IsEmpty():
        return None
    corners = np.array([tuple(box.GetCorner(n)) for n in range(8)], dtype=np.float64)
    along = corners @ linear.T @ np.array(axes).T
    if not np.isfinite(along).all():
        return None
    (a, b, c), (d, e, f) = along.min(axis=0).tolist(), along.max(axis=0).tolist()
    return (a, b, c), (d, e, f)
