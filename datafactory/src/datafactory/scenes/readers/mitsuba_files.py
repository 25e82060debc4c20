"""The files of a Mitsuba 3 scene as one list of elements: includes in place, defaults substituted.

Mitsuba's own parser is not used: importing Mitsuba loads Dr.Jit, and Dr.Jit then loads the first libLLVM that it finds.
Python's parser fetches no external entity, and expat bounds the expansion of internal ones. Here the nesting of
elements and includes is bounded, the length of substituted values, and the number of objects before any is expanded.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

from datafactory.scenes.readers.limits import LONGEST_VALUE, MAXIMUM_NESTING, MAXIMUM_OBJECTS, figure
from shared.physics.errors import InputError

INCLUDE_DEPTH = 15  # Mitsuba's limit
PARAMETER = re.compile(r"\$(\w+)")


def read_elements(path: Path) -> list[ElementTree.Element]:
    """The elements of a scene, those of included files in the place of the include.

    :raises InputError: malformed XML, an undefined parameter, elements or includes nested too deeply, includes that
        make more objects than a scene may hold
    """
    _Includes(path).check()
    return list(_expanded_elements(path, path, {}, 0))


class _ShallowBuilder(ElementTree.TreeBuilder):
    """Builds the elements of a file, and refuses those that are nested too deeply."""

    depth = 0

    def start(self, tag: str, attrs: dict[str, str]) -> ElementTree.Element:
        self.depth += 1
        if self.depth > MAXIMUM_NESTING:
            raise ValueError(f"more than {MAXIMUM_NESTING} elements within one another")
        return super().start(tag, attrs)

    def end(self, tag: str) -> ElementTree.Element:
        self.depth -= 1
        return super().end(tag)


class _Includes:
    """Counts the objects of a scene with its includes, each file once, before any include is expanded."""

    def __init__(self, scene: Path) -> None:
        self._scene = scene
        self._known: dict[tuple[Path, int], int] = {}

    def check(self) -> None:
        """Refuse a scene whose includes make more objects than it may hold."""
        count = self._objects(self._scene, {}, 0)
        if count > MAXIMUM_OBJECTS:
            problem = f"the scene has {figure(count)} objects with those of its includes"
            raise InputError(self._scene, problem, f"at most {MAXIMUM_OBJECTS}")

    def _objects(self, path: Path, parameters: dict[str, str], depth: int) -> int:
        if (path, depth) not in self._known:
            count = 0
            for top in _root(path, self._scene):
                _substitute(path, top, parameters)
                if top.tag == "default":
                    parameters.setdefault(top.get("name", ""), top.get("value", ""))
                elif top.tag == "include":
                    count += self._objects(_included(self._scene, top, depth), parameters, depth + 1)
                else:
                    count += 1
            self._known[path, depth] = count
        return self._known[path, depth]


def _expanded_elements(
    path: Path, scene: Path, parameters: dict[str, str], depth: int
) -> Iterator[ElementTree.Element]:
    """Children of the scene element with includes in place and ``$name`` substituted as far as it is known there."""
    for top in _root(path, scene):
        _substitute(path, top, parameters)
        if top.tag == "default":
            parameters.setdefault(top.get("name", ""), top.get("value", ""))
        elif top.tag == "include":
            yield from _expanded_elements(_included(scene, top, depth), scene, parameters, depth + 1)
        else:
            yield top


def _root(path: Path, scene: Path) -> ElementTree.Element:
    """The scene element of a file.

    :param scene: the file that includes it, for messages
    """
    try:
        root = ElementTree.parse(path, ElementTree.XMLParser(target=_ShallowBuilder())).getroot()
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(path, f"not well-formed XML ({error})", "a valid Mitsuba 3 scene") from error
    except OSError as error:
        raise InputError(scene, f"{path}: {error.strerror}", "a readable file") from error
    if root.tag != "scene":
        raise InputError(path, f"the outermost element is <{root.tag}>", "<scene>")
    return root


def _included(scene: Path, include: ElementTree.Element, depth: int) -> Path:
    """The file of an <include>; Mitsuba looks for every file from the folder of the main scene."""
    if depth >= INCLUDE_DEPTH:
        raise InputError(scene, f"<include> is nested more than {INCLUDE_DEPTH} deep", "no include loop")
    return scene.parent / include.get("filename", "")


def _substitute(path: Path, top: ElementTree.Element, parameters: dict[str, str]) -> None:
    """Put the values of ``$name`` into the attributes of an element and of those within it."""
    for element in top.iter():
        for key, value in element.attrib.items():
            element.set(key, _substituted(path, value, parameters))


def _substituted(path: Path, text: str, parameters: dict[str, str]) -> str:
    names = PARAMETER.findall(text)
    for name in names:
        if name not in parameters:
            raise InputError(path, f"undefined parameter ${name}", "a <default> for it")
    length = len(text) + sum(len(parameters[name]) for name in names)
    if names and length > LONGEST_VALUE:
        problem = f"${names[0]} makes a value of {length} characters"
        raise InputError(path, problem, f"at most {LONGEST_VALUE}")
    return PARAMETER.sub(lambda match: parameters[match[1]], text)
