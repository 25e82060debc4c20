"""Which USD prims are things of their own, with a box and a class.

- ``radar:class`` (string or token): class of the prim and everything below it, e.g. ``"car"``. The thing is the prim
  itself where it has a transform. A Scope or a point instancer has none of its own: there each prim directly below, or
  each instance, is a thing.
- Without a class the thing is the prim that states ``radar:velocity``, or the outermost one with samples, or the
  skeleton's root above a skinned mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from datafactory.scenes.chain import Chain
from datafactory.scenes.readers.usd_facts import PrimFacts
from datafactory.scenes.readers.usd_motion import Frame, Transforms
from datafactory.scenes.things import Label
from datafactory.scenes.usd_library import Usd, UsdGeom, UsdSkel


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
        self, prim: Usd.Prim, facts: PrimFacts, frame: Frame, transforms: Transforms, straight: bool
    ) -> Labelling:
        """What holds for a prim and below it.

        :param straight: ``radar:velocity`` holds here, so that samples do not count
        """
        if facts.class_name is None and self.label is not None:
            return self
        found = self
        if facts.class_name is not None:
            found = Labelling(None, facts.class_name, True)
        elif facts.velocity is not None or transforms.moves(prim) or (prim == frame.root and frame.chain is not None):
            found = replace(self, pending=True)
        if not found.pending or facts.is_instancer or not prim.IsA(UsdGeom.Xformable):
            return found
        return Labelling(label_of(prim, frame, transforms, straight, found.class_name), found.class_name)

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
