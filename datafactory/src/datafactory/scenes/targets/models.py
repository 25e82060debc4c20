"""Models of targets by their radar cross section: echo points and their strengths, seen from one position.

A model has its own frame, x forward, y left, z up, metres. It takes the radar's position in that frame and returns echo
points. Their phases follow from their positions. Nothing in them is random but where in its cycle a moving part is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, Field, fields

from datafactory.scenes.targets.bodies import Cylinder, Dihedral, Plate, RcsModel, Sphere, Trihedral
from datafactory.scenes.targets.road_users import Car, Cyclist, Pedestrian

__all__ = [
    "MODELS", "OPTIONS", "ROAD_USERS", "SIZES", "Car", "Cyclist", "Cylinder", "Dihedral", "Pedestrian", "Plate",
    "RcsModel", "Sphere", "Trihedral", "sizes_of", "target_model",
]  # fmt: skip

MODELS: dict[str, type] = {
    "car": Car,
    "pedestrian": Pedestrian,
    "cyclist": Cyclist,
    "sphere": Sphere,
    "cylinder": Cylinder,
    "plate": Plate,
    "dihedral": Dihedral,
    "trihedral": Trihedral,
}
"""Every model by its name in a scene."""

ROAD_USERS = ("car", "pedestrian", "cyclist")
"""Models without sizes: a prim's name alone selects them."""


def sizes_of(kind: str) -> tuple[str, ...]:
    """Names of the sizes [m] that a model needs, e.g. ``("radius_m", "length_m")``."""
    return tuple(item.name for item in fields(MODELS[kind]) if item.default is MISSING)


def options_of(kind: str) -> dict[str, Field]:
    """The fields that a model can do without, by name, e.g. ``wheel_radius_m``."""
    return {item.name: item for item in fields(MODELS[kind]) if item.default is not MISSING}


SIZES = tuple(sorted({name for kind in MODELS for name in sizes_of(kind)}))
OPTIONS = tuple(sorted({name for kind in MODELS for name in options_of(kind)}))


def target_model(kind: str, sizes: Mapping[str, float]) -> RcsModel:
    """The model of this name with these sizes [m] and options.

    :raises ValueError: an unknown name, a size too many or too few, a size that is not above 0 and at most 1000 m, or
        an option outside its bounds
    """
    if kind not in MODELS:
        raise ValueError(f"{kind!r}; expected one of {', '.join(MODELS)}")
    wanted, options = sizes_of(kind), options_of(kind)
    if set(sizes) - options.keys() != set(wanted):
        expected = ", ".join(wanted) or "no sizes"
        more = f", or options {', '.join(options)}" if options else ""
        raise ValueError(f"{kind!r} with {', '.join(sizes) or 'no sizes'}; expected {expected}{more}")
    for name, value in sizes.items():
        if name in options:
            low, high = options[name].metadata["bounds"]
            if not low <= value <= high:
                raise ValueError(f"{kind!r} with {name} = {value!r}; expected {low:g} to {high:g}")
        elif not 0.0 < value <= 1000.0:
            raise ValueError(f"{kind!r} with {name} = {value!r}; expected more than 0 and at most 1000 m")
    model: RcsModel = MODELS[kind](**sizes)
    return model
