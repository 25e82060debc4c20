"""What a city is made from: its options, validated, and what they are written as."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from datafactory.scenes.city.style import MOST_BLOCKS, Style
from shared.physics.errors import InputError
from shared.processes.defaults import LARGEST_SEED

VERSION = 3
"""Of the generator: the same options, version and kind of file give the same bytes."""


class CityOptions(BaseModel):
    """The options of a procedural city.

    :param seed: of the NumPy generator that all choices are drawn from
    :param style: which kinds of streets and buildings
    :param blocks: house blocks along the main street, with a cross street between neighbours
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    seed: Annotated[int, Field(ge=0, le=LARGEST_SEED)] = 0
    style: Style = Style.OLD_TOWN
    blocks: Annotated[int, Field(ge=1, le=MOST_BLOCKS)] = 2

    @staticmethod
    def checked(**values: Any) -> CityOptions:
        """The options, if they are valid.

        :raises InputError: the first that is not, with its value and what would be right
        """
        try:
            return CityOptions(**values)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            name = str(first["loc"][0])
            right = first["msg"][0].lower() + first["msg"][1:]
            raise InputError(f"city {name}", f"{name} = {first['input']!r}", right) from None

    def metadata(self) -> dict[str, Any]:
        """For the file's metadata."""
        return {"style": self.style.value, "seed": self.seed, "blocks": self.blocks, "version": VERSION}
