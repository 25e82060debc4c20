"""How commands are made to take options that are declared as :mod:`shared.processes.declared` says."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from inspect import Parameter
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from shared.physics.errors import InputError
from shared.processes.declared import HEADINGS, Declared, Options, declared

A = TypeVar("A", bound=Options)
BY_PLACE = "_by_place"
"""Behind an option's name: the parameter that takes what was given by its place."""


def asking(group: type[A]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a function of a group of options a command that takes them.

    What the function takes beside its first parameter stays as Typer understands it.
    """
    options = sorted(
        (item for item in declared(group) if item.option.shown),
        key=lambda item: (item.option.flag is not None, HEADINGS.index(item.heading)),
    )

    def made(function: Callable[..., None]) -> Callable[..., None]:
        beside = list(inspect.signature(function, eval_str=True).parameters.values())[1:]

        def called(context: typer.Context, **given: Any) -> None:
            own = {parameter.name: given[parameter.name] for parameter in beside}
            function(group(**_stated(options, context, given)), **own)

        parameters = [_parameter("context", typer.Context)]
        parameters += [parameter for item in options for parameter in _parameters(item)]
        parameters += [parameter.replace(kind=Parameter.KEYWORD_ONLY) for parameter in beside]
        vars(called)["__signature__"] = inspect.Signature(parameters)
        called.__name__, called.__doc__ = function.__name__, function.__doc__
        return called

    return made


def _parameters(item: Declared) -> list[Parameter]:
    """Typer's of an option; one that a newcomer needs has no heading: those without come first."""
    option, found = item.option, []
    kind, default, flag = option.typed or item.annotation, item.default, item.flag
    # A Path of '' would be the current folder; the group makes one of the text.
    as_typed = str if item.annotation in (Path, Path | None) and option.typed is None else None
    if (default is True or option.there is True) and kind is bool:
        flag += f"/--no-{flag[2:]}"
    if option.flag is None:
        declaration = typer.Argument(metavar=option.place, help=option.help, path_type=as_typed)
        return [_parameter(item.name, kind, default, declaration)]
    if default in (None, ()) or option.place:
        kind, default = kind | None, None
    if option.place:
        placed = typer.Argument(metavar=option.place, help=option.placed, path_type=as_typed)
        found.append(_parameter(item.name + BY_PLACE, kind, None, placed))
    least, most = (None if abs(bound) == float("inf") else bound for bound in (option.least, option.most))
    panel = None if option.first else item.heading or None
    declaration = typer.Option(
        flag, min=least, max=most, metavar=option.metavar, help=option.help, rich_help_panel=panel,
        show_default=option.otherwise or True, path_type=as_typed,
    )  # fmt: skip
    for other in (option.usual, option.there) if option.otherwise is None else ():
        default = default if other is None else other
    return [*found, _parameter(item.name, kind, default, declaration)]


def _parameter(name: str, kind: Any, default: Any = Parameter.empty, declaration: Any = None) -> Parameter:
    annotation = kind if declaration is None else Annotated[kind, declaration]
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _stated(options: list[Declared], context: typer.Context, given: dict[str, Any]) -> dict[str, Any]:
    """What the user said, by place or by name, and defaults that are the command line's own.

    :raises InputError: one value by its place and another by its name
    """
    said = {}
    for item in options:
        name, option = item.name, item.option
        source = context.get_parameter_source(name)
        stated = source is not None and source.name != "DEFAULT"
        if option.place and option.flag:
            placed, named = given[name + BY_PLACE], given[name]
            if option.place.endswith("..."):
                said[name] = [*(placed or ()), *(named or ())]
            elif placed is not None and named is not None:
                raise InputError(item.flag, f"{named!r} beside {placed!r}", f"one {name}")
            else:
                said[name] = named if placed is None else placed
        elif stated and option.read is not None:
            said[name] = option.read(given[name])
        elif stated:
            said[name] = given[name]
        elif option.there is not None:
            said[name] = option.there
    return said
