"""What to say of a deal before anything is made: poses and drives that are probably not what was meant."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from datafactory.frame.deal import Deal
from datafactory.frame.draws import split_of
from datafactory.scenes.boxes import CLEAR_M
from datafactory.scenes.buried import buried
from datafactory.scenes.drives import CRUISING_SPEEDS
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import Scene
from shared.dataset.folder import Split

SLOW, ALIKE_M = 0.5, 0.5
"""Share of the speed that is asked for, below which a drawn drive is said: bends and stops cost as much. And how near
to another, all along, it is one with it [m]: a lane's points stand so far apart."""
NEIGHBOURS_M = 10.0
"""Tracks of different splits in one scene that come nearer than this are told: a test would be of what was trained."""


def remarks(deal: Deal, opened: Sequence[Scene] = ()) -> list[str]:
    """What to say of scenes without a frame, of poses at which everything that had samples stands still, of those
    that are under the ground or inside something, of drawn drives that are slow or alike, of tracks of different
    splits that come near each other, and of given poses that something of a population drives or walks through.

    :param opened: the scenes
    """
    said = list[str]()
    # Dealt in turn, the first frames, or sequences, are those of the first scenes, one each.
    idle = [movers.scene for movers in deal.traffic[len(deal.tracks) or deal.scene_frames :]]
    if idle:
        said.append(f"{len(idle)} of {deal.scenes} scenes have no frame: {', '.join(idle)}")
    given: list[list[Pose]] = [[] for _ in deal.traffic]
    for frame_id in range(deal.scene_frames if deal.traffic else 0):
        if (pose := deal.pose_of(frame_id)) is not None:
            given[deal.scene_of(frame_id)].append(pose)
    for movers, poses in zip(deal.traffic, given, strict=True):
        if late := sum(pose.time_s >= movers.rests_from_s for pose in poses):
            from_when = f"{movers.rests_from_s:g} s, from when on what has samples rests"
            said.append(f"{movers.scene}: {late} of {len(poses)} poses are not before {from_when}")
        if early := sum(pose.time_s < movers.moves_from_s for pose in poses):
            until = f"{movers.moves_from_s:g} s, until when what has samples rests"
            said.append(f"{movers.scene}: {early} of {len(poses)} poses are before {until}")
    for scene, poses in zip(opened, given, strict=False):
        if hidden := int(buried(scene, np.array([pose.position for pose in poses]).reshape(-1, 3)).sum()):
            said.append(f"{scene.name}: {hidden} of {len(poses)} poses are under the ground or inside something")
    said += _on_drives(deal)
    said += _on_splits(deal)
    said += _on_neighbours(deal)
    near = 0
    for movers, poses in zip(deal.traffic, given if deal.poses else (), strict=False):
        near += sum(movers.populated_s is not None and not movers.clear_of([pose]) for pose in poses)
    if near:
        said.append(f"{near} of {len(deal.poses)} poses are within {CLEAR_M:g} m of what drives or walks by")
    return said


def _on_splits(deal: Deal) -> list[str]:
    """The splits whose given poses or tracks all stand in one of several scenes: both are dealt in turn."""
    if len(deal.traffic) < 2 or not (deal.poses or deal.tracks) or deal.drives is not None:
        return []
    scenes = defaultdict[Split, list[int]](list)
    for number in range(len(deal.tracks) or len(deal.poses)):
        scene = deal.track_scenes[number] if deal.tracks else deal.scene_of(number)
        scenes[split_of(number, deal.split)].append(scene)
    return [
        f"all {split} frames stand in {deal.traffic[found[0]].scene}"
        for split, found in scenes.items()
        if len(found) > 1 and len(set(found)) == 1
    ]


def _on_neighbours(deal: Deal) -> list[str]:
    """Of each sequence those of other splits in its scene to which one of its poses comes nearest, if near."""
    parts = defaultdict[tuple[int, Split], list[int]](list)
    for number, scene in enumerate(deal.track_scenes):
        parts[scene, split_of(number, deal.split)].append(number)
    near = dict[tuple[int, int], float]()
    for one, other in combinations(parts, 2):
        if one[0] == other[0]:
            (points, of_one), (others, of_other) = (_places(deal, parts[part]) for part in (one, other))
            apart_m, index = cKDTree(points).query(others, distance_upper_bound=NEIGHBOURS_M)
            for place in np.flatnonzero(np.isfinite(apart_m)):
                first, second = sorted((int(of_one[index[place]]), int(of_other[place])))
                near[first, second] = min(float(apart_m[place]), near.get((first, second), np.inf))
    return [
        f"sequences {one} ({split_of(one, deal.split)}) and {other} ({split_of(other, deal.split)}) come within "
        f"{near[one, other]:.1f} m of each other"
        for one, other in sorted(near)
    ]


def _places(deal: Deal, sequences: Sequence[int]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """[P, 3] where the sequences' poses stand [m], and [P] of which sequence each is."""
    places = [pose.position for number in sequences for pose in deal.tracks[number]]
    return np.array(places), np.repeat(sequences, [len(deal.tracks[number]) for number in sequences])


def _on_drives(deal: Deal) -> list[str]:
    """What to say of drawn drives whose streets are too short for their speed, or few."""
    if deal.drives is None or not deal.tracks:
        return []
    said, count = list[str](), len(deal.tracks)
    ways = [np.array([pose.position for pose in track]) for track in deal.tracks]
    mean_mps = [np.linalg.norm([pose.velocity for pose in track], axis=1).mean() for track in deal.tracks]
    asked = deal.drives.speed_mps
    if asked is None:
        asked = (deal.speed_mps or CRUISING_SPEEDS)[0]
    if slow := sum(speed < SLOW * asked for speed in mean_mps):
        said.append(
            f"{slow} of {count} drives have less than {SLOW * asked:g} of {asked:g} m/s: their streets are short"
        )
    # The last drive may be cut short. Only those that begin at one place are compared.
    alike = {
        other
        for one, other in cKDTree(np.array([way[0] for way in ways])).query_pairs(ALIKE_M)
        if deal.track_scenes[one] == deal.track_scenes[other]
        and all(np.linalg.norm(a - b) < ALIKE_M for a, b in zip(ways[one], ways[other], strict=False))
    }
    if alike:
        said.append(f"{len(alike)} of {count} drives go the way of an earlier one, perhaps at another time")
    return said
