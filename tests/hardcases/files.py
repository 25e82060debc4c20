"""Hard cases of files: the smallest dataset, damage of every kind, other people's files, names that are no text.

Everything is read or refused with one line; a flipped bit that still reads must be found by ``verify``.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from hardcases.case import HardCase, unrefused
from hardcases.tools import factory

from datafactory.frame.points import read_targets
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import read_poses
from datafactory.scenes.readers.open import open_scene
from shared.dataset import VERSION
from shared.dataset.folder import MANIFEST, Dataset, open_dataset, verify
from shared.dataset.reading import read_frame, read_frames
from shared.physics.errors import InputError
from shared.radar import load_radar

RADAR = """
[waveform]
chirps = 2
samples = 16
range_bins = 12
[grid]
bins = 8
"""
NOT_UTF8 = os.fsdecode(b"caf\xe9")
"""A name in Latin-1, as file systems of this kind allow it."""


def _render(out: Path, *more: object) -> tuple[int, str, str]:
    """A points dataset of a tiny radar."""
    radar = out.parent / "radar.toml"
    radar.write_text(RADAR, encoding="utf-8")
    return factory("points", "--radar", radar, "--workers", 1, "--out", out, *more)


@lru_cache(maxsize=1)
def _archive() -> tempfile.TemporaryDirectory:
    """A folder with a dataset of one frame and one of eight, kept until the process ends."""
    folder = tempfile.TemporaryDirectory()
    for name, frames in (("one", 1), ("eight", 8)):
        status, _, said = _render(Path(folder.name) / name, "--frames", frames)
        if status:
            raise RuntimeError(said)
    return folder


def _copy(folder: str, name: str = "one") -> Path:
    return Path(shutil.copytree(Path(_archive().name) / name, Path(folder) / name))


def _one_frame() -> float:
    """What is wrong with a dataset of one frame: faults, frames other than one, values not finite."""
    dataset = open_dataset(Path(_archive().name) / "one")
    frames = list(dataset.frames("train"))
    wrong = len(verify(dataset)) + abs(len(frames) - 1) + abs(len(dataset.splits) - 1)
    return float(wrong + sum(np.count_nonzero(~np.isfinite(frame.image)) for frame in frames))


def _empty_split() -> float:
    dataset = open_dataset(Path(_archive().name) / "one")
    return unrefused({"frames": lambda: list(dataset.frames("validation")), "shards": lambda: dataset.shards("test")})


def _everything(path: Path) -> list[str]:
    """Read a dataset's every frame, and what ``verify`` says."""
    dataset = open_dataset(path)
    faults = verify(dataset)
    for split in dataset.splits:
        list(dataset.frames(split))
    return faults


def _shard(dataset: Path) -> Path:
    """The one shard of a dataset's training split."""
    return dataset / "train" / "part-00000.parquet"


def _truncated() -> float:
    """Shards cut short that are not refused, at 40 lengths; the manifest's sizes are not asked."""
    with tempfile.TemporaryDirectory() as folder:
        shard = _shard(_copy(folder))
        whole = shard.read_bytes()

        def attempt(size: int) -> None:
            shard.write_bytes(whole[:size])
            list(read_frames(shard))

        sizes = np.linspace(0, len(whole) - 1, 40).astype(int).tolist()
        return unrefused({f"{size} bytes": lambda size=size: attempt(size) for size in sizes})  # type: ignore[misc]


def _flipped_bits() -> float:
    """Single flipped bits, at 300 places, that neither reading nor ``verify`` notices."""
    unnoticed = 0
    with tempfile.TemporaryDirectory() as folder:
        path = _copy(folder)
        shard = _shard(path)
        whole = shard.read_bytes()
        for number, place in enumerate(np.linspace(0, len(whole) - 1, 300).astype(int)):
            damaged = bytearray(whole)
            damaged[place] ^= 1 << (number % 8)
            shard.write_bytes(bytes(damaged))
            try:
                unnoticed += not _everything(path)
            except InputError as error:
                unnoticed += "\n" in str(error)
    return float(unnoticed)


def _foreign_shard() -> float:
    """Parquet files of others, or with parts of ours, that are not refused."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        ours = _shard(_copy(name))
        table = pq.read_table(ours)
        about = json.loads((table.schema.metadata or {})[b"sparseradar"])

        def write(file: str, content: pa.Table, description: object) -> Callable[[], object]:
            path = folder / file
            metadata = {b"sparseradar": json.dumps(description).encode()}
            pq.write_table(content.replace_schema_metadata(metadata), path)
            return lambda: list(read_frames(path))

        pq.write_table(pa.table({"x": [1, 2]}), folder / "other.parquet")
        (folder / "text.parquet").write_text("not Parquet", encoding="utf-8")
        shapes = about["shapes"]
        return unrefused(
            {
                "other columns": lambda: list(read_frames(folder / "other.parquet")),
                "text": lambda: list(read_frames(folder / "text.parquet")),
                "a folder": lambda: list(read_frames(folder)),
                "missing": lambda: list(read_frames(folder / "none.parquet")),
                "no description": write("a.parquet", table, []),
                "description is text": write("b.parquet", table, "version 1"),
                "no shapes": write("c.parquet", table, {"version": VERSION}),
                "shapes of words": write("d.parquet", table, {**about, "shapes": {**shapes, "image": ["many"]}}),
                "a shape is a number": write("e.parquet", table, {**about, "shapes": {**shapes, "image": 7}}),
                "shapes is a list": write("f.parquet", table, {**about, "shapes": [1, 2]}),
                "negative shape": write("g.parquet", table, {**about, "shapes": {**shapes, "image": [-12, -8]}}),
                "wrong shape": write("h.parquet", table, {**about, "shapes": {**shapes, "image": [12, 9]}}),
                "a column less": write("i.parquet", table.drop_columns(["seed"]), about),
                "row beyond": lambda: read_frame(ours, 5),
            }
        )


def _manifest() -> float:
    """Manifests that are not refused: of a newer version, without one, damaged, or of another form."""
    with tempfile.TemporaryDirectory() as folder:
        path = _copy(folder)
        good = json.loads((path / MANIFEST).read_bytes())
        record = good["shards"][0]
        documents: dict[str, object] = {
            "newer": {**good, "version": VERSION + 1},
            "version is text": {**good, "version": "1"},
            "version is true": {**good, "version": True},
            "no version": {key: value for key, value in good.items() if key != "version"},
            "a list": [good],
            "null": None,
            "no shards": {**good, "shards": []},
            "shards is text": {**good, "shards": "none"},
            "a shard elsewhere": {**good, "shards": [{**record, "path": "../train/part-00000.parquet"}]},
            "a shard twice": {**good, "shards": [record, record]},
            "a missing shard": {**good, "shards": [{**record, "path": "train/part-00007.parquet"}]},
            "no rows": {**good, "shards": [{**record, "rows": 0}]},
            "another size": {**good, "shards": [{**record, "bytes": 1}]},
        }

        def attempt(content: bytes) -> Dataset:
            (path / MANIFEST).write_bytes(content)
            return open_dataset(path)

        contents = {name: json.dumps(document).encode() for name, document in documents.items()}
        contents |= {"empty": b"", "not UTF-8": b'{"version": "\xff"}', "cut": contents["newer"][:100], "NaN": b"NaN"}
        contents["deep"] = b"[" * 100_000 + b"]" * 100_000
        return unrefused({name: lambda content=content: attempt(content) for name, content in contents.items()})  # type: ignore[misc]


def _newer_manifest_command() -> float:
    """Distance of the exit status from 2, and of the number of lines said from 1, for a manifest of a newer version."""
    with tempfile.TemporaryDirectory() as folder:
        path = _copy(folder)
        manifest = json.loads((path / MANIFEST).read_bytes())
        (path / MANIFEST).write_text(json.dumps({**manifest, "version": VERSION + 1}), encoding="utf-8")
        status, _, said = factory("inspect", path)
        return float(abs(status - 2) + abs(len(said.strip().splitlines()) - 1))


def _not_utf8_output() -> float:
    """Commands on a folder whose name is no UTF-8 that do not end with status 2 and one line."""
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / NOT_UTF8
        for status, _, said in (_render(out, "--frames", 1), factory("inspect", out)):
            wrong += status != 2 or len(said.strip().splitlines()) != 1
    return float(wrong)


def _not_utf8_inputs() -> float:
    """Input files under such a name that are neither read like those under a plain one, nor refused in one line."""
    wrong = 0
    texts = {
        ".toml": (RADAR, lambda path: load_radar(str(path))),
        ".json": ('[{"position": [0, 0, 1]}]', read_poses),
        ".JSON": ('[[{"x": 5, "y": 0, "rcs_dbsm": 0}]]', read_targets),
        ".TOML": ('default = "metal"', load_materials),
        ".obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", lambda path: open_scene(str(path))),
        ".xml": ('<scene version="3.0.0"><shape type="cube"/></scene>', lambda path: open_scene(str(path))),
        ".usda": (
            '#usda 1.0\n(\n metersPerUnit = 1\n upAxis = "Z"\n)\ndef Cube "c" {}\n',
            lambda path: open_scene(str(path)),
        ),
    }
    with tempfile.TemporaryDirectory() as folder:
        for suffix, (text, read) in texts.items():
            path = Path(folder) / f"{NOT_UTF8}{suffix}"
            try:
                path.write_text(text, encoding="utf-8")
            except OSError:  # as above
                return 0.0
            try:
                read(path)
            except InputError as error:
                wrong += "\n" in str(error)
    return float(wrong)


def _commands() -> float:
    """Commands on bad input that do not end with status 2 and one line."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        nested = "[" * 100_000
        (folder / "deep.json").write_text(nested, encoding="utf-8")
        (folder / "deep.toml").write_text(f"x = {nested}", encoding="utf-8")
        (folder / "huge.json").write_text('[{"position": [1e400, 0, 0]}]', encoding="utf-8")
        (folder / "big.json").write_text('[[{"x": 1' + "0" * 400 + ', "y": 0, "rcs_dbsm": 0}]]', encoding="utf-8")
        (folder / "digits.json").write_text('[[{"x": 1' + "0" * 9000 + ', "y": 0, "rcs_dbsm": 0}]]', encoding="utf-8")
        (folder / "huge.toml").write_text("[waveform]\nsamples = 100000000000000\n", encoding="utf-8")
        (folder / "cube.obj").write_text("v 5 -9 -9\nv 5 9 -9\nv 5 0 9\nf 1 2 3\n", encoding="utf-8")
        out = ("--out", folder / "out", "--workers", 1)
        scene = ("render", "--scene", folder / "cube.obj", *out)
        attempts = (
            ("points", "--targets", folder / "deep.json", *out),
            ("points", "--targets", folder / "big.json", *out),
            ("points", "--targets", folder / "digits.json", *out),
            ("points", "--targets", folder, *out),
            ("points", "--radar", folder / "deep.toml", *out),
            ("points", "--radar", folder / "huge.toml", "--frames", 1, *out),
            (*scene, "--poses", folder / "deep.json"),
            (*scene, "--poses", folder / "huge.json"),
            (*scene, "--materials", folder / "deep.toml"),
            ("render", "--scene", folder / "none.usda", *out),
            ("render", "--scene", folder, *out),
            ("inspect", folder),
            ("inspect", folder / "none"),
            ("render", "--paths", folder, *out),
        )
        wrong = []
        for arguments in attempts:
            status, _, said = factory(*arguments)
            if status != 2 or len(said.strip().splitlines()) != 1:
                wrong.append((arguments[:3], status, said))
        return float(len(wrong))


CASES = (
    HardCase("a dataset of one frame", "splits of nothing, batches of one", 0.0, "wrong answers", _one_frame),
    HardCase("an empty split", "an empty iterator, silently", 0.0, "not refused", _empty_split),
    HardCase("a truncated shard", "crash, or fewer frames", 0.0, "not refused", _truncated),
    HardCase("a shard with a flipped bit", "wrong numbers, silently", 0.0, "unnoticed of 300", _flipped_bits),
    HardCase("a foreign shard", "KeyError and its kin", 0.0, "not refused", _foreign_shard),
    HardCase("a manifest of a newer version, and worse", "read as if it were ours", 0.0, "not refused", _manifest),
    HardCase("inspect of a newer version", "a traceback", 0.0, "off status 2, one line", _newer_manifest_command),
    HardCase("output folder not in UTF-8", "UnicodeEncodeError", 0.0, "wrong ends", _not_utf8_output),
    HardCase("input files not in UTF-8", "as above", 0.0, "crashes", _not_utf8_inputs),
    HardCase("commands on hostile files", "a traceback", 0.0, "wrong ends", _commands),
)
