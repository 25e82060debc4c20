"""Echoes of targets with a radar cross section: in sight, behind panes, over mirrors, round corners."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.echo_points import Seen, all_echo_points
from datafactory.paths.edges import edges_of
from datafactory.paths.merged_scene import MergedScene, slabs_of
from datafactory.paths.mirrored_targets import DirectWays, echoes_over_mirrors
from datafactory.paths.panes import panes_between
from datafactory.paths.ray_hits import clear_between
from datafactory.paths.round_corners import echoes_round_corners
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import REFRACTED, TARGET, ScatteredPaths
from datafactory.scenes.materials.table import MaterialMapping
from datafactory.scenes.poses import Pose
from shared.physics.units import SPEED_OF_LIGHT, db_to_power

FAINTEST = 1e-4
"""One-way amplitude behind surfaces below which a target counts as hidden: -160 dB both ways, as behind any wall."""

EDGES_WITHIN_M = 200.0
"""Farther edges are left out [m]: at -20 dBsm they are 25 dB below a car radar's noise."""

FAINTEST_ECHO = 1e-2 / EDGES_WITHIN_M**4
"""Cross section over the fourth power of the distance [1/m^2] below which a target in plain sight is left out: as faint
as such an edge. A pedestrian is so faint from 585 m on."""
ROUND_CORNERS_DB = 12.0
"""What a way round an edge loses at least, out and back: half of the field is there at the shadow's boundary."""


def target_echoes(
    geometry: Any,
    merged_scene: MergedScene,
    materials: MaterialMapping,
    pose: Pose,
    frequency_hz: float,
    settings: TraceSettings,
    seed: int = 0,
) -> tuple[ScatteredPaths, dict[str, int]]:
    """Echoes of the point targets, and the numbers of those left out.

    Radar equation for isotropic antennas of unit power: lambda sqrt(sigma) / ((4 pi)^(3/2) R^2), times the panes'
    transmission both ways. With second bounces and mirrors, those over mirrors too
    (:mod:`datafactory.paths.mirrored_targets`).

    :param geometry: Mitsuba's scene in the radar frame
    :param seed: of where in their cycle moving parts are at time 0
    """
    wavelength = SPEED_OF_LIGHT / frequency_hz
    crossed = settings.polarization[0] != settings.polarization[1]
    circumstances = Seen(wavelength, pose.time_s, crossed, seed)
    loudness = _loudness(merged_scene, pose)
    points = all_echo_points(merged_scene.targets, pose.position, circumstances)
    points = points.take((loudness >= FAINTEST_ECHO)[points.target])
    heard = points.rcs_m2 > 0.0
    rotation = pose.rotation()
    position = (points.position - np.asarray(pose.position)) @ rotation
    velocity = (points.velocity - np.asarray(pose.velocity)) @ rotation
    index = (len(merged_scene.objects) - len(merged_scene.targets) + points.target).astype(np.int32)
    range_m = np.linalg.norm(position, axis=1)
    apart = range_m > 0.0
    clear = apart & clear_between(geometry, np.zeros((len(position), 3)), position)
    out, back = clear.astype(np.complex128), clear.astype(np.complex128)
    kinds = np.full(len(position), TARGET, dtype=np.uint8)
    if settings.refraction and len(position):
        behind = np.flatnonzero(apart & ~clear)
        ways = {
            which: panes_between(geometry, merged_scene, materials, frequency_hz, position[behind], which).factor
            for which in dict.fromkeys(settings.polarization)
        }
        out[behind], back[behind] = (ways[which] for which in settings.polarization)
        kinds[behind] |= REFRACTED
    factor = np.where(np.abs(out * back) > FAINTEST**2, out * back, 0.0)
    amplitude = wavelength * np.sqrt(points.rcs_m2) / (4.0 * np.pi) ** 1.5 / np.where(apart, range_m, 1.0) ** 2
    direct = ScatteredPaths.of_points(position, velocity, amplitude * factor, index)
    direct = ScatteredPaths(**{**vars(direct), "kinds": kinds})
    seen, hidden = heard & (factor != 0.0), heard & (factor == 0.0)
    counts = {
        "targets_faint": int((loudness < FAINTEST_ECHO).sum()),
        "point_targets_hidden": int(hidden.sum()),
        "target_echoes_silent": points.silent,
        "targets_in_near_field": points.near,
    }
    parts = [direct.take(seen)]
    loud = loudness[points.target] * float(db_to_power(-ROUND_CORNERS_DB)) >= FAINTEST_ECHO
    hidden &= loud
    if settings.diffraction and hidden.any():
        round_corners, more = echoes_round_corners(
            edges_of(merged_scene).seen_from(pose).within(EDGES_WITHIN_M), slabs_of(merged_scene, materials),
            frequency_hz, lambda start, end: clear_between(geometry, start, end),
            position[hidden], velocity[hidden], points.rcs_m2[hidden], index[hidden], settings.polarization,
        )  # fmt: skip
        parts.append(round_corners)
        counts |= more
    if settings.specular and settings.depth > 1 and merged_scene.meshes and len(position):
        in_sight = factor != 0.0
        straight = DirectWays(points, circumstances, out * in_sight, back * in_sight, kinds)
        over_mirrors, more = echoes_over_mirrors(
            geometry, merged_scene, materials, pose, frequency_hz, settings, straight
        )
        parts.append(over_mirrors)
        counts |= more
    return ScatteredPaths.concatenate(parts), counts


def _loudness(merged_scene: MergedScene, pose: Pose) -> NDArray[np.float64]:
    """[T] nominal cross section of every target over the fourth power of its distance [1/m^2]."""
    targets = merged_scene.targets
    away = np.array([target.position for target in targets]).reshape(-1, 3) - np.asarray(pose.position)
    fourth = np.maximum(np.einsum("ti,ti->t", away, away) ** 2, np.finfo(float).tiny)
    nominal: NDArray[np.float64] = db_to_power([target.rcs_dbsm for target in targets]) / fourth
    return nominal
