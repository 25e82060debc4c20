"""One trace a frame: from a merged scene and a pose to a PathTable.

First hits and single mirrors are in every frame. All else has candidates first (:mod:`datafactory.paths.candidates`):
what the frame's radar would not notice is not looked for (:mod:`datafactory.paths.notice`). Where every radar is to be
served, or every effect is asked for, all candidates are followed.

* What rough surfaces scatter is found by the frame's own rays (:mod:`datafactory.paths.scattered`). None ends with a
  mirror after a diffuse bounce. The reverses of such paths, mirror first, enter the table twice, with the TX's and the
  RX's side exchanged. A diffuse bounce takes on the phase of its surface cell (:mod:`.scattering`).
* Single mirrors are found without rays (:mod:`.mirrors`, :mod:`.curved_echoes`), chains of them by the solver
  (:mod:`.solver`), and where panes let waves through, those beyond them. A mirror reflects with the share of its
  facet's size (:mod:`.facets`).
* Targets given by a radar cross section (:mod:`.targets`), edges (:mod:`.diffraction`) and right-angled corners
  (:mod:`.corner_echoes`) are listed. Corners take the place of the solver's mirrors there.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from datafactory.defaults import LARGEST_DEPTH
from datafactory.paths.aim import aimed
from datafactory.paths.arrivals import Arrivals, Echoes
from datafactory.paths.candidates import CHAIN, MIRRORED, PANE, PASSED, TWICE, Candidates
from datafactory.paths.corner_echoes import CornerEchoes, CornerPointEchoes
from datafactory.paths.corners import corners_of, points_of
from datafactory.paths.curved_echoes import curved_mirrors
from datafactory.paths.curved_surfaces import curved_surfaces_of
from datafactory.paths.diffraction import EdgeEchoes
from datafactory.paths.edges import edges_of
from datafactory.paths.geometry import Geometry, placed
from datafactory.paths.merged_scene import MergedScene
from datafactory.paths.mirrors import single_mirrors
from datafactory.paths.notice import Notice
from datafactory.paths.rays import RayFan
from datafactory.paths.rows import scattered_rows, specular_rows
from datafactory.paths.scattered import SecondBounces, behind_panes
from datafactory.paths.slabs import Slabs
from datafactory.paths.solver import Bundle, TraceSettings, radio_scene, solve
from datafactory.paths.table import DIFFUSE, PathTable, ScatteredPaths, SpecularPaths
from datafactory.paths.targets import TargetEchoes
from datafactory.paths.view import View, pane_candidates
from datafactory.scenes.poses import Pose

Listed = TargetEchoes | EdgeEchoes | CornerEchoes | CornerPointEchoes
"""Echoes of which a frame knows a list: ``candidates`` with their bounds, nothing tested for visibility, and ``seen``,
those of the candidates that are worth it and in sight."""


@dataclass
class _Frame:
    """A frame as it is traced.

    :param fan: all its rays
    :param paths: in the order in which they were found
    """

    view: View
    fan: RayFan
    seed: int
    counts: dict[str, int]
    paths: list[ScatteredPaths | SpecularPaths] = field(default_factory=list)

    def add(self, part: ScatteredPaths | SpecularPaths, group: int | None = None) -> None:
        """More paths.

        :param group: index of their candidate; None of those that have none, or candidates of their own
        """
        own = part if group is None else replace(part, candidate=np.full(len(part), group, dtype=np.int32))
        self.paths.append(own)

    def add_scattered(self, echoes: Echoes, group: int | None = None) -> None:
        """Paths that end with a diffuse bounce."""
        name = "scattered_twice" if echoes.kinds.count(DIFFUSE) > 1 else "scattered_once"
        part = echoes.thinned(self.seed)
        self.counts[name] += len(part)
        for rows in scattered_rows(part, self.view, self.fan):
            self.add(rows, group)

    def table(self, candidates: Candidates) -> PathTable:
        """All that was found."""
        scattered = [part for part in self.paths if isinstance(part, ScatteredPaths)]
        specular = [part for part in self.paths if isinstance(part, SpecularPaths)]
        return PathTable(
            ScatteredPaths.joined([ScatteredPaths.none(), *scattered]),
            SpecularPaths.joined([SpecularPaths.none(), *specular]),
            objects=self.view.merged.objects,
            candidates=candidates,
            counts=self.counts,
        )


def trace(
    merged: MergedScene,
    pose: Pose,
    frequency_hz: float,
    settings: TraceSettings,
    fan: RayFan,
    seed: int,
    target_seed: int = 0,
    notice: Notice | None = None,
) -> PathTable:
    """The multipath of one frame, the point targets' echoes among it.

    :param merged: at any time; the frame is traced at the pose's
    :param frequency_hz: mid-sweep; materials take their values at 77 GHz whatever it is
    :param seed: of the solver's choices between kinds of bounce; 0 to 2**32 - 1
    :param target_seed: of where in their cycle the moving parts of targets are at time 0
    :param notice: of the radar that the frame is traced for: what it would not notice is not looked for; None: all is
    """
    merged = merged.at(pose.time_s)
    kept, slabs = placed(merged, pose), Slabs(merged.slabs, frequency_hz)
    view = View(kept.mi_scene, merged, slabs, pose, settings)
    panes = pane_candidates(view) if settings.refraction else Candidates.none()
    heard = len(panes) > 0 if notice is None else bool(notice.power_w(panes).any())
    settings = replace(settings, refraction=heard)
    view = replace(view, settings=settings)
    first, second = None, None
    if settings.diffuse and merged.meshes:
        fan = aimed(fan, view)
        first = Arrivals.first(view, fan)
        second = SecondBounces(first, seed) if settings.depth > 1 else None
    frame = _Frame(view, fan, seed, {"rays": settings.rays, "scattered_once": 0, "scattered_twice": 0})
    if first is not None:
        frame.add_scattered(first.echoes())
    if settings.specular:
        # Flat mirrors and curved ones, those beyond panes among them: these go with what else is beyond panes.
        singles, counts = single_mirrors(view)
        points, images, of_curved = curved_mirrors(view)
        frame.paths += [points, singles, images]
        frame.counts |= counts | of_curved
    listed = _listed(view, target_seed)
    groups = {PANE: panes, **dict.fromkeys((MIRRORED, TWICE, CHAIN, PASSED), Candidates.none())}
    groups |= second.candidates(len(panes) > 0) if second is not None else {}
    parts = [*(source.candidates for source in listed), *(Candidates.group(*group) for group in groups.items())]
    candidates = Candidates.joined(parts)
    worth = np.ones(len(candidates), dtype=bool)
    if notice is not None:
        worth = notice.worth(candidates, notice.limit_w(frame.table(candidates)))
    places = np.cumsum([0, *map(len, parts)])
    for source, start, stop in zip(listed, places, places[1:], strict=False):
        points, images, counts = source.seen(worth[start:stop])
        frame.add(replace(points, candidate=points.candidate + np.int32(start)))
        frame.add(replace(images, candidate=images.candidate + np.int32(start)))
        frame.counts |= counts
    begins = dict(zip(groups, places[len(listed) :], strict=False))
    followed = {group: int(start) for group, start in begins.items() if worth[start]}
    if first is not None:
        for group in (MIRRORED, TWICE):
            for echoes in second.echoes(group) if second is not None and group in followed else ():
                frame.add_scattered(echoes, followed[group])
        if settings.refraction and PANE in followed:
            frame.add_scattered(behind_panes(first), followed[PANE])
    _add_chains(frame, kept, followed)
    return frame.table(candidates)


def find_shapes(merged: MergedScene, settings: TraceSettings) -> None:
    """Find now what frames with these settings need of a scene's shape: it goes with the scene to other processes."""
    if settings.specular:
        curved_surfaces_of(merged)
    if settings.diffraction:
        edges_of(merged)
    if settings.corners:
        corners_of(merged)
        points_of(merged)


def _listed(view: View, target_seed: int) -> list[Listed]:
    """The sources of echoes that a frame knows a list of."""
    settings, listed = view.settings, list[Listed]()
    if settings.point_targets:
        listed.append(TargetEchoes(view, target_seed))
    if settings.diffraction:
        listed.append(EdgeEchoes(view))
    if settings.corners:
        listed += [CornerEchoes(view), CornerPointEchoes(view)]
    return listed


def _add_chains(frame: _Frame, kept: Geometry, followed: dict[int, int]) -> None:
    """Chains of mirrors, and those through panes, of the groups that are followed, by one pass of the solver each.

    A ray that may pass a pane is reflected there by chance: in one pass for both, chains over small panes are lost.
    """
    view, settings, groups = frame.view, frame.view.settings, dict[int, Bundle]()
    frame.counts |= {"traced": 0, "invalid": 0, "truncated": 0}
    passes = {CHAIN: replace(settings, depth=LARGEST_DEPTH, diffuse=False, refraction=False)}
    if settings.refraction and PANE in followed:  # without what is beyond panes, nothing that passed one is kept
        passes[PASSED] = replace(settings, depth=LARGEST_DEPTH, diffuse=False)
    wanted = [group for group in passes if group in followed]
    if wanted and settings.depth > 1 and settings.specular and view.merged.meshes:
        scene = radio_scene(kept, view.slabs, settings)
        for group in wanted:
            groups[group], counts = solve(scene, view.merged, passes[group], frame.fan, frame.seed)
            frame.counts["invalid"] += counts["invalid"]
            frame.counts["truncated"] = max(frame.counts["truncated"], counts["truncated"])
    if PASSED in groups:
        groups[PASSED] = groups[PASSED].take(groups[PASSED].crossings > 0)
    if settings.corners and CHAIN in groups:
        groups[CHAIN], frame.counts["corners_by_the_solver"] = _without_corners(groups[CHAIN], view.merged)
    for group, bundle in groups.items():
        frame.counts["traced"] += len(bundle)
        for depth in range(2, bundle.interactions.shape[1] + 1):
            frame.add(specular_rows(bundle.of_bounces(depth).with_reverses().in_fixed_order(), view), followed[group])


def _without_corners(bundle: Bundle, merged_scene: MergedScene) -> tuple[Bundle, int]:
    """The paths without those that are mirrored once by each face of a corner and nothing else, and their number.

    Those are left to :mod:`datafactory.paths.corner_echoes`. The ray that a corner turns back to the radar runs into an
    edge, or into the point in which three faces meet: a path solver finds it by chance or not at all.
    """
    corners = corners_of(merged_scene)
    count = (bundle.interactions > 0).sum(axis=1)
    mirrored = (bundle.interactions != DIFFUSE).all(axis=1) & (bundle.crossings == 0)
    keep = np.ones(len(count), dtype=bool)
    for bounces in range(2, min(bundle.interactions.shape[1], 3) + 1):
        index = np.flatnonzero(mirrored & (count == bounces))
        keep[index] = ~corners.hold(bundle.triangles[index, :bounces])
    return bundle.take(keep), int((~keep).sum())
