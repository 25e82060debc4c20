"""An order, what the user asked for, and its inputs made ready: scenes opened and merged, paths traced before found,
frames dealt, and what the manifest will say of them.

Rendering, tracing, ``plan``, the accuracy sweep and the error budget all start from here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from importlib.metadata import version
from typing import Any

from pydantic import BaseModel, Field, TypeAdapter

from datafactory.defaults import DEFAULT_BUDGET_DB, DEFAULT_DEPTH, DEFAULT_PATTERN, DEFAULT_RAYS, LARGEST_DEPTH
from datafactory.effects.catalogue import ALL, NO_CHOICE, PATH_EFFECTS, EffectSet
from datafactory.frame.chain import ChainSettings
from datafactory.frame.deal import PreparedScene, StoredRow, Wanted, dealt
from datafactory.frame.points import PointTargets, rayleigh_length
from datafactory.frame.remarks import remarks
from datafactory.paths.merged_scene import merge_scene
from datafactory.paths.storage import paths_schema, read_places
from datafactory.run.portions import Job
from datafactory.run.shards import ENTRY, PATHS, ShardPlan, plan_shards
from datafactory.scenes.boxes import boxed_things
from datafactory.scenes.materials.table import MaterialTable
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from shared.dataset import arrow_schema, description
from shared.dataset.locations import Location
from shared.dataset.manifest import MANIFEST, ShardRecord, read_manifest, shard_records
from shared.physics.errors import InputError
from shared.processes.telling import Announce, silent
from shared.radar import Radar, validated
from shared.radar.waveform import Waveform
from shared.signal.tdm import statement
from shared.signal.windows import angle_window, width_and_sidelobe


class _Radar(BaseModel):
    front_end: dict[str, Any]
    waveform: Waveform


class _Trace(BaseModel):
    rays: int = DEFAULT_RAYS
    depth: int = Field(DEFAULT_DEPTH, ge=1, le=LARGEST_DEPTH)


class _Arguments(BaseModel):
    radar: _Radar
    effects: tuple[str, ...]
    seed: int = 0
    split: str | None = None
    trace: _Trace = _Trace()
    poses: list[Any] = []
    tracks: list[Any] = []


class Traced(BaseModel, frozen=True):
    """What rendering needs to know of the manifest of a folder that ``datafactory trace`` wrote.

    :param scenes: the entries of its scenes
    :param checksums: SHA-256 of its shards, in their order
    """

    arguments: _Arguments
    scenes: list[dict[str, Any]]
    checksums: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Order(Wanted):
    """What the user asked for: which frames, of what, and how they are made.

    :param scenes: ``--scene`` arguments, or scenes that were read before
    :param traced: of the folder that ``stored`` lies in, instead of scenes
    :param settings: how a frame is made, with every effect
    :param effects: what is simulated of the scenes; None for what each frame calls for
    :param budget_db: what leaving effects out of a frame may change then
    :param license: of the data, an SPDX expression; None where none is stated
    :param paths_alone: for a folder of traced paths in place of a dataset of frames
    """

    radar: Radar
    scenes: tuple[str | Scene, ...] = ()
    traced: Traced | None = None
    settings: ChainSettings = field(default_factory=ChainSettings)
    effects: EffectSet | None = None
    budget_db: float = DEFAULT_BUDGET_DB
    license: str | None = None
    paths_alone: bool = False

    @property
    def of_scenes(self) -> ChainSettings:
        """How scene frames are made: with what was chosen, or with what each calls for by the budget."""
        if self.effects is not None:
            return self.effects.settings(self.settings)
        every = ALL.settings(self.settings)
        return replace(every, budget_db=self.budget_db, below_noise=self.settings.processing.noise)


NEAR_WAVELENGTH = 0.02
"""Of its wavelength, by which a radar may differ from that of a trace: levels of plates go as 1 / wavelength, so that
this is 0.17 dB."""


def stored_paths(
    folder: Location, radar: Radar, split: str | None, effects: EffectSet | None
) -> tuple[Traced, tuple[StoredRow, ...]]:
    """A folder of traced paths: what it says of them, and the row of every frame, by frame index.

    :param split: pattern that is asked for; None for that of the trace
    :param effects: that are asked for; None for those that the paths were traced with
    :raises InputError: a folder without traced paths, of another version, polarisation or wavelength, or whose paths
        were traced with other regions or without the effects that are asked for
    """
    path, manifest = folder / MANIFEST, read_manifest(folder)
    if ENTRY in manifest:
        raise InputError(folder, "is a job of an array", "the folder that datafactory merge makes of all jobs")
    records = [record for record in shard_records(path, manifest) if record.path.startswith(f"{PATHS}/")]
    if not records:
        raise InputError(folder, "holds no traced paths", "a folder written by datafactory trace")
    traced = validated(Traced, manifest, path)
    arguments = traced.arguments
    _require_same_regions(folder, arguments, split or arguments.split or DEFAULT_PATTERN)
    for end in ("tx_polarization", "rx_polarization"):
        before, wanted = arguments.radar.front_end.get(end, "V"), getattr(radar.front_end, end)
        if before != wanted:
            problem = f"paths were traced with {end} = {before!r}, the radar has {wanted!r}"
            raise InputError(folder, problem, "the same polarisation, or datafactory trace with this radar")
    _require_near_wavelength(folder, arguments.radar.waveform, radar.waveform)
    if effects is not None:
        _require_same_paths(folder, set(arguments.effects), set(effects.names))
    checksums = tuple(record.sha256 for record in records)
    return traced.model_copy(update={"checksums": checksums}), _rows(folder, records, len(traced.scenes))


def _require_near_wavelength(folder: Location, traced: Waveform, wanted: Waveform) -> None:
    """Amplitudes are brought to another wavelength; apertures, corners, edges and materials stay as traced."""
    if abs(wanted.wavelength_m / traced.wavelength_m - 1.0) > NEAR_WAVELENGTH:
        before, now = (f"{waveform.mid_sweep_hz / 1e9:.6g} GHz" for waveform in (traced, wanted))
        problem = f"paths were traced at {before}, the radar has {now} in the middle of its sweep"
        expected = f"a wavelength within {100 * NEAR_WAVELENGTH:g} %, or datafactory trace with this radar"
        raise InputError(folder, problem, expected)


def _rows(folder: Location, records: Sequence[ShardRecord], scenes: int) -> tuple[StoredRow, ...]:
    """The row of every frame index: it says itself which frame it is, of which scene and sequence."""
    found: dict[int, StoredRow] = {}
    for record in records:
        shard = folder / record.path
        for row, (frame_id, scene, sequence) in enumerate(read_places(shard)):
            if not 0 <= scene < scenes:
                raise InputError(shard, f"row {row} has scene_number = {scene}", f"one of the {scenes} of {MANIFEST}")
            if frame_id in found:
                raise InputError(shard, f"row {row} has frame_id = {frame_id}, as another row", "each frame once")
            found[frame_id] = StoredRow(shard, row, scene, sequence)
    if sorted(found) != list(range(len(found))):
        missing = min(set(range(len(found))) - set(found))
        raise InputError(folder, f"frame {missing} of its {len(found)} is missing", "all frames of one trace")
    return tuple(found[frame_id] for frame_id in range(len(found)))


def _require_same_regions(folder: Location, arguments: _Arguments, split: str) -> None:
    """Drawn poses stand in the region of their frame's split: another split would test where was trained."""
    traced = arguments.split
    if not (arguments.poses or arguments.tracks) and traced != split:
        problem = f"{split!r}: the poses of {folder} were drawn in the regions of {traced!r}, and would change sides"
        raise InputError("--split", problem, f"--split {traced}, or datafactory trace with this split")


def _require_same_paths(folder: Location, traced: set[str], asked: set[str]) -> None:
    """Which paths there are was settled when they were traced."""
    for name in PATH_EFFECTS:
        if (name in traced) != (name in asked):
            had, wants = ("with", "without") if name in traced else ("without", "with")
            problem = f"its paths were traced {had} {name}, --effects asks for frames {wants} it"
            raise InputError(folder, problem, "--effects auto, or datafactory trace with these effects")


@dataclass(frozen=True)
class Recipe:
    """What a run follows: it is the last that knows of an order.

    :param job: what determines the bytes of the frames
    :param plans: the shards of the whole dataset
    :param manifest: its entries that are the run's own, ``arguments`` among them
    """

    job: Job
    plans: tuple[ShardPlan, ...]
    manifest: dict[str, Any]


def prepare(order: Order, table: MaterialTable, announce: Announce = silent) -> Recipe:
    """Make an order's inputs ready.

    :raises InputError: whatever is wrong with a scene or with a folder of traced paths, or two files of one name
    """
    if said := _named_in_vain(order):
        announce(said)
    opened = [scene if isinstance(scene, Scene) else open_scene(scene) for scene in order.scenes]
    scenes = tuple(prepared_scene(scene, table, announce) for scene in opened)
    _require_own_names(opened, scenes)
    for scene in scenes:
        if said := _beyond_sources(scene, order.radar):
            announce(said)
    if opened and (said := table.unmatched(sorted({item.material for scene in opened for item in scene.objects}))):
        announce(said)
    deal = dealt(order, opened)
    for said in remarks(deal, opened):
        announce(said)
    plans = plan_shards((PATHS,) * len(deal) if order.paths_alone else deal.splits())
    traced, of_scenes = order.traced, order.of_scenes
    entries = list(map(_entry, opened, scenes)) if traced is None else traced.scenes
    if traced is not None:
        before = traced.arguments.trace
        of_scenes = replace(of_scenes, trace=replace(of_scenes.trace, rays=before.rays, depth=before.depth))
    about, schema, processing = dict[str, Any](), paths_schema(), order.settings.processing
    if not order.paths_alone:
        conventions = _conventions(order.radar, processing.truth_window)
        about = description(order.radar, processing.peaks, processing.store, conventions)
        schema = arrow_schema(about)
    job = Job(
        radar=order.radar,
        deal=deal,
        scenes=scenes,
        settings=order.settings,
        of_scenes=of_scenes,
        schema_message=schema.serialize().to_pybytes(),
        paths_alone=order.paths_alone,
    )
    stated = {name: about[name] for name in STATED if name in about}
    if order.license is not None:
        stated["license"] = order.license
    return Recipe(job, plans, {"arguments": _arguments(order, scenes), "scenes": entries, **stated})


STATED = ("radar", "array", "virtual_sensor", "axes", "shapes", "conventions", "truth")
"""What the manifest says as each shard's metadata does."""


def _conventions(radar: Radar, window: str) -> dict[str, Any]:
    """What a reader of one shard needs to know beside the axes.

    :param window: of the truth, see :func:`shared.signal.windows.angle_window`
    """
    elements = radar.virtual_sensor.channels
    y, wavelength = radar.virtual_sensor.rx[:, 1], radar.waveform.wavelength_m
    spacing = abs(float(y[1] - y[0])) if len(y) > 1 else 0.0
    width = sidelobe = None  # of what is no line of elements
    if spacing > 0.0:
        width, sidelobe = width_and_sidelobe(angle_window(window, elements), spacing / wavelength)
    return {
        "conventions": {
            "frame": "x forward, y left, z up, origin at the centroid of the full array's RX; u = y / range",
            "units": "range_channel and image_peak in sqrt(W), noise_power in W per channel and range-Doppler cell",
            "velocity": "; ".join(filter(None, ("range rate, positive is receding", statement(radar)))),
            "image": "truth magnitude relative to image_peak; row r in the first Doppler cell of range bin r",
        },
        "truth": {
            "window": window,
            "width_u": width,
            "width_bins": None if width is None else width / radar.grid.step,
            "peak_sidelobe_db": sidelobe,
            "rayleigh_length_u_of_array": rayleigh_length(radar),
        },
    }


OTHERWISE = ("settings", "stored", "traced", "paths_alone", "antenna_pattern", "below_noise")
"""Fields of an order and of its settings that the arguments have in another form, or that follow from the effects."""
OF_SCENES = ("scenes", "materials", "frames", "poses", "tracks", "drives", "speed_mps", "trace")
"""What paths that were traced before have settled."""
OF_SIGNALS = ("processing", "prune_db", "close_targets")
"""What traced paths do not depend on."""


def _arguments(order: Order, scenes: Sequence[PreparedScene]) -> dict[str, Any]:
    """What of an order determines the bytes, as JSON values: its fields, by the names that the user knows."""
    found = {item.name: getattr(of, item.name) for of in (order.settings, order) for item in fields(of)} | {
        "scenes": [{"scene": scene.name, "content": scene.content} for scene in scenes],
        "materials": [scene.materials.to_json() for scene in scenes],
        "targets": [_as_lists(targets) for targets in order.targets],
        "effects": "auto" if order.effects is None else order.effects.names,
        "budget_db": order.budget_db if order.effects is None else None,
        "versions": {name: version(name) for name in ("sparseradar-datafactory", "sionna-rt")},
    }
    left_out = {*OTHERWISE, *(name for name in ("speed_mps", "license") if found[name] is None)}
    left_out.update(OF_SIGNALS if order.paths_alone else ())
    if order.traced is not None:
        found["paths"] = order.traced.checksums
        left_out.update(OF_SCENES)
    stated = {name: value for name, value in found.items() if name not in left_out}
    return TypeAdapter(dict[str, Any]).dump_python(stated, mode="json")


def _as_lists(targets: PointTargets) -> dict[str, Any]:
    arrays = {name: values.tolist() for name, values in vars(targets).items() if name != "models"}
    return arrays | ({"models": [repr(target) for target in targets.models]} if targets.models else {})


def prepared_scene(scene: Scene, table: MaterialTable, announce: Announce) -> PreparedScene:
    """A scene merged, its materials mapped; what was ignored or assumed is announced."""
    materials = table.map_materials([item.material for item in scene.objects], scene.stated)
    merged = merge_scene(scene, materials)
    triangles = scene.triangle_count
    for warning in scene.warnings:
        announce(f"{scene.name}: {warning}")
    if scene.population is not None:
        announce(f"{scene.name}: {scene.population.line()}")
    mapped = [f"{name or '(none)'} -> {material.name}" for name, (material, _) in materials.entries.items()
              if name != material.name]  # fmt: skip
    told = f"{len(materials.entries)} materials{', ' if mapped else ''}{', '.join(mapped)}"
    announce(f"{scene.name}: {len(scene.objects)} objects, {triangles} triangles, {told}")
    unknown = ", ".join(name or "(none)" for name in materials.unknown)
    if unknown:
        announce(f"{scene.name}: unknown materials given the default: {unknown}")
    return PreparedScene(scene.name, scene.content_hash(), merged, materials, boxed_things(scene), triangles)


def _require_own_names(opened: Sequence[Scene], prepared: Sequence[PreparedScene]) -> None:
    """A frame says its scene by name alone, and so do splits, cameras and what was trained on.

    One file may be there again, also populated or read in another way, and a copy of it.
    """
    first: dict[str, tuple[Scene, PreparedScene]] = {}
    for scene, made in zip(opened, prepared, strict=True):
        other, known = first.setdefault(scene.name, (scene, made))
        if other.source != scene.source and known.content != made.content:
            problem = f"{other.source or '(built)'} and {scene.source or '(built)'} have one name, {scene.name!r}"
            raise InputError("--scene", problem, "another file name for one of them: frames name their scene so")


def _named_in_vain(order: Order) -> str:
    """What to say of effects that were chosen and are no choice; "" without such."""
    if order.effects is None or order.effects == ALL:
        return ""
    named = ", ".join(name for name in NO_CHOICE if name in order.effects.names)
    return f"--effects: {named} made no difference: simulated wherever something to work on is" if named else ""


def _beyond_sources(scene: PreparedScene, radar: Radar) -> str:
    """What to say of materials whose source does not reach the radar's frequency; "" without such."""
    ghz = radar.waveform.mid_sweep_hz / 1e9
    found = (
        f"{item.name} ({item.valid_ghz[0]:g} to {item.valid_ghz[1]:g} GHz)"
        for item in scene.materials.outside(radar.waveform.mid_sweep_hz)
    )
    named = ", ".join(found)
    return f"{scene.name}: at {ghz:g} GHz the sources of these materials do not hold: {named}" if named else ""


def _entry(scene: Scene, prepared: PreparedScene) -> dict[str, Any]:
    return {
        "name": scene.name,
        "source": scene.source,
        "content_sha256": prepared.content,
        "objects": len(scene.objects),
        "triangles": prepared.triangles,
        "point_targets": len(scene.targets),
        "warnings": list(scene.warnings),
        "materials": prepared.materials.to_json(),
        **({} if scene.population is None else {"population": scene.population.to_json()}),
        **({"variants": dict(scene.variants)} if scene.variants else {}),
        **({"allow_missing": True} if scene.allow_missing else {}),
    }
