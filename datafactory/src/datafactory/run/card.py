"""The dataset's card, ``DIR/README.md``: what a person who finds the folder, or the Hugging Face Hub, reads first.

It follows from the manifest without its ``made``, so that equal runs have equal cards. Its front matter is YAML as the
Hub takes it (https://huggingface.co/docs/hub/datasets-cards); values are written as JSON, which YAML reads.

Its licence is that of the dataset, as its maker states it; beside it stand those of the scenes, where they are known.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa
from packaging.licenses import InvalidLicenseExpression, canonicalize_license_expression

from datafactory.frame.chain import FRAMES_WITH
from datafactory.scenes.readers.open import SHIPPED_PREFIX, SIONNA_PREFIX
from shared.dataset import arrow_schema
from shared.dataset.folder import SPLITS
from shared.physics.errors import InputError

CARD = "README.md"

COLUMNS = {
    "frame_id": "index in the dataset",
    "kind": '"scene", or "points" for drawn or given point targets',
    "scene": "name of the scene",
    "seed": "the frame's own seed",
    "time": "in the scene [s]",
    "sequence": "which drive the frame belongs to",
    "sensor_position": "in the scene's world frame [m]",
    "sensor_velocity": "in the scene's world frame [m/s]",
    "sensor_orientation": "quaternion w, x, y, z from the radar frame to the world frame",
    "range_channel": "input: real and imaginary part at the strongest Doppler peaks of each range bin, noisy [sqrt(W)]",
    "velocity": "of those Doppler peaks [m/s], positive is receding",
    "image": "truth: magnitude of the virtual sensor, noise free, relative to `image_peak`; range and u rise",
    "image_peak": "the magnitude that 1.0 in `image` stands for [sqrt(W)]",
    "noise_power": "of one channel in one range-Doppler cell [W]",
    "targets": "what is really there, strongest first: range [m], u, velocity [m/s], amplitude_db, object",
    "boxes": "what moves or has a class: center, size [m], yaw [rad], velocity [m/s], class, object, power [W]",
    "range_doppler": "mean magnitude over channels [sqrt(W)]",
    "cube": "real and imaginary part of the IF samples [sqrt(W)]",
}
"""What every column means, in one line."""

AXES = {
    "range_channel": "Doppler peak, range, channel, re/im",
    "velocity": "Doppler peak, range",
    "image": "range, u",
    "range_doppler": "range, Doppler",
    "cube": "chirp, sample, channel, re/im",
}
"""Names of the axes of the array columns."""

NOT_IN_IT = (
    "Measurements: every value is simulated.",
    "Interference by other radars, rain, snow and spray.",
    "Lidar and map; camera pictures only where there is a folder `camera`.",
)

_SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
_LARGEST = "1M<n<10M"


UNKNOWN = "unknown"
# Of the licences for data those that the Hub knows by name (https://huggingface.co/docs/hub/repositories-licenses):
# SPDX identifiers in small letters. Those named otherwise there stand with their names.
_ON_THE_HUB = {
    name: name
    for name in (
        "apache-2.0", "mit", "bsd-2-clause", "bsd-3-clause", "bsd-3-clause-clear", "cc0-1.0", "cc-by-2.0",
        "cc-by-2.5", "cc-by-3.0", "cc-by-4.0", "cc-by-sa-3.0", "cc-by-sa-4.0", "cc-by-nc-2.0", "cc-by-nc-3.0",
        "cc-by-nc-4.0", "cc-by-nd-4.0", "cc-by-nc-nd-3.0", "cc-by-nc-nd-4.0", "cc-by-nc-sa-2.0", "cc-by-nc-sa-3.0",
        "cc-by-nc-sa-4.0", "cdla-sharing-1.0", "cdla-permissive-1.0", "cdla-permissive-2.0", "mpl-2.0", "isc",
        "unlicense", "zlib",
    )
} | {"odbl-1.0": "odbl", "odc-by-1.0": "odc-by", "pddl-1.0": "pddl", "c-uda-1.0": "c-uda"}  # fmt: skip
_OPENSTREETMAP = ("etoile", "florence", "munich", "san_francisco")
"""Scenes of Sionna made of OpenStreetMap's data, as its documentation says."""


def card(manifest: Mapping[str, Any]) -> str:
    """The card's text; the same for the same manifest but for ``made``.

    :param manifest: of a dataset that holds frames
    """
    rows = _rows(manifest["shards"])
    parts = [_front_matter(manifest, rows), _summary(manifest, rows), _contents(manifest), _reading(manifest, rows)]
    parts += [_frames(manifest), _origin(manifest), _licence(manifest)]
    return "\n".join(parts)


def _rows(shards: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """Frames of each split that has any, in the usual order."""
    counted: Counter[str] = Counter()
    for shard in shards:
        counted[shard["path"].partition("/")[0]] += shard["rows"]
    return {split: counted[split] for split in SPLITS if counted[split]}


def _front_matter(manifest: Mapping[str, Any], rows: Mapping[str, int]) -> str:
    frames = sum(rows.values())
    size = next((name for most, name in _SIZES if frames < most), _LARGEST)
    licence, name = hub_licence(manifest.get("license"))
    lines = ["---", f"pretty_name: {json.dumps(_title(manifest))}", f"license: {json.dumps(licence)}"]
    lines += [f"license_name: {json.dumps(name)}"] if name else []
    lines += [
        "tags:",
        *(f"- {tag}" for tag in ("radar", "fmcw", "mimo", "automotive", "synthetic", "super-resolution")),
    ]
    lines += ["size_categories:", f"- {json.dumps(size)}", "configs:", "- config_name: default", "  data_files:"]
    for split in rows:
        lines += [f"  - split: {split}", f"    path: {split}/*.parquet"]
    return "\n".join([*lines, "---", ""])


def _title(manifest: Mapping[str, Any]) -> str:
    names = [scene["name"] for scene in manifest["scenes"]]
    of = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "") if names else "point targets"
    return f"Simulated FMCW radar frames: {of}"


def _summary(manifest: Mapping[str, Any], rows: Mapping[str, int]) -> str:
    radar, axes = manifest["radar"], manifest["axes"]
    channels, virtual = (len(of["tx_m"]) * len(of["rx_m"]) for of in (manifest["array"], manifest["virtual_sensor"]))
    farthest = axes["range_m"]["start"] + axes["range_m"]["step"] * (axes["range_m"]["bins"] - 1)
    shares = ", ".join(f"{count} {split}" for split, count in rows.items())
    return f"""# {_title(manifest)}

{sum(rows.values())} frames ({shares}), simulated. A row is a frame. It holds what the radar `{radar["name"]}` measures,
and what an array of {virtual} elements would see without noise at the same place.

| | |
|---|---|
| carrier, bandwidth | {radar["carrier_hz"] / 1e9:g} GHz, {radar["bandwidth_hz"] / 1e6:g} MHz |
| virtual channels | {channels} |
| chirps, samples | {radar["chirps"]} x {radar["samples"]} |
| range | {axes["range_m"]["bins"]} bins of {axes["range_m"]["step"]:.4g} m, to {farthest:.4g} m |
| u = sin(azimuth) | {axes["u"]["bins"]} bins from {axes["u"]["start"]:g}, left is positive |
| velocity | {axes["velocity_mps"]["bins"]} bins of {abs(axes["velocity_mps"]["step"]):.4g} m/s, receding is positive |
"""


def _contents(manifest: Mapping[str, Any]) -> str:
    lines = ["## Columns", "", "| column | type | shape | meaning |", "|---|---|---|---|"]
    shapes = manifest["shapes"]
    for field in arrow_schema({"shapes": shapes}):
        shape = ""
        if field.name in shapes:
            shape = f"{' x '.join(map(str, shapes[field.name]))} ({AXES[field.name]})"
        lines.append(f"| `{field.name}` | {_plain(field.type)} | {shape} | {COLUMNS.get(field.name, '')} |")
    more = """
Array columns are flat lists in C order. Radar, axes and shapes stand as JSON in each file's metadata, under
`sparseradar`.
`targets` and `boxes` hold for mid-frame. The radar frame has x forward, y left and z up. The velocity of a box is
relative to the radar; the velocity over ground is that plus the sensor's, turned into the radar frame.
"""
    return "\n".join(lines) + "\n" + more


def _plain(kind: pa.DataType) -> str:
    """A type in few letters."""
    if pa.types.is_fixed_size_list(kind):
        return f"{_plain(kind.value_type)}[{kind.list_size}]"
    if pa.types.is_list(kind):
        return "list of structs"
    return {"float": "float32", "double": "float64"}.get(str(kind), str(kind))


def _reading(manifest: Mapping[str, Any], rows: Mapping[str, int]) -> str:
    image, signal = manifest["shapes"]["image"], manifest["shapes"]["range_channel"]
    return f"""## Reading it

In this folder, with [datasets](https://huggingface.co/docs/datasets) (`pip install datasets`):

```python
from pathlib import Path

from datasets import load_dataset

folder = str(Path.cwd())  # or a name on the Hub
frames = load_dataset(folder, split="{next(iter(rows))}")
row = frames.with_format("numpy", columns=["range_channel", "image"])[0]
image = row["image"].reshape({", ".join(map(str, image))})  # [range, u]
signal = row["range_channel"].reshape({", ".join(map(str, signal))})
signal = signal[..., 0] + 1j * signal[..., 1]  # [Doppler peak, range, channel]
boxes = frames[0]["boxes"]  # a list of dictionaries
```

Any other reader of Parquet serves as well: polars, DuckDB, pandas, pyarrow.
"""


def _frames(manifest: Mapping[str, Any]) -> str:
    counts, arguments = manifest["counts"], manifest["arguments"]
    lines = ["## What was simulated", ""]
    effects = {n.removeprefix(FRAMES_WITH): v for n, v in counts.items() if n.startswith(FRAMES_WITH)}
    if effects:
        lines += ["| effect | scene frames with it |", "|---|---|"]
        lines += [f"| {name} | {count:.0f} |" for name, count in effects.items()]
        lines.append("")
    if points := arguments.get("points") or len(arguments.get("targets", ())):
        lines += [f"{points} frames hold point targets alone: Doppler, near field, noise, no multipath.", ""]
    lines += ["## What is not in it", "", *(f"- {line}" for line in NOT_IN_IT)]
    lines += [f"- {name}: in none of the scene frames." for name, count in effects.items() if not count]
    return "\n".join(lines) + "\n"


def _origin(manifest: Mapping[str, Any]) -> str:
    arguments = manifest["arguments"]
    versions = ", ".join(f"{name} {number}" for name, number in sorted(arguments["versions"].items()))
    lines = ["## How it was made", "", f"Seed {arguments['seed']}, split {arguments['split']}; {versions}."]
    lines.append(
        "`manifest.json` holds all arguments, the radar, the counts of frames by effect and a checksum of every file."
    )
    if manifest["scenes"]:
        lines += ["", "| scene | content (SHA-256) | its licence |", "|---|---|---|"]
        lines += [
            f"| {scene['name']} | `{scene['content_sha256'][:16]}` | {scene_licence(scene.get('source', ''))} |"
            for scene in manifest["scenes"]
        ]
    return "\n".join(lines) + "\n"


def _licence(manifest: Mapping[str, Any]) -> str:
    stated = manifest.get("license")
    if stated:
        return f"## Licence\n\n{stated}\n"
    return (
        "## Licence\n\nNot stated. Frames belong to whoever owns the scenes that they were made of. To publish them,\n"
        "state a licence: `license:` above, or `--license` as the dataset is made, e.g. `--license CC-BY-4.0`.\n"
    )


def stated_licence(text: str | None) -> str | None:
    """An SPDX expression in its canonical form; None for none.

    :raises InputError: no SPDX identifier, nor an expression of such
    """
    if text is None:
        return None
    try:
        return canonicalize_license_expression(text)
    except InvalidLicenseExpression as error:
        expected = "an SPDX identifier, e.g. CC-BY-4.0, CC0-1.0, ODbL-1.0, or LicenseRef-NAME for one of your own"
        raise InputError("--license", f"{text!r}: {' '.join(str(error).split())}", expected) from error


def hub_licence(stated: str | None) -> tuple[str, str | None]:
    """The Hub's ``license`` for an SPDX expression, and its ``license_name`` where the Hub has none for it."""
    if stated is None:
        return UNKNOWN, None
    known = _ON_THE_HUB.get(stated.lower())
    return (known, None) if known else ("other", stated.lower().replace(" ", "-"))


def scene_licence(source: str) -> str:
    """What is known of the licence of a scene.

    :param source: as the manifest has it
    """
    if source.startswith(SHIPPED_PREFIX):
        return "Apache-2.0, as this software"
    if source.startswith(SIONNA_PREFIX):
        name = source.removeprefix(SIONNA_PREFIX)
        return "ODbL-1.0, OpenStreetMap contributors" if name in _OPENSTREETMAP else "Apache-2.0, as Sionna"
    return "not known here: its author's"
