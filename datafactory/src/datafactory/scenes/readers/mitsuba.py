"""Mitsuba 3 scenes, as Sionna uses them: triangle meshes and the names of their materials.

The reader creates no Mitsuba object, so that it needs no plugin: of a BSDF it reads the id and, of Sionna's
``itu-radio-material``, the type, which says more than a guess from the id. It skips cameras, lights and integrators. A
Mitsuba file states no unit. Sionna's scenes are in metres with z up, and every file is read so.

Mitsuba's own parser is not used: elements nested some thousand deep crash it, parameters of parameters fill the memory
(docs/notes/soak.md), and importing it loads Dr.Jit, which takes the first libLLVM that it finds. Python's parser
fetches no external entity, and expat bounds the expansion of internal ones.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from trimesh.transformations import rotation_matrix

from datafactory.scenes.readers import common
from datafactory.scenes.readers.common import Notes, scene_at_rest
from datafactory.scenes.readers.mesh_files import load_mesh
from datafactory.scenes.scene import Scene
from shared.physics.errors import InputError

ORIGIN = (0.0, 0.0, 0.0)
Mesh = tuple[NDArray[np.floating], NDArray[np.int64]]
FIXED: dict[str, Callable[[], Mesh]] = {
    "rectangle": lambda: common.rectangle(2.0, 2.0), "cube": lambda: common.box(2.0), "disk": lambda: common.disk(1.0),
}  # fmt: skip
INCLUDE_DEPTH = 15  # Mitsuba's limit
LONGEST_VALUE = 100_000
PARAMETER = re.compile(r"\$(\w+)")
LARGEST = 1e60  # of a number in a scene: cubes of it, as in determinants, are still finite
TRANSFORM_NAMES = ("to_world", "toWorld")  # since version 2, and before
ITU_PLUGIN = "itu-radio-material"
ITU_ID = re.compile(r"(mat-)?itu[-_]")
"""Sionna takes a BSDF of such an id for an ``itu-radio-material``, whatever its plugin."""
ELECTRICAL = ("relative_permittivity", "conductivity", "thickness", "scattering_coefficient", "xpd_coefficient")
"""What Sionna's radio materials may state beside a type."""


def read_mitsuba(path: str | Path, name: str | None = None) -> Scene:
    """Read a Mitsuba XML file.

    :param path: the file; mesh files in it are relative to its folder
    :param name: the scene's name, by default the file's
    :raises InputError: malformed XML, an unresolved reference, a value that is no number, a missing or unreadable
        mesh, more objects or triangles than a scene may hold
    """
    path, notes = Path(path), Notes()
    shapes = read_shapes(path)
    used = dict.fromkeys(shape.bsdf for shape in shapes)
    for key in ELECTRICAL:
        stating = sum(key in bsdf.electrical for bsdf in used)
        notes.count(f"# materials state {key}, which is not taken: the material table counts", stating)
    scene = scene_at_rest(path, name or path.stem, "shape", _meshes(shapes, notes), notes)
    # A name that is the type already needs no statement.
    return replace(scene, stated={bsdf.name: bsdf.itu for bsdf in used if bsdf.itu not in ("", bsdf.name)})


def _meshes(shapes: list[Shape], notes: Notes) -> Iterator[common.PlainMesh]:
    known: dict[tuple[str, str], Mesh] = {}
    for shape in shapes:
        mesh = _mesh(shape, known, notes)
        if mesh is None:
            notes.count(f"# shapes of type {shape.kind!r} ignored")
            continue
        points, triangles = mesh
        triangles = triangles[:, ::-1] if shape.flag("flip_normals") else triangles
        yield shape.name, shape.bsdf.name, points, triangles, shape.to_world


def _mesh(shape: Shape, known: dict[tuple[str, str], Mesh], notes: Notes) -> Mesh | None:
    """Vertices, in the file's precision, and triangles before to_world; None for a plugin that is not supported.

    Defaults are Mitsuba's.

    :param known: takes meshes that do not depend on the shape's numbers, by plugin and file
    """
    if shape.kind == "sphere":
        vertices, triangles = common.sphere(shape.radius())
        return vertices + shape.point("center", ORIGIN), triangles
    if shape.kind == "cylinder":
        return _tube(shape)
    file = shape.text("filename") if shape.kind in ("ply", "obj") else ""
    if (shape.kind, file) not in known:
        if file:
            source = f"{shape.path}, shape {shape.name!r}"
            known[shape.kind, file] = load_mesh(shape.file(file), source, notes)
        elif shape.kind in FIXED:
            known[shape.kind, file] = FIXED[shape.kind]()
    return known.get((shape.kind, file))


def _tube(shape: Shape) -> common.Mesh:
    """Mitsuba's cylinder: an open tube from p0 to p1."""
    p0, p1 = shape.point("p0", ORIGIN), shape.point("p1", (0.0, 0.0, 1.0))
    length = float(np.linalg.norm(p1 - p0))
    if not length > 0:
        raise shape.error(f"p0 = p1 = {p0.tolist()}", "two different points")
    radius = shape.radius()
    vertices, triangles = common.cylinder(radius, radius, length, closed=False)
    axis = (p1 - p0) / length
    side = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    side /= np.linalg.norm(side)
    frame = np.column_stack([side, np.cross(axis, side), axis])
    return vertices @ frame.T + (p0 + p1) / 2, triangles


@dataclass(frozen=True)
class Bsdf:
    """What a shape's BSDF says of its material.

    :param name: its id, or where it has none its type, or that of a BSDF within it; "" without all
    :param itu: the type that it states of ITU-R P.2040's, e.g. ``"wet_ground"``; "" without one
    :param electrical: which of ``ELECTRICAL`` it states
    """

    name: str = ""
    itu: str = ""
    electrical: tuple[str, ...] = ()


@dataclass(frozen=True)
class Shape:
    """One shape as written, its parameters substituted.

    :param path: the scene file, for messages
    :param name: its id, or ``shape-N`` where it has none
    :param kind: the plugin, e.g. ``"ply"``
    :param to_world: [4, 4] acting on column vectors
    :param properties: name to (XML tag, attributes)
    :param folders: where files are looked for before the scene's own folder
    """

    path: Path
    name: str
    kind: str
    bsdf: Bsdf
    to_world: NDArray[np.float64]
    properties: dict[str, tuple[str, dict[str, str]]]
    folders: tuple[Path, ...] = ()

    def error(self, problem: str, expected: str) -> InputError:
        return InputError(self.path, f"shape {self.name!r}: {problem}", expected)

    def radius(self) -> float:
        (number,) = self._numbers("radius", ("float", "integer"), (1.0,), "a positive number").tolist()
        if number <= 0:
            raise self.error(f"radius = {number:g}", "a positive number")
        return float(number)

    def point(self, key: str, default: tuple[float, float, float]) -> NDArray[np.float64]:
        return self._numbers(key, ("point", "vector"), default, "a <point> of three finite numbers")

    def flag(self, key: str) -> bool:
        text = self._value(key, ("boolean",), "true or false").get("value", "false").strip().lower()
        if text not in ("true", "false"):
            raise self.error(f"{key} = {text!r}", "true or false")
        return text == "true"

    def text(self, key: str) -> str:
        text = self._value(key, ("string",), "a <string>").get("value")
        if not text:
            raise self.error(f"no {key}", "a <string> with a value")
        return text

    def file(self, name: str) -> Path:
        """Where a file of this name is: in the first folder that has it, else in the scene's own."""
        own = self.path.parent / name
        return next((folder / name for folder in self.folders if (folder / name).is_file()), own)

    def _value(self, key: str, tags: tuple[str, ...], expected: str) -> dict[str, str]:
        """The attributes of a property; none where it is not there."""
        tag, attributes = self.properties.get(key, (tags[0], {}))
        if tag not in tags:
            raise self.error(f"{key} = {attributes.get('value', '')!r} is a <{tag}>", expected)
        return attributes

    def _numbers(
        self, key: str, tags: tuple[str, ...], default: tuple[float, ...], expected: str
    ) -> NDArray[np.float64]:
        given = self._value(key, tags, expected)
        if key not in self.properties:
            return np.array(default)
        text = given.get("value") or " ".join(given.get(axis, "0") for axis in "xyz")
        numbers = _numbers(text)
        if numbers is None or len(numbers) != len(default):
            raise self.error(f"{key} = {text!r}", expected)
        return numbers


def read_shapes(path: Path) -> list[Shape]:
    """The shapes of a scene, in the file's order; those within other objects (shape groups) are not among them.

    :raises InputError: malformed XML, an undefined parameter, includes nested too deeply, an id used twice, a reference
        that leads nowhere
    """
    elements = list(_elements(path, path, {}, 0))
    objects: dict[str, ElementTree.Element] = {}
    aliases = {top.get("as", ""): top.get("id", "") for top in elements if top.tag == "alias"}
    for element in (item for top in elements if top.tag != "alias" for item in top.iter()):
        name = element.get("id")
        if name is None or element.tag == "ref":
            continue
        if name in objects:
            raise InputError(path, f"id {name!r} is used twice", "a unique id for every object")
        objects[name] = element
    tops = [element for element in elements if element.tag == "shape"]
    folders = tuple(path.parent / top.get("value", "") for top in reversed(elements) if top.tag == "path")
    shapes = [_shape(path, element, number, objects, aliases) for number, element in enumerate(tops, start=1)]
    return [replace(shape, folders=folders) for shape in shapes]


def _elements(path: Path, scene: Path, parameters: dict[str, str], depth: int) -> Iterator[ElementTree.Element]:
    """Children of the scene element with includes in place and ``$name`` substituted as far as it is known there.

    :param scene: the main file, for messages; Mitsuba looks for every file from its folder
    """
    try:
        root = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(path, f"not well-formed XML ({error})", "a valid Mitsuba 3 scene") from error
    except OSError as error:
        raise InputError(scene, f"{path}: {error.strerror}", "a readable file") from error
    if root.tag != "scene":
        raise InputError(path, f"the outermost element is <{root.tag}>", "<scene>")
    for top in root:
        for element in top.iter():
            for key, value in element.attrib.items():
                element.set(key, _substituted(path, value, parameters))
        if top.tag == "default":
            parameters.setdefault(top.get("name", ""), top.get("value", ""))
        elif top.tag == "include":
            if depth >= INCLUDE_DEPTH:
                raise InputError(scene, f"<include> is nested more than {INCLUDE_DEPTH} deep", "no include loop")
            yield from _elements(scene.parent / top.get("filename", ""), scene, parameters, depth + 1)
        else:
            yield top


def _substituted(path: Path, text: str, parameters: dict[str, str]) -> str:
    for name in PARAMETER.findall(text):
        if name not in parameters:
            raise InputError(path, f"undefined parameter ${name}", "a <default> for it")
    value = PARAMETER.sub(lambda match: parameters[match[1]], text)
    if len(value) > LONGEST_VALUE:  # sixty parameters of two parameters each would fill the memory
        raise InputError(path, f"{text!r} has {len(value)} characters", f"at most {LONGEST_VALUE}")
    return value


def _shape(
    path: Path,
    element: ElementTree.Element,
    number: int,
    objects: dict[str, ElementTree.Element],
    aliases: dict[str, str],
) -> Shape:
    name = element.get("id") or f"shape-{number}"
    bsdf = Bsdf()
    to_world = np.eye(4)
    properties: dict[str, tuple[str, dict[str, str]]] = {}
    for child in element:
        key = child.get("name", "")
        if child.tag == "ref":
            target = aliases.get(child.get("id", ""), child.get("id", ""))
            if target not in objects:
                raise InputError(path, f"shape {name!r}: reference to {target!r}", "the id of an object in the scene")
            bsdf = _bsdf(objects[target], objects, aliases) if objects[target].tag == "bsdf" else bsdf
        elif child.tag == "bsdf":
            bsdf = _bsdf(child, objects, aliases)
        elif key in TRANSFORM_NAMES:
            if child.tag != "transform":
                problem = f"shape {name!r}: {key} = {child.get('value', '')!r} is a <{child.tag}>"
                raise InputError(path, problem, "a <transform>")
            to_world = _transform(path, name, child)
        else:
            properties[key] = (child.tag, dict(child.attrib))
    return Shape(path, name, element.get("type", ""), bsdf, to_world, properties)


def _bsdf(element: ElementTree.Element, objects: dict[str, ElementTree.Element], aliases: dict[str, str]) -> Bsdf:
    """What a BSDF says; a wrapper without a name, such as twosided, says what the first one with a name in it does."""
    for inner in element.iter():
        if inner.tag == "ref":
            inner = objects.get(aliases.get(inner.get("id", ""), inner.get("id", "")), inner)
        found = _stated(inner) if inner.tag == "bsdf" else Bsdf()
        if found.name:
            return found
    return _stated(element)


def _stated(element: ElementTree.Element) -> Bsdf:
    name = element.get("id", "")
    stated = {child.get("name", ""): child.get("value", "") for child in element}
    is_itu = element.get("type") == ITU_PLUGIN or ITU_ID.match(name) is not None
    itu = stated.get("type", "").strip() if is_itu else ""
    return Bsdf(name or itu, itu, tuple(key for key in ELECTRICAL if key in stated))


def _transform(path: Path, name: str, element: ElementTree.Element) -> NDArray[np.float64]:
    """The product of a <transform>'s steps, the first applied first."""
    total = np.eye(4)
    for step in element:
        matrix = _step(step)
        if matrix is None or not np.isfinite(matrix).all() or not np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0]):
            written = ElementTree.tostring(ElementTree.Element(step.tag, step.attrib), encoding="unicode")
            expected = "<translate>, <scale>, <rotate>, <lookat> or an affine <matrix>, with finite numbers"
            raise InputError(path, f"shape {name!r}: to_world has {written}", expected)
        total = matrix @ total
    return total


def _step(step: ElementTree.Element) -> NDArray[np.float64] | None:
    """One step as [4, 4], or None where it makes no sense."""
    matrix = np.eye(4)
    if step.tag == "matrix":
        values = _numbers(step.get("value", ""))
        if values is None or len(values) not in (9, 16):
            return None
        size = 3 if len(values) == 9 else 4
        matrix[:size, :size] = values.reshape(size, size)
        return matrix
    if step.tag in ("lookat", "look_at"):
        given = [_numbers(step.get(key, "")) for key in ("origin", "target", "up")]
        if any(vector is None or len(vector) != 3 for vector in given):
            return None
        origin, target, up = (np.asarray(vector) for vector in given)
        forward = target - origin
        left = np.cross(up, forward)
        lengths = np.linalg.norm(forward), np.linalg.norm(left)
        if not min(lengths) > 0.0:
            return None
        forward, left = forward / lengths[0], left / lengths[1]
        matrix[:3] = np.column_stack([left, np.cross(forward, left), forward, origin])
        return matrix
    if step.tag not in ("translate", "scale", "rotate"):
        return None
    rest = "1" if step.tag == "scale" else "0"
    values = _numbers(step.get("value") or " ".join(step.get(axis, rest) for axis in "xyz"))
    if values is not None and step.tag == "scale" and len(values) == 1:
        values = np.repeat(values, 3)
    if values is None or len(values) != 3:
        return None
    if step.tag == "translate":
        matrix[:3, 3] = values
    elif step.tag == "scale":
        matrix[:3, :3] = np.diag(values)
    else:
        angle = _numbers(step.get("angle", ""))
        if angle is None or len(angle) != 1 or not values.any():
            return None
        if not 1e-100 < np.abs(values).max() < 1e100:  # whose square is 0 or infinite
            values = values / np.abs(values).max()
        matrix = np.asarray(rotation_matrix(np.radians(angle[0]), values), dtype=np.float64)
    return matrix


def _numbers(text: str) -> NDArray[np.float64] | None:
    """Numbers of at most LARGEST separated by blanks or commas, or None."""
    try:
        numbers = np.array([float(word) for word in text.replace(",", " ").split()], dtype=np.float64)
    except ValueError:
        return None
    return numbers if (np.abs(numbers) <= LARGEST).all() else None
