"""Evidence for the plan of a run: from frames of its own, and kept in the user's cache."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

from threadpoolctl import threadpool_limits

from datafactory.effects.evidence import Evidence, Gathered, Probe, gather
from datafactory.paths.backend import select_variant, set_threads
from datafactory.run.cache import Announce, cached, user_cache

POSES = 3
"""Frames of a run that are looked at, spread over it: an effect is needed if any of them needs it."""


def looked_at(own: range) -> tuple[int, ...]:
    """Frame numbers to probe among a scene's own."""
    if not own:
        return ()
    return tuple(sorted({own[0], own[len(own) // 2], own[-1]}))[:POSES]


def gathered(content: str, probe: Probe, announce: Announce) -> Mapping[str, Evidence]:
    """The evidence on one scene, measured once.

    :param content: the scene's hash
    """
    inputs = {
        "scene": content,
        "materials": probe.materials.to_json(),
        "radar": probe.radar.model_dump(mode="json"),
        "poses": [asdict(pose) for pose in probe.poses],
        "settings": asdict(probe.settings),
        "seed": probe.seed,
    }

    def measure(_: object) -> Gathered:
        select_variant()
        set_threads(1)
        with threadpool_limits(limits=1):
            return gather(probe)

    return cached(user_cache() / "effects", inputs, Gathered, measure, announce).evidence
