"""What a dataset's manifest says of the scenes that its frames were rendered in."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError


class SceneRecord(BaseModel):
    """One scene of a dataset.

    :param name: as the frames' column ``scene`` has it
    :param content_sha256: over geometry, materials, motion and targets, what was put in included
    :param populate: what ``--populate`` put in, as it was asked for; None for a scene as its file has it
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    content_sha256: str
    populate: str | None = None


def scene_records(manifest: Mapping[str, Any]) -> tuple[SceneRecord, ...] | None:
    """The scenes of a manifest in its order; None where it does not say them, as one of another maker may not.

    A dataset of close targets alone has none.
    """
    entries = manifest.get("scenes")
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        return None
    try:
        return tuple(
            SceneRecord(
                name=entry["name"],
                content_sha256=entry["content_sha256"],
                populate=entry["population"]["populate"] if "population" in entry else None,
            )
            for entry in entries
        )
    except (KeyError, TypeError, ValidationError):
        return None
