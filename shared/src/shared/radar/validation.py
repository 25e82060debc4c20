"""Documents as values of pydantic's models, and what is wrong with them in the one line of an :class:`InputError`."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError, model_validator

from shared.physics.errors import InputError, meant

Place = tuple[int | str, ...]
"""Of a value in a document: names of tables and fields, numbers in lists."""

WORDS = {
    "missing": "a value",
    "greater_than": "more than {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "less than {lt}",
    "less_than_equal": "at most {le}",
    "finite_number": "a finite number",
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "a whole number"),
    **dict.fromkeys(("float_type", "float_parsing"), "a number"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false"),
    "string_type": "text",
    **dict.fromkeys(("tuple_type", "list_type"), "a list"),
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type"), "a table of fields"),
    "too_short": "{min_length} or more entries",
    "too_long": "at most {max_length} entries",
    "union_tag_not_found": "an entry {discriminator} as well",
    "union_tag_invalid": "{discriminator} to be one of {expected_tags}",
}
"""What would be right, by the kind of pydantic's error; the others begin with "Input should be"."""


class Described(BaseModel, frozen=True, extra="forbid"):
    """A frozen description. Text, true and false are no numbers in it, and text and numbers neither true nor false,
    though pydantic would take them."""

    @model_validator(mode="before")
    @classmethod
    def _as_they_are_meant(cls, given: Any) -> Any:
        for name, field in cls.model_fields.items() if isinstance(given, dict) else ():
            kinds = _kinds(field.annotation)
            for place, value in _values(given.get(name), (name,)):
                if kinds and kinds <= {int, float} and isinstance(value, str | bool):
                    raise _fault(cls, place, value, "int_type" if kinds == {int} else "float_type")
                if kinds == {bool} and not isinstance(value, bool | None):
                    raise _fault(cls, place, value, "bool_type")
        return given


def _fault(model: type[BaseModel], place: Place, value: object, kind: str) -> ValidationError:
    """That of a field, as pydantic would tell it."""
    fault: Any = {"type": kind, "loc": place, "input": value}
    return ValidationError.from_exception_data(model.__name__, [fault])


def _kinds(annotation: object) -> set[object]:
    """The types that a value, or an entry of a tuple, may have, without their bounds; None is left out."""
    if get_origin(annotation) is Annotated:
        return _kinds(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType, tuple):
        return set[object]().union(*map(_kinds, get_args(annotation)))
    return {annotation} - {NoneType, Ellipsis}


def _values(given: object, place: Place) -> Iterator[tuple[Place, object]]:
    """A value, or the entries of a list with their places in it, in their order."""
    left = [(place, given)]
    while left:
        where, value = left.pop()
        if isinstance(value, list | tuple):
            left += [((*where, index), entry) for index, entry in enumerate(value)][::-1]
        else:
            yield where, value


def first_validation_error(error: ValidationError, place: str = "", keys: Iterable[str] = ()) -> tuple[str, str]:
    """The first fault of a pydantic validation as (field and value, what would be right).

    :param place: where the fields stand, put before the field, e.g. ``"line 3, "``
    :param keys: the fields that there are, named where one is unknown
    """
    fault = error.errors(include_url=False)[0]
    # Of a field that may be of several types pydantic names the one that it tried, as tuple[float, float].
    parts = [str(part) for part in fault["loc"] if "[" not in str(part)]
    field = place + ".".join(parts) if parts else "document"
    if fault["type"] == "extra_forbidden":
        known = list(keys)
        near = meant(str(fault["loc"][-1]), known)
        return f"unknown field {field}", f"one of {', '.join(known)}{near}" if known else "a field of this table"
    if fault["type"] == "value_error":
        text, name = str(fault["ctx"]["error"]), field.rpartition(".")[2]
        # A field's own check names it too, and that of several fields names them.
        named = f"{field}{text[len(name) :]}" if text.startswith(f"{name} = ") else f"{field}: {text}"
        return named if fault["loc"] else text, ""
    value = "missing" if fault["type"] == "missing" else f"= {fault['input']!r}"
    return f"{field} {value}", _expected(fault)


def _expected(fault: Mapping[str, Any]) -> str:
    if fault["type"] in WORDS:
        told = fault.get("ctx", {})
        return WORDS[fault["type"]].format_map({k: f"{v:g}" if isinstance(v, float) else v for k, v in told.items()})
    said = fault["msg"].removeprefix("Input should be ")
    return said[0].lower() + said[1:]


Model = TypeVar("Model", bound=BaseModel)


def validated(
    model: type[Model], document: object, source: object, others: Iterable[str] = (), place: str = ""
) -> Model:
    """A document as a value of ``model``.

    :param source: of the document, for the message
    :param others: entries that it might have had beside the fields of ``model``
    :param place: where in the source it stands, see :func:`first_validation_error`
    :raises InputError: a field that is missing, unknown or wrong
    """
    try:
        return model.model_validate(document)
    except ValidationError as error:
        within = error.errors()[0]["loc"]
        known = [*_fields_at(model, within), *(others if len(within) == 1 else ())]
        raise InputError(source, *first_validation_error(error, place, known)) from error


def _fields_at(model: type[BaseModel], place: Place) -> list[str]:
    """The fields of the table in which the last part of a fault's place stands; none where that is left open."""
    models = [model]
    for part in place[:-1]:
        if isinstance(part, int):
            continue  # of a list: its annotation was looked at with the list's
        # Where a table may be one of several models, pydantic names the one by its ``kind``.
        fields = [(one, one.model_fields) for one in models]
        named = [one for one, has in fields if "kind" in has and has["kind"].default == part]
        models = named or [inner for _, has in fields if part in has for inner in _models_in(has[part].annotation)]
    return list(models[0].model_fields) if len(models) == 1 else []


def _models_in(annotation: object) -> list[type[BaseModel]]:
    kinds = (annotation, *get_args(annotation))
    return [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]


def read_toml(path: Path, expected: str = "a TOML file in UTF-8") -> dict[str, Any]:
    """The entries of a TOML file, which may begin with the mark that editors of Windows write.

    :raises InputError: missing, not UTF-8, not TOML
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError, OSError) as error:
        raise InputError(path, f"not readable as TOML: {error}", expected) from error
