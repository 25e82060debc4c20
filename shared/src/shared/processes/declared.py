"""How options are declared: each once, as a field of a value, which commands and functions are made to take.

A field is ``name: Annotated[type, Option(help, ...)] = default``, in a module whose annotations are not postponed. A
value checks itself when it is made, so that both refuse the same things in the same words. :func:`taking` makes a
function's parameters of the fields, and :func:`shared.cli.options.asking` a command's. Nothing here computes:
``--help`` imports it.
"""

import inspect
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import update_wrapper
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, ClassVar, ForwardRef, NamedTuple, ParamSpec, TypeVar, dataclass_transform, get_args

from shared.physics.errors import InputError, meant

P = ParamSpec("P")
R = TypeVar("R")
A = TypeVar("A", bound="Options")

HEADINGS = ("", "Scene", "Sensor", "Sampling", "Effects and accuracy", "Output", "Execution")
"""Of groups, in the order in which help has them; the first is for all others."""


PLAIN: dict[type, tuple[type | tuple[type, ...], str]] = {
    int: (Integral, "a whole number"), float: (Real, "a number"), str: (str, "a text"), NoneType: (NoneType, "None"),
    Path: ((str, PathLike), "a path"),
}  # fmt: skip
"""Types that are checked: what a value is to be, and how a user is told. Of other types any value is taken here."""


@dataclass(frozen=True)
class Option:
    """What is to be known of an option beside its name, its type and its default.

    :param help: for commands and functions alike
    :param python: what a function's caller is told as well
    :param least, most: bounds, which are allowed themselves
    :param choices: what a text may be
    :param typed: the type on the command line, where a function takes more than can be typed
    :param flag: the option's name there, where it is not that of the field; None: it is given by its place alone
    :param metavar: what stands there for the value
    :param place: what stands there for the value of an option that may also be given by its place
    :param placed: what help says of the value that is given by its place, where the option has a name as well
    :param read: makes the value of what is typed
    :param usual: the default that help shows, where the field's is another: what is not stated may follow from the
        rest
    :param otherwise: what help says in words in place of a default
    :param there: the default on the command line, where it is another one
    :param several: whether it is a sequence, for which a function takes a lone value as well
    :param shown: whether commands have it
    :param first: whether a newcomer needs it: help shows these before the others, which stand under headings
    """

    help: str
    python: str = ""
    least: float = float("-inf")
    most: float = float("inf")
    choices: tuple[str, ...] = ()
    typed: Any = None
    flag: str | None = ""
    metavar: str | None = None
    place: str | None = None
    placed: str = ""
    read: Callable[[Any], Any] | None = None
    usual: Any = None
    otherwise: str | None = None
    there: Any = None
    several: bool = False
    shown: bool = True
    first: bool = False

    @property
    def bounds(self) -> str:
        """What a number may be, as a user reads it; "" where it may be any."""
        if self.most < float("inf"):
            return f"{self.least:.12g} to {self.most:.12g}"
        return f"at least {self.least:g}" if self.least > float("-inf") else ""


class Declared(NamedTuple):
    """An option of a group: its type, as text where only a type checker imports it, and its heading in help."""

    name: str
    flag: str
    annotation: Any
    default: Any
    heading: str
    option: Option

    def checked(self, value: Any) -> Any:
        """The value, a number of another library as Python's own, a path's text as a path.

        :raises InputError: an empty text, a place below ~, none of the choices, a value of another type than a plain
            one, or out of bounds
        """
        for text in value if isinstance(value, list | tuple) else (value,):
            self._require_usable(text)
        choices, bounds = self.option.choices, self.option.bounds
        if choices and value is not None and value not in choices:
            raise InputError(self.flag, repr(value), f"one of {', '.join(choices)}{meant(str(value), choices)}")
        kinds = get_args(self.annotation) if isinstance(self.annotation, UnionType) else (self.annotation,)
        no_number = isinstance(value, bool) and bool not in kinds and (int in kinds or float in kinds)
        if no_number or not any(isinstance(value, PLAIN.get(kind, (object, ""))[0]) for kind in kinds):
            plain = " or ".join(PLAIN[kind][1] for kind in kinds)
            raise InputError(self.flag, repr(value), ", ".join(filter(None, (plain, bounds))))
        if bounds and value is not None and not self.option.least <= value <= self.option.most:
            raise InputError(self.flag, repr(value), bounds)
        if isinstance(value, Real) and (int in kinds or float in kinds):
            return int(value) if isinstance(value, Integral) else float(value)
        if self.option.several and value is not None:
            return tuple(value) if isinstance(value, Iterable) and not isinstance(value, str) else (value,)
        return Path(value) if Path in kinds and str not in kinds and value is not None else value

    def _require_usable(self, text: Any) -> None:
        """Refuse the text of an unset variable, which as a place is the current folder, and a ~ that the shell left as
        it is, as in ``--out=~/data``: a folder of that name would be made."""
        if isinstance(text, str) and not text:
            raise InputError(self.flag, "''", "a text that is not empty")
        if isinstance(text, str | PathLike) and re.match(r"~(/|$)", str(text)):
            raise InputError(self.flag, f"{str(text)!r}: ~ was not replaced by the home folder", "the path without ~")


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(field,))
class Options:
    """A group of options, a frozen value: its fields can be told by their names alone, unless they say otherwise.

    A group may be made of others.
    """

    heading: ClassVar[str] = ""

    def __init_subclass__(cls, heading: str = "") -> None:
        cls.heading = heading or cls.heading
        dataclass(frozen=True, kw_only=True)(cls)

    def __post_init__(self) -> None:
        """:raises InputError: see :meth:`Declared.checked`"""
        for item in declared(type(self)):
            vars(self)[item.name] = item.checked(getattr(self, item.name))


def declared(group: Callable[..., Options]) -> list[Declared]:
    """The options of a group; the heading of each is that of the group that has it first."""
    assert isinstance(group, type)
    found = []
    headings = {name: vars(one)["heading"] for one in group.__mro__ for name in inspect.get_annotations(one)}
    for name, parameter in inspect.signature(group).parameters.items():
        kind, (option,) = parameter.annotation.__origin__, parameter.annotation.__metadata__
        kind = kind.__forward_arg__ if isinstance(kind, ForwardRef) else kind
        flag = option.place or name if option.flag is None else option.flag or f"--{name.replace('_', '-')}"
        found.append(Declared(name, flag, kind, parameter.default, headings[name], option))
    return found


def common(group: type[A], given: Options, **others: Any) -> A:
    """What a group has in common with a value of another one; the rest at its defaults, or as ``others`` says."""
    names = {item.name for item in declared(group)} & vars(given).keys()
    return group(**{name: vars(given)[name] for name in names} | others)


def taking(group: Callable[P, A]) -> Callable[[Callable[[A], R]], Callable[P, R]]:
    """Make a function of a value one that takes the value's options, with their signature and documentation."""

    def made(function: Callable[[A], R]) -> Callable[P, R]:
        options, signature = declared(group), inspect.signature(group)
        parameters = zip(signature.parameters.values(), options, strict=True)
        signature = inspect.Signature(
            [parameter.replace(annotation=item.annotation) for parameter, item in parameters],
            return_annotation=function.__annotations__["return"],
        )

        def called(*given: P.args, **named: P.kwargs) -> R:
            signature.bind(*given, **named)  # what is not taken is an error of this function, not of its group
            return function(group(*given, **named))

        update_wrapper(called, function, ("__module__", "__name__", "__qualname__"), ())
        vars(called)["__signature__"] = signature
        names = {item.flag: f"``{item.name}``" for item in options}
        lines = [f":param {item.name}: {meaning(item.option, names)}\n" for item in options]
        said, *rest = re.split(r"^(?=:returns|:raises)", inspect.getdoc(function) or "", maxsplit=1, flags=re.MULTILINE)
        called.__doc__ = f"{said.rstrip()}\n\n{''.join(lines)}{''.join(rest)}"
        return called

    return made


def meaning(option: Option, names: Mapping[str, str]) -> str:
    """What a function's caller is told of an option.

    :param names: those of parameters, in place of what they are called on the command line
    """
    said = re.sub(r"--[a-z][a-z-]*", lambda flag: names.get(flag[0], flag[0]), option.help)
    usual = "" if option.usual is None else f"{option.usual} by default."
    lone = "A lone one needs no list." if option.several else ""
    return " ".join(filter(None, (said, usual, option.python, lone)))


def either(names: Iterable[str]) -> str:
    """``"a, b or c"``"""
    *others, last = names
    return f"{', '.join(others)} or {last}" if others else last
