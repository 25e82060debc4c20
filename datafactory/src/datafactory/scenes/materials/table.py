"""Material properties at 77 GHz, and the table that assigns one material to every material name of a scene.

``materials_77ghz.toml`` states source and assumptions of each material. A user's file has the same form and overrides
or extends it. Sionna's own ITU rows are not used: several end below 77 GHz.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, FiniteFloat, model_validator

from datafactory.scenes.materials.reflectivity import largest_sigma0, scattering_coefficient_for_sigma0
from shared.physics.errors import InputError, meant
from shared.physics.units import power_to_db
from shared.radar import validated

FREQUENCY_HZ = 77e9
"""Frequency of the table [Hz]."""

SLOWLY = 0.02
"""Of a frequency, beyond the range of a source: over so little the properties are taken not to change. The default
radar's sweep ends at 78 GHz, and sources state 77."""

BUILT_IN = "materials_77ghz.toml"
DEFAULT = "default"
"""How the rule begins that chose a material where no other did."""
NOTHING: Mapping[str, str] = MappingProxyType({})

Pattern = Literal["lambertian", "backscattering"]


PREFIXES = frozenset({"mat", "mtl", "material", "itu", "m", "mi", "radio", "tex", "shader"})
"""Words that mark any material (Sionna ``mat-itu_``, Blender ``Material.``, Unreal ``M_``) and name none."""
SUFFIXES = frozenset({"mat", "mtl", "material", "shader", "inst", "instance", "sg"})


@dataclass(frozen=True)
class Material:
    """What the tracer uses of a :class:`MaterialEntry`; its roughness is S, 0 to 1, however it was stated."""

    name: str
    relative_permittivity: float
    conductivity_s_per_m: float
    thickness_m: float
    scattering_coefficient: float
    pattern: Pattern
    source: str
    valid_ghz: tuple[float, float]
    assumptions: tuple[str, ...]


@dataclass(frozen=True)
class MaterialMapping:
    """The material of every name of a scene, and the rule that chose it.

    :param entries: name -> (material, rule), in the order of first appearance
    :param unknown: names that fell back to the default material
    """

    entries: Mapping[str, tuple[Material, str]]
    unknown: tuple[str, ...]

    def __getitem__(self, name: str) -> Material:
        return self.entries[name][0]

    def outside(self, frequency_hz: float) -> tuple[Material, ...]:
        """Its materials whose source does not reach this frequency, each once."""
        ghz, materials = frequency_hz / 1e9, {material.name: material for material, _ in self.entries.values()}
        return tuple(
            item
            for item in materials.values()
            if not (1 - SLOWLY) * item.valid_ghz[0] <= ghz <= (1 + SLOWLY) * item.valid_ghz[1]
        )

    def to_json(self) -> dict[str, Any]:
        """For the manifest: ``{"names": {name: {"material", "rule"}}, "materials": {material: {...}}, "unknown"}``."""
        return {
            "names": {
                name: {"material": material.name, "rule": rule} for name, (material, rule) in self.entries.items()
            },
            "materials": {
                material.name: {key: list(v) if isinstance(v, tuple) else v for key, v in asdict(material).items()}
                for material, _ in self.entries.values()
            },
            "unknown": list(self.unknown),
        }


@dataclass(frozen=True)
class MaterialTable:
    """All materials and their names.

    :param materials: by name
    :param aliases: phrase -> name, for other names of a substance (the names themselves among them)
    :param uses: phrase -> name, for things usually made of it
    :param exact: name as the scene gives it -> name, from the user's ``[map]``
    :param default: name of the material that unknown names get
    """

    materials: Mapping[str, Material]
    aliases: Mapping[str, str]
    uses: Mapping[str, str]
    exact: Mapping[str, str]
    default: str

    def lookup(self, name: str, stated: str = "") -> tuple[Material, str]:
        """The material of a scene's material name, and the rule that chose it.

        In this order: the user's ``[map]``; what the file says that it is; the table's own name; a name or an alias of
        a substance within the name; a thing usually made of a substance; the default. Longer phrases go first, and
        among equals the last, so that "brick wall" is brick and "glass_roof" is glass.

        :param stated: the substance that the file states; no guess from the name takes the place of one that the table
            does not know
        """
        if name in self.exact:
            return self.materials[self.exact[name]], "map"
        found = self._guessed(stated or name)
        material, rule = found if found is not None else (self.materials[self.default], DEFAULT)
        if not stated:
            return material, rule
        return material, f"stated '{stated}'" if found is not None else f"{DEFAULT}, stated '{stated}'"

    def _guessed(self, name: str) -> tuple[Material, str] | None:
        """What a name says by itself; None where it says nothing."""
        if name in self.materials:
            return self.materials[name], "name"
        candidates = list(phrases(words(name)))
        for rule, table in (("substance", self.aliases), ("use", self.uses)):
            for phrase in candidates:
                for spelling in (phrase, singular(phrase)):
                    if spelling in table:
                        return self.materials[table[spelling]], f"{rule} '{spelling}'"
        return None

    def unmatched(self, names: Collection[str]) -> str:
        """What to say of names in the user's ``[map]`` that no material of the scenes has; "" without such."""
        keys = [key for key in self.exact if key not in names]
        near = "".join(meant(key, names) for key in keys)
        return (
            f"--materials: no material of the scenes has these names of [map]: {', '.join(keys)}{near}" if keys else ""
        )

    def map_materials(self, names: Iterable[str], stated: Mapping[str, str] = NOTHING) -> MaterialMapping:
        """Look every name up once; repeated names are mapped once.

        :param stated: see :attr:`datafactory.scenes.scene.Scene.stated`
        """
        entries = {name: self.lookup(name, stated.get(name, "")) for name in dict.fromkeys(names)}
        unknown = tuple(name for name, (_, rule) in entries.items() if rule.startswith(DEFAULT))
        return MaterialMapping(entries=entries, unknown=unknown)


Fraction = Annotated[FiniteFloat, Field(ge=0, le=1)]


class MaterialEntry(BaseModel, frozen=True, extra="forbid", strict=True):
    """One ``[material.NAME]`` table, after it was laid over the built-in one of the same name.

    :param relative_permittivity: real part
    :param conductivity: [S/m]
    :param thickness: of the slab behind each facet [m]
    :param scattering_coefficient: S of the effective-roughness model; or, in place of it, the next two
    :param sigma0_db: the backscatter from which S of a Lambertian surface follows, vertical polarisation [dB]
    :param grazing_deg: the angle of that backscatter above the surface [deg]
    :param pattern: shape of the diffuse reflection
    :param valid_ghz: lower and upper end of the range of the source [GHz]
    :param source: where the permittivity comes from
    :param assumptions: what is not measured at 77 GHz
    :param aliases: other names of the substance
    :param uses: things usually made of it; they give way to a substance in the same name
    """

    # The upper limits lie far beyond any substance, and below what squares and quotients of them can overflow.
    relative_permittivity: Annotated[FiniteFloat, Field(ge=1, le=1e9)]
    conductivity: Annotated[FiniteFloat, Field(ge=0, le=1e12)]
    thickness: Annotated[FiniteFloat, Field(gt=0, le=1e6)] = 0.1
    scattering_coefficient: Fraction | None = None
    sigma0_db: Annotated[FiniteFloat, Field(ge=-300, le=100)] | None = None
    grazing_deg: Annotated[FiniteFloat, Field(gt=0, le=90)] | None = None
    pattern: Pattern = "lambertian"
    valid_ghz: Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)] = [77.0, 77.0]
    source: Annotated[str, Field(min_length=1)]
    assumptions: list[str] = []
    aliases: list[str] = []
    uses: list[str] = []

    @model_validator(mode="after")
    def _consistent(self) -> MaterialEntry:
        calibrated = (self.sigma0_db is not None, self.grazing_deg is not None)
        if self.scattering_coefficient is not None and any(calibrated):
            raise ValueError("scattering_coefficient and sigma0_db are both given; expected one of them")
        if self.scattering_coefficient is None and not all(calibrated):
            raise ValueError("no roughness; expected scattering_coefficient, or sigma0_db with grazing_deg")
        if any(calibrated) and self.relative_permittivity == 1.0 and self.conductivity == 0.0:
            raise ValueError("sigma0_db of what reflects nothing; expected relative_permittivity above 1")
        if self.sigma0_db is not None and self.grazing_deg is not None:
            electrical = self.relative_permittivity, self.conductivity
            most_db = float(power_to_db(largest_sigma0(self.grazing_deg, *electrical, FREQUENCY_HZ)))
            if self.sigma0_db > most_db:
                raise ValueError(
                    f"sigma0_db = {self.sigma0_db:g}; expected at most {most_db:.1f} at grazing_deg = "
                    f"{self.grazing_deg:g}, of a surface that scatters all that it reflects"
                )
        if any(calibrated) and self.pattern != "lambertian":
            # S follows from the backscatter of a Lambertian surface; a lobe has another at the same S.
            raise ValueError(f"sigma0_db beside pattern = {self.pattern!r}; expected scattering_coefficient with it")
        if self.valid_ghz[0] > self.valid_ghz[1]:
            raise ValueError(f"valid_ghz = {self.valid_ghz}; expected [lower, upper]")
        for phrase in (*self.aliases, *self.uses):
            if not words(phrase):
                raise ValueError(f"alias {phrase!r} has no letters; expected a word, or an entry in [map]")
        return self

    def material(self, name: str) -> Material:
        coefficient = self.scattering_coefficient
        if coefficient is None:
            assert self.sigma0_db is not None  # both by _consistent
            assert self.grazing_deg is not None
            coefficient = scattering_coefficient_for_sigma0(
                self.sigma0_db, self.grazing_deg, self.relative_permittivity, self.conductivity, FREQUENCY_HZ
            )
        electrical = self.relative_permittivity, self.conductivity, self.thickness, coefficient
        lower, upper = self.valid_ghz
        return Material(name, *electrical, self.pattern, self.source, (lower, upper), tuple(self.assumptions))


class _Became(BaseModel):
    material: str


class RecordedMaterials(BaseModel):
    """What :meth:`MaterialMapping.to_json` wrote: by name in the scene, and by name of the material."""

    names: dict[str, _Became] = {}
    materials: dict[str, Material] = {}

    def table(self) -> MaterialTable:
        """The built-in table, over which each name becomes what it became."""
        known = load_materials()
        exact = {name: became.material for name, became in self.names.items()}
        return replace(known, materials={**known.materials, **self.materials}, exact=exact)


class MaterialFile(BaseModel, frozen=True, extra="forbid", strict=True):
    """A materials file: the outer form, its tables still raw.

    :param material: a table ``[material.NAME]`` for each material that is changed or added
    :param map: ``[map]``: names of the scene, as it gives them, to materials
    :param default: the material of unknown names
    """

    material: dict[str, dict[str, Any]] = {}
    map: dict[str, str] = {}
    default: str | None = None


def load_materials(path: Path | None = None) -> MaterialTable:
    """The built-in table, overridden and extended by a TOML file (:class:`MaterialFile`, :class:`MaterialEntry`).

    A table changes the fields given of a known material or adds a new one. A new material needs permittivity and
    conductivity; without a roughness it gets S = 0.3, noted as an assumption.

    :raises InputError: if the file cannot be read, is no TOML, or holds an unknown field, a wrong value or an unknown
        material
    """
    base = _parsed(
        resources.files("datafactory.scenes.materials").joinpath(BUILT_IN).read_text(encoding="utf-8"), BUILT_IN
    )
    tables = dict(base.material)
    assert base.default is not None  # the built-in file names one
    if path is None:
        return _checked_table(tables, {}, base.default, BUILT_IN)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise InputError(path, f"cannot be read: {reason}", "a TOML file with [material.NAME] tables") from None
    user = _parsed(text, path)
    for name, changes in user.material.items():
        tables[name] = _with_changes(tables.get(name), changes, str(path))
    return _checked_table(
        tables, user.map, base.default if user.default is None else user.default, path, first=user.material
    )


def _parsed(text: str, source: object) -> MaterialFile:
    try:
        document = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(source, f"malformed TOML: {error}", "[material.NAME] tables, [map] and default") from None
    return validated(MaterialFile, document, source)


def _with_changes(known: dict[str, Any] | None, changes: dict[str, Any], source: str) -> dict[str, Any]:
    """The user's fields over the known ones; a roughness given in one form replaces that in the other."""
    if known is None:
        rough = {"scattering_coefficient", "sigma0_db", "grazing_deg"} & changes.keys()
        assumed = {} if rough else {"scattering_coefficient": 0.3, "assumptions": ["S = 0.3 is an assumption"]}
        return {"source": source} | assumed | changes
    kept = dict(known)
    if "scattering_coefficient" in changes:
        kept = {key: value for key, value in kept.items() if key not in ("sigma0_db", "grazing_deg")}
    elif "sigma0_db" in changes:
        kept.pop("scattering_coefficient", None)
    return kept | {"source": f"{source}, over {known['source']}"} | changes


def _checked_table(
    tables: Mapping[str, dict[str, Any]], exact: dict[str, str], default: str, source: object, first: Iterable[str] = ()
) -> MaterialTable:
    """Check every table; where two materials claim one alias, those named in ``first`` keep it."""
    entries = {
        name: validated(MaterialEntry, table, source, place=f"material.{name}.") for name, table in tables.items()
    }
    known = ", ".join(entries)
    for key, target in {"default": default, **{f"map.{name}": target for name, target in exact.items()}}.items():
        if target not in entries:
            raise InputError(source, f"{key} = {target!r}", f"one of {known}")
    order = [*first, *(name for name in entries if name not in set(first))]
    # A number in a material's name is no word, so the name without one keeps the phrase: "concrete", not "concrete_2".
    aliases: dict[str, str] = {name.lower().replace("_", " "): name for name in order}
    uses: dict[str, str] = {}
    for name in order:
        aliases.setdefault(" ".join(words(name)), name)
    for name in order:
        for phrase in entries[name].aliases:
            aliases.setdefault(" ".join(words(phrase)), name)
        for phrase in entries[name].uses:
            uses.setdefault(" ".join(words(phrase)), name)
    return MaterialTable(
        materials={name: entry.material(name) for name, entry in entries.items()},
        aliases=aliases,
        uses=uses,
        exact=dict(exact),
        default=default,
    )


def words(name: str) -> tuple[str, ...]:
    """Lower-case words of a material name, without those that mark any material.

    A USD path counts by its last part; camel case and every sign that is no letter separate words; numbers such as
    ``.001`` or ``_2`` are no words. ``"/World/Looks/M_WetGround_01"`` gives ``("wet", "ground")``.
    """
    last = name.rstrip("/").rsplit("/", 1)[-1].rsplit(":", 1)[-1]
    split = re.sub(r"([a-z])([A-Z])", r"\1 \2", last)
    found = re.findall(r"[^\W\d_]+", split.lower().replace("ß", "ss"))
    while len(found) > 1 and found[0] in PREFIXES:
        found = found[1:]
    while len(found) > 1 and found[-1] in SUFFIXES:
        found = found[:-1]
    return tuple(found)


def phrases(name_words: tuple[str, ...]) -> Iterator[str]:
    """All runs of adjacent words, longest first and, among equals, last first: in "brick road" the road is the noun."""
    for length in range(len(name_words), 0, -1):
        for start in range(len(name_words) - length, -1, -1):
            yield " ".join(name_words[start : start + length])


def singular(phrase: str) -> str:
    """The phrase without a plural s: "windows" is looked up as "window" where "windows" is unknown."""
    return phrase[:-1] if phrase.endswith("s") and not phrase.endswith("ss") else phrase
