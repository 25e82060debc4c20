"""What is in a dataset, in numbers, and what the numbers mean that frames count."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from datafactory.frame.chain import FRAMES_WITH
from shared.dataset.folder import MANIFEST, Dataset
from shared.physics.errors import InputError


@dataclass(frozen=True)
class Summary:
    """The numbers of a dataset, as ``datafactory inspect --json`` prints them.

    :param frames: number of frames by split, then by kind; empty for a folder of traced paths alone
    :param scenes: scene name to number of frames
    :param sequences: number of sequences of frames along a track
    :param traced: frames whose traced paths are stored
    :param radar: its name; "" where there are no frames
    :param shapes: array columns and their shapes
    :param shards: number of shards
    :param bytes: size of all shards
    :param counts: what the manifest counted, e.g. what was left out
    """

    frames: dict[str, dict[str, int]]
    scenes: dict[str, int]
    sequences: int
    traced: int
    radar: str
    shapes: dict[str, list[int]]
    shards: int
    bytes: int
    counts: dict[str, Any]


def summarise(dataset: Dataset) -> Summary:
    """Count a dataset's frames; only the columns of a few bytes are read.

    :raises InputError: a shard that is damaged
    """
    kinds: defaultdict[str, Counter[str]] = defaultdict(Counter)
    scenes: Counter[str] = Counter()
    sequences: set[int] = set()
    for split in dataset.splits:
        for frame in dataset.frames(split, columns=()):
            kinds[split][frame.kind] += 1
            scenes[frame.scene] += 1
            sequences.add(frame.sequence)
    counts = dataset.manifest.get("counts", {})
    if not isinstance(counts, dict):
        raise InputError(dataset.path / MANIFEST, f"counts = {counts!r}", "a number for each thing counted")
    description: dict[str, Any] = dataset.description() if dataset.splits else {"radar": {"name": ""}, "shapes": {}}
    return Summary(
        frames={split: dict(counted) for split, counted in kinds.items()},
        scenes=dict(scenes),
        sequences=len(sequences - {-1}),
        traced=sum(record.rows for record in dataset.records if record.path.startswith("paths/")),
        radar=description["radar"]["name"],
        shapes=description["shapes"],
        shards=len(dataset.records),
        bytes=sum(record.bytes for record in dataset.records),
        counts=counts,
    )


MEANINGS = {
    "frames": "frames",
    "frames_empty": "frames whose truth is empty: nothing in them is above the noise",
    "rays": "rays sent",
    "traced": "paths that the solver found: mirrors one after another",
    "close_targets": "targets of close-target frames",
    "scattered_once": "echoes that a rough surface scattered once, at their last bounce",
    "scattered_twice": "echoes that rough surfaces scattered twice and more",
    "truncated": "frames in which the solver's room for paths was used up, so that paths may be missing",
    "invalid": "empty places among the solver's paths",
    "mirrors_hidden": "mirrors that something stands before",
    "curved_mirrors": "places on curved surfaces that reflect straight back",
    "curved_mirrors_hidden": "curved mirrors that something stands before",
    "triangles_round_their_focus": "triangles of curved surfaces that lie around their focus, and are left out",
    "facets_too_coarse": "facets that look like a curved surface and reflect as flat ones; a finer mesh would tell",
    "right_angles": "pairs of faces at a right angle",
    "corner_edges": "edges of right-angled corners",
    "corner_points": "points where three faces meet at right angles",
    "corners_faint": "right-angled corners in sight, too small to be heard",
    "corners_hidden": "right-angled corners that something stands before",
    "corners_by_the_solver": "echoes of corners that the solver found as well, taken once",
    "corner_points_off_square": "corners of three faces too far from right angles to send the wave back",
    "corner_points_hidden": "corners of three faces that something stands before",
    "target_mirrors": "ways to targets over a mirror",
    "target_mirrors_left_out": "weaker ways to targets over a mirror",
    "target_mirrors_too_wide": "ways out and back over mirrors too far apart for one echo point",
    "edge_rays": "ways over an edge to the sensor and back that were looked at",
    "edge_rays_hidden": "of these, those that something stands in",
    "edges_round_corners_left_out": "weaker edges over which a hidden target is reached as well",
    "targets_faint": "point targets too far away to be heard",
    "point_targets_hidden": "point targets that the sensor does not see directly",
    "targets_round_corners": "of these, those heard round an edge",
    "targets_unreached": "of these, those not heard at all",
    "target_echoes_silent": "echo points of targets that send nothing into this direction",
    "targets_in_near_field": "targets nearer than their cross section holds",
    "target_echoes_at_sensor": "echo points of targets within 1 cm of the sensor, left out",
    "beyond_range": "paths beyond the unambiguous range, left out",
    "folded_beyond_range": "targets of a list beyond the unambiguous range, folded onto a nearer one",
    "targets_beyond_range": "echo points of targets beyond the unambiguous range, left out",
    "pruned": "paths left out because they hold too little of their range-Doppler cell's power",
    "paths": "paths that the frames are made of",
    "paths_standing": "of these, those that do not move in the frame",
    "paths_along_lines": "of these, those whose phase is a straight line or nearly so",
    "paths_by_chirps": "of these, those computed chirp by chirp",
    "cells_lit": "resolution cells with an echo in them",
    "cells_lit_by_fewer_than_5_paths": "of these, those whose echo is the sum of too few paths for natural speckle",
    "targets_left_out": "of the targets and the truth's cells above the noise, those beyond 256 of a frame",
    "boxes": "boxes of objects that move or have a class",
    "targets_out_of_view": "targets of a list, and echo points in sight, beyond the range or the field of view:"
    " not listed as targets",
    "boxes_out_of_view": "boxes beyond the range or the field of view, left out",
    "converter_saturated": "samples that the converter cut off",
}
"""In words, by name; a name that is not here is told as it is."""

ALARMING = (
    "frames_empty", "truncated", "targets_in_near_field", "target_echoes_at_sensor", "folded_beyond_range",
    "targets_beyond_range", "converter_saturated",
)  # fmt: skip
"""Told without being asked for: something may be wrong with the frames, or is not in them."""


def told(counts: Mapping[str, float], verbose: bool) -> list[str]:
    """Lines that say what was counted.

    :param counts: of a manifest
    :param verbose: everything that is not zero; otherwise what is :data:`ALARMING`, and the effects of the frames
    """
    wanted = [name for name in MEANINGS if name != "frames"] if verbose else ALARMING
    if verbose:
        wanted = [*wanted, *(name for name in counts if name not in MEANINGS and not name.startswith(FRAMES_WITH))]
    lines = [f"{counts[name]:.0f} {MEANINGS.get(name, name.replace('_', ' '))}" for name in wanted if counts.get(name)]
    made_with = {name.removeprefix(FRAMES_WITH): n for name, n in counts.items() if name.startswith(FRAMES_WITH)}
    if made_with:
        numbers = sorted(set(made_with.values()), reverse=True)
        having = {count: ", ".join(name for name, n in made_with.items() if n == count) for count in numbers}
        told_each = (
            f"in {count:.0f} frame{'' if count == 1 else 's'} {names}" if count else f"never {names}"
            for count, names in having.items()
        )
        lines.append(f"effects simulated: {'; '.join(told_each)}")
    return lines
