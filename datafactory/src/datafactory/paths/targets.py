"""Echoes of targets with a radar cross section: in sight, behind panes, over mirrors, round corners."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from datafactory.paths.candidates import TARGET_MIRRORED, TARGET_SEEN, Candidates
from datafactory.paths.diffraction import Heard
from datafactory.paths.echo_points import Seen, all_echo_points
from datafactory.paths.mirrored_targets import DirectWays, echoes_over_mirrors
from datafactory.paths.panes import FAINTEST, panes_between
from datafactory.paths.round_corners import echoes_round_corners
from datafactory.paths.table import REFRACTED, TARGET, ScatteredPaths, SpecularPaths
from datafactory.paths.view import EDGES_WITHIN_M, View
from shared.physics.units import db_to_power
from shared.physics.vectors import Mask, Real, lengths

FAINTEST_ECHO = 1e-2 / EDGES_WITHIN_M**4
"""Cross section over the fourth power of the distance [1/m^2] below which a target in plain sight is left out: as faint
as such an edge. A pedestrian is so faint from 585 m on."""
ROUND_CORNERS_DB = 12.0
"""What a way round an edge loses at least, out and back: half of the field is there at the shadow's boundary."""


MIRRORED_MORE = 24.0 * 4.0
"""What all echoes of a target over mirrors have at most, over its own in plain sight: 24 paths
(:data:`.mirrored_targets.MIRRORS_PER_POINT`), none nearer and no mirror amplifying, of a cross section that is at most
four times as large from where the mirrors stand."""


class TargetEchoes:
    """Echoes of the point targets.

    Radar equation for isotropic antennas of unit power: lambda sqrt(sigma) / ((4 pi)^(3/2) R^2), times the panes'
    transmission both ways. With second bounces and mirrors, those over mirrors too
    (:mod:`datafactory.paths.mirrored_targets`).

    :param seed: of where in their cycle moving parts are at time 0
    """

    def __init__(self, view: View, seed: int = 0) -> None:
        self._view, settings, pose = view, view.settings, view.pose
        crossed = settings.polarization[0] != settings.polarization[1]
        self._circumstances = Seen(view.wavelength_m, pose.time_s, crossed, seed)
        targets = view.merged.targets
        self._away = (
            np.array([target.position for target in targets]).reshape(-1, 3) - np.asarray(pose.position)
        ) @ view.rotation
        self._nominal = np.array([float(db_to_power(target.rcs_dbsm)) for target in targets])
        self._loudness = self._nominal / np.maximum(lengths(self._away) ** 4, np.finfo(float).tiny)
        points = all_echo_points(view.merged.targets, pose.position, self._circumstances)
        self._points = points.take((self._loudness >= FAINTEST_ECHO)[points.target]).seen_by(pose)
        self._range_m = lengths(self._points.position)
        self._over_mirrors = bool(settings.specular and settings.depth > 1 and view.merged.meshes and len(self._points))

    @property
    def _amplitude(self) -> Real:
        """[K] of the echo points in plain sight."""
        distance = np.where(self._range_m > 0.0, self._range_m, 1.0)
        return self._points.amplitudes(self._view.wavelength_m) / distance**2

    @property
    def candidates(self) -> Candidates:
        """Of every echo point: itself, in plain sight or round an edge; of every target: all that mirrors add to it."""
        itself = Candidates.of(TARGET_SEEN, self._points.position, self._amplitude**2)
        if not self._over_mirrors:
            return itself
        whole = np.bincount(self._points.target, self._points.rcs_m2, len(self._nominal))
        of_sight = self._view.wavelength_m**2 * np.maximum(whole, self._nominal) / (4.0 * np.pi) ** 3
        power = MIRRORED_MORE * of_sight / np.maximum(lengths(self._away), 1e-3) ** 4
        heard = self._loudness >= FAINTEST_ECHO
        return Candidates.joined([itself, Candidates.of(TARGET_MIRRORED, self._away, np.where(heard, power, 0.0))])

    def seen(self, worth: Mask) -> Heard:
        """The echoes, no paths without a scattering point, and the numbers of those left out."""
        view, points, settings = self._view, self._points, self._view.settings
        position, count = points.position, len(points)
        itself = worth[:count]
        over_mirrors = worth[count:][points.target] if self._over_mirrors else np.zeros(count, dtype=bool)
        tried = np.flatnonzero((self._range_m > 0.0) & (itself | over_mirrors))
        clear = np.zeros(count, dtype=bool)
        clear[tried] = view.sight(np.zeros((len(tried), 3)), position[tried])
        out, back = clear.astype(np.complex128), clear.astype(np.complex128)
        kinds = np.full(count, TARGET, dtype=np.uint8)
        behind = tried[~clear[tried]]
        if settings.refraction and len(behind):
            ways = {which: panes_between(view, position[behind], which) for which in set(settings.polarization)}
            out[behind], back[behind] = (ways[which] for which in settings.polarization)
            kinds[behind] |= REFRACTED
        in_sight = np.abs(out * back) > FAINTEST**2
        heard = itself & (points.rcs_m2 > 0.0)
        hidden = heard & ~in_sight
        counts = {
            "targets_faint": int((self._loudness < FAINTEST_ECHO).sum()),
            "point_targets_hidden": int(hidden.sum()),
            "target_echoes_silent": points.silent,
            "targets_in_near_field": points.near,
        }
        number = np.arange(count, dtype=np.int32)
        amplitude, index = self._amplitude * out * back, view.merged.object_of_target(points.target)
        direct = ScatteredPaths.of_points(position, points.velocity, amplitude, index, kinds, candidate=number)
        parts = [direct.take(heard & in_sight)]
        loud = self._loudness[points.target] * float(db_to_power(-ROUND_CORNERS_DB)) >= FAINTEST_ECHO
        hidden &= loud
        if settings.diffraction and hidden.any():
            round_corners, more = echoes_round_corners(view, points.take(hidden))
            parts.append(replace(round_corners, candidate=number[hidden][round_corners.candidate]))
            counts |= more
        if over_mirrors.any():
            straight = DirectWays(points, self._circumstances, out * in_sight, back * in_sight, kinds)
            echoes, more = echoes_over_mirrors(view, straight, over_mirrors)
            of_target = (count + points.target[echoes.candidate]).astype(np.int32)
            parts.append(replace(echoes, candidate=of_target))
            counts |= more
        return ScatteredPaths.joined(parts), SpecularPaths.none(), counts
