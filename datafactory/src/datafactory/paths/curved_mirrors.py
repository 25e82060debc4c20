"""Single mirrors on curved surfaces: where their echoes come from, how strong they are, when they arrive.

    A = conj(Gamma) sqrt(1 - S^2) lambda / (4 pi 2 R) G F

with Gamma and S as for a plane (:mod:`datafactory.paths.mirror_feet`), the divergence G and the share F of a surface
that ends (:mod:`datafactory.paths.curved_echoes`). The incidence at a foot is normal. Echoes have no cross-polarised
part.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from datafactory.paths.curved_echoes import EchoFields, curved_paths, curved_shares
from datafactory.paths.curved_feet import curved_feet
from datafactory.paths.curved_surfaces import curved_surfaces_of
from datafactory.paths.merged_scene import MergedScene, velocities_on
from datafactory.paths.mirror_feet import AHEAD_M, CLOSEST_M, plane_amplitude, way_and_back
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import ScatteredPaths, SpecularPaths
from datafactory.scenes.materials.table import MaterialMapping
from datafactory.scenes.poses import Pose
from shared.physics.units import SPEED_OF_LIGHT


def curved_mirrors(
    geometry: Any,
    merged_scene: MergedScene,
    materials: MaterialMapping,
    pose: Pose,
    frequency_hz: float,
    settings: TraceSettings,
) -> tuple[ScatteredPaths, SpecularPaths, dict[str, int]]:
    """All single echoes of curved surfaces in a frame, by the delay law that suits each, and counts.

    :param geometry: Mitsuba's scene in the radar frame
    :return: counts are ``curved_mirrors``, ``curved_mirrors_hidden``, ``triangles_round_their_focus`` of scenes that
        have a curved surface, and ``facets_too_coarse`` of those whose facets may stand for one
    """
    surfaces = curved_surfaces_of(merged_scene)
    counts = {"facets_too_coarse": surfaces.coarse} if surfaces.coarse else dict[str, int]()
    if not len(surfaces) or settings.polarization[0] != settings.polarization[1]:
        return ScatteredPaths.none(), SpecularPaths.none(), counts
    rotation, wavelength = pose.rotation(), SPEED_OF_LIGHT / frequency_hz
    mesh = merged_scene.mesh_of_triangle
    moved = np.array([item.shift for item in merged_scene.meshes])[mesh] - np.asarray(pose.position)
    every, focused = curved_feet(surfaces, moved[surfaces.triangle], rotation, -AHEAD_M)
    every = every.take(every.range_m() >= CLOSEST_M)
    passed, kinds = way_and_back(geometry, merged_scene, materials, frequency_hz, settings, every.seen_to)
    seen = np.flatnonzero(passed != 0.0)
    feet = every.take(seen)
    amplitude = plane_amplitude(merged_scene, materials, frequency_hz, mesh[feet.triangle], feet.range_m())
    amplitude *= curved_shares(
        surfaces, feet, moved[feet.triangle], rotation, wavelength, settings.finite_mirrors
    ) * passed[seen]  # fmt: skip
    owner = np.concatenate([item.object_of_triangle for item in merged_scene.meshes])[feet.triangle]
    of_mesh = (np.array([item.velocity for item in merged_scene.meshes]) - np.asarray(pose.velocity)) @ rotation
    relative = velocities_on(merged_scene, pose, of_mesh, feet.triangle, feet.foot)
    points, images = curved_paths(
        feet, relative, EchoFields(amplitude, owner.astype(np.int32), kinds[seen]), wavelength
    )
    counts |= {
        "curved_mirrors": len(feet),
        "curved_mirrors_hidden": len(every) - len(feet),
        "triangles_round_their_focus": focused,
    }
    return points, images, counts
