"""The reference pages, from pydantic models, Typer commands and docstrings: name -> Markdown.

A model's fields are described by the ``:param`` lines of its docstring. A field without a line, or a line without a
field, is an error: a field that is renamed is renamed in its description too.
"""

from __future__ import annotations

import inspect
import pkgutil
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from pydantic import BaseModel

ROOMS = ("shared.physics", "shared.radar", "shared.signal", "shared.dataset", "trainer.estimators", "trainer.metrics")
"""Packages whose modules have a page of their docstrings, beside the public names of datafactory and trainer."""


@cache
def reference_pages() -> Mapping[str, str]:
    """Every generated page by its file name."""
    return {
        "radar.md": radar_page(),
        "materials.md": materials_page(),
        "fit.md": fit_page(),
        "datafactory.md": commands_page("datafactory"),
        "trainer.md": commands_page("trainer"),
        **{f"api-{package}.md": names_page(package) for package in ("datafactory", "trainer") if public_names(package)},
        **{f"api-{room}.md": room_page(room) for room in ROOMS},
    }


def contents() -> str:
    """A list of links to the pages, for the index."""
    titles = {name: text.partition("\n")[0].removeprefix("# ") for name, text in reference_pages().items()}
    return "\n## Pages\n\n" + "".join(f"- [{title}]({name})\n" for name, title in titles.items())


def descriptions(model: type[BaseModel]) -> dict[str, str]:
    """What the docstring says of each field, in the model's order.

    :raises ValueError: a field without a ``:param`` line, or a line without a field
    """
    lines = re.findall(r"^:param (\w+): (.*?)(?=^:|^\S|\Z)", inspect.getdoc(model) or "", re.DOTALL | re.MULTILINE)
    said = {name: " ".join(text.split()) for name, text in lines}
    fields = [name for name, schema in properties(model).items() if "const" not in schema]
    if missing := [name for name in fields if name not in said]:
        raise ValueError(f"{model.__name__}: no :param line for {missing[0]}")
    if unknown := [name for name in said if name not in fields]:
        raise ValueError(f"{model.__name__}: :param {unknown[0]}, which is no field")
    return {name: said[name] for name in fields}


def properties(model: type[BaseModel]) -> dict[str, dict[str, Any]]:
    """The JSON schema of each field."""
    found: dict[str, dict[str, Any]] = model.model_json_schema()["properties"]
    return found


def kind(schema: Mapping[str, Any]) -> str:
    """A JSON schema in words: ``number > 0``, ``"V" or "H"``, a list of numbers."""
    if "$ref" in schema:
        return f"table `{schema['$ref'].rpartition('/')[2]}`"
    for several in ("anyOf", "oneOf"):
        if several in schema:
            return " or ".join(kind(one) for one in schema[several] if one.get("type") != "null")
    if "enum" in schema:
        return " or ".join(f'`"{value}"`' for value in schema["enum"])
    if "const" in schema:
        return f'`"{schema["const"]}"`'
    if schema.get("type") == "array":
        inner = schema.get("items") or (schema.get("prefixItems") or [{}])[0]
        count = schema.get("maxItems") if schema.get("maxItems") == schema.get("minItems") else None
        return f"list of {f'{count} x ' if count else ''}{kind(inner)}"
    words = {"number": "number", "integer": "integer", "string": "text", "boolean": "true or false", "object": "table"}
    name = words.get(schema.get("type", ""), "value")
    signs = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
    bounds = [f"{sign} {number(schema[key])}" for key, sign in signs.items() if key in schema]
    return f"{name} {', '.join(bounds)}".strip()


def number(value: float) -> str:
    """Short, and exact: 7.7e+10, 65536."""
    short = f"{value:g}"
    return short if float(short) == value else str(value)


def default(model: type[BaseModel], name: str) -> str:
    """The default of a field, short enough for a table."""
    field = model.model_fields[name]
    if field.is_required():
        return "required"
    if field.default_factory is not None or isinstance(field.default, BaseModel):
        return "see the table"
    if field.default is None:
        return "none"
    if isinstance(field.default, str):
        return f'`"{field.default}"`'
    if isinstance(field.default, float):
        return f"`{number(field.default)}`"
    text = str(field.default).lower() if isinstance(field.default, bool) else str(field.default)
    return f"`{text}`" if text not in ("()", "[]") else "none"


def fields_table(model: type[BaseModel]) -> str:
    """Name, type and limits, default and meaning of each field."""
    schemas = properties(model)
    rows = [
        (f"`{name}`", kind(schemas[name]), default(model, name), meaning)
        for name, meaning in descriptions(model).items()
    ]
    return table(("key", "value", "default", "meaning"), rows)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(_cell(cell) for cell in line) + " |\n" for line in lines) + "\n"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("``", "`")


def first_paragraph(thing: object) -> str:
    """Of a docstring, with roles as plain code."""
    paragraph = (inspect.getdoc(thing) or "").partition("\n\n")[0]
    return _plain(" ".join(paragraph.split()))


def _plain(text: str) -> str:
    """Roles and code of a docstring as code of Markdown."""
    return re.sub(r":\w+:`([^`]+)`", r"`\1`", text).replace("``", "`")


def radar_page() -> str:
    from shared.radar import antenna
    from shared.radar.arrays import AntennaArray
    from shared.radar.front_end import Converter, FrontEnd, PhaseNoise
    from shared.radar.loading import PRESETS
    from shared.radar.profile import ChirpProfile
    from shared.radar.radar import ImageGrid, Radar
    from shared.radar.waveform import Waveform

    tables: list[tuple[str, type[BaseModel]]] = [
        ("[waveform]", Waveform),
        ("[array] and [virtual_sensor]", AntennaArray),
        ("[front_end]", FrontEnd),
        ("phase_noise of [front_end]", PhaseNoise),
        ("converter of [front_end]", Converter),
        ("[grid]", ImageGrid),
        ("[capture]", ChirpProfile),
    ]
    patterns = (
        antenna.IsotropicPattern, antenna.ParabolicPattern, antenna.PatchPattern, antenna.Tr38901Pattern,
        antenna.TablePattern,
    )  # fmt: skip
    text = "# The radar's TOML file\n\n"
    text += f"Presets: {', '.join(f'`{name}`' for name in PRESETS)}.\n\n"
    text += "A file states only what differs from the default radar, or from the board that `board` names.\n\n"
    text += "## Top level\n\n" + fields_table(Radar)
    text += 'Beside these: `board = "NAME"`, `mirror = true`, and `capture`, a table or the name of a `.cfg` file.\n\n'
    for title, model in tables:
        text += f"## {title}\n\n{first_paragraph(model)}\n\n{fields_table(model)}"
    for pattern in patterns:
        name = properties(pattern)["kind"]["const"]
        text += f'## Pattern kind = "{name}"\n\n{first_paragraph(pattern)}\n\n'
        if descriptions(pattern):
            text += fields_table(pattern)
    return text


def materials_page() -> str:
    from datafactory.scenes.materials.table import MaterialEntry, MaterialFile, load_materials

    text = "# The file of materials\n\n## Top level\n\n" + fields_table(MaterialFile)
    text += f"## [material.NAME]\n\n{first_paragraph(MaterialEntry)}\n\n{fields_table(MaterialEntry)}"
    rows = [
        (
            f"`{material.name}`", f"{material.relative_permittivity:g}", f"{material.conductivity_s_per_m:g}",
            f"{material.scattering_coefficient:.3f}", material.source, "; ".join(material.assumptions),
        )
        for material in load_materials().materials.values()
    ]  # fmt: skip
    head = ("name", "relative permittivity", "conductivity [S/m]", "S", "source", "assumptions")
    return text + "## The built-in table\n\nAt 77 GHz. S is the scattering coefficient.\n\n" + table(head, rows)


def fit_page() -> str:
    from trainer.run.configuration import FitConfig

    return f"# The settings of trainer fit\n\n{first_paragraph(FitConfig)}\n\n{fields_table(FitConfig)}"


def commands_page(program: str) -> str:
    """Every command of a program with its arguments and options."""
    import typer

    group: Any = typer.main.get_command(import_module(f"{program}.cli.app").app)
    text = f"# {program}\n\n{group.help}\n\n"
    for name, command in group.commands.items():
        rows = [_option(parameter) for parameter in command.params if not getattr(parameter, "hidden", False)]
        text += f"## {program} {name}\n\n{_unescaped(command.help)}\n\n"
        text += table(("option", "value", "default", "meaning"), rows)
    return text


def _option(parameter: Any) -> tuple[str, str, str, str]:
    if parameter.param_type_name == "argument":
        names = parameter.metavar or parameter.name.upper()
    else:
        names = ", ".join([*parameter.opts, *parameter.secondary_opts])
    flag = getattr(parameter, "is_flag", False)
    value = "" if flag else _value(parameter)
    if parameter.required:
        given = "required"
    elif parameter.default is None or parameter.default == [] or (flag and parameter.default is False):
        given = ""
    else:
        given = f"`{parameter.default}`"
    return f"`{names}`", value, given, _unescaped(parameter.help)


def _value(parameter: Any) -> str:
    """Type and bounds of what follows an option."""
    annotation = parameter.type_descriptor.annotation
    several = getattr(annotation, "__origin__", None) is list
    inner = annotation.__args__[0] if several else annotation
    name = {str: "text", int: "whole number", float: "number", Path: "path"}.get(inner, "value")
    bounds = [
        f"{sign} {number(limit)}" for sign, limit in ((">=", parameter.min), ("<=", parameter.max)) if limit is not None
    ]
    return f"{name} {', '.join(bounds)}".strip() + (", repeated" if several else "")


def _unescaped(text: str | None) -> str:
    """Help texts are escaped for Rich."""
    return (text or "").replace("\\[", "[").partition("\f")[0]


def public_names(package: str) -> list[str]:
    """What a package says may be imported from it."""
    return list(getattr(import_module(package), "__all__", []))


def names_page(package: str) -> str:
    """The public names of a package, each where it is defined."""
    text = f"# from {package} import ...\n\n{first_paragraph(import_module(package))}\n\n"
    for name in public_names(package):
        thing = getattr(import_module(package), name)
        module = getattr(thing, "__module__", None)
        if module is None or inspect.ismodule(thing):
            text += f"## {package}.{name}\n\n{first_paragraph(thing)}\n\n"
        elif inspect.isfunction(thing) and hasattr(thing, "__signature__"):
            text += f"## {package}.{name}\n\n{function_of_options(thing)}"
        else:
            text += f"::: {module}.{name}\n\n"
    return text


def function_of_options(function: Any) -> str:
    """What a function's docstring says, with its parameters in a table: they are made of options."""
    said, *fields = re.split(r"^:(?=param|returns|raises)", inspect.getdoc(function) or "", flags=re.MULTILINE)
    meanings = dict(_plain(field).removeprefix("param ").split(": ", 1) for field in fields)
    rows = []
    for name, parameter in inspect.signature(function).parameters.items():
        kind, default = parameter.annotation, f"`{parameter.default!r}`"
        if parameter.default is parameter.empty:
            default = "required"
        elif parameter.default is None or inspect.isfunction(parameter.default):
            default = ""
        rows.append((f"`{name}`", f"`{getattr(kind, '__name__', kind)}`", default, meanings.pop(name)))
    example = re.compile(r"^>>> (.*?)( +# doctest.*)?$", re.MULTILINE)
    text = example.sub(r"~~~python\n\1\n~~~", _plain(said)).strip() + "\n\n"
    text += table(("parameter", "value", "default", "meaning"), rows)
    return text + "".join(f"- {name}: {' '.join(meaning.split())}\n" for name, meaning in meanings.items()) + "\n"


def room_page(room: str) -> str:
    """The docstrings of all modules of a package."""
    package = import_module(room)
    modules = [f"{room}.{module.name}" for module in pkgutil.iter_modules(package.__path__)]
    return f"# {room}\n\n{first_paragraph(package)}\n\n" + "".join(f"::: {name}\n\n" for name in modules)
