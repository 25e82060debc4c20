"""Panes: transmission and reflection of a slab, and the slabs on the straight line between radar and point.

Slab of one layer in air, ITU-R P.2040-4 eq. (43), (44), multiple reflections inside included: with eta the complex
relative permittivity, theta the angle of incidence, d the thickness, k = 2 pi / lambda,

    q = k d sqrt(eta - sin^2 theta),   T = (1 - r^2) exp(-jq) / (1 - r^2 exp(-2jq)),
    R = r (1 - exp(-2jq)) / (1 - r^2 exp(-2jq)),

and r the Fresnel coefficients of its surface, eq. (37). T is the field behind the slab over the field in front of it,
at points opposite each other: a pane of air has exp(-j k d cos theta). Valid for slabs wider than the beam's Fresnel
zone and for a pulse longer than the echoes within (d |sqrt(eta)| well below the range resolution of 0.15 m; thicker
walls absorb them).

Time convention exp(+j omega t) for coefficients; amplitudes for the path table are their conjugates.

Lines of sight are rays of Mitsuba in float32. Every mesh surface is one slab, as in Sionna's own model: a pane modelled
as a box is two panes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from datafactory.paths.merged_scene import MergedScene, slabs_of
from datafactory.paths.ray_hits import first_hits, ray_margin_m
from datafactory.paths.unfold import unit
from datafactory.scenes.materials.reflectivity import complex_permittivity
from datafactory.scenes.materials.table import Material, MaterialMapping
from shared.physics.errors import InputError
from shared.physics.units import SPEED_OF_LIGHT, amplitude_to_db
from shared.physics.vectors import dots, lengths

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

Polarization = Literal["V", "H"]

MAXIMUM_CROSSINGS = 8
FADED = 1e-6
"""One-way field behind surfaces that is not followed any further: a hundredth of what counts anywhere."""
OPAQUE_DB = -60.0
"""Transmission out and back below which what surfaces scatter behind a slab is not asked for: 30 dB under the default
error budget. A wall of 0.2 m of marble has -71 dB."""


def slab_transmission(
    relative_permittivity: float,
    conductivity_s_per_m: float,
    thickness_m: float,
    frequency_hz: float,
    incidence_cosine: ArrayLike,
) -> tuple[Complex, Complex]:
    """T of a slab for the electric field across (TE) and in (TM) the plane of incidence.

    :param relative_permittivity: eps' > 0; :param conductivity_s_per_m: at least 0; :param thickness_m: at least 0
    :param incidence_cosine: [K] cosine of the angle from the normal, above 0 and at most 1
    :return: TE [K] and TM [K]; 0 where the slab absorbs everything
    :raises InputError: a value outside these bounds
    """
    through, te, tm = _slab_terms(
        relative_permittivity, conductivity_s_per_m, thickness_m, frequency_hz, incidence_cosine
    )
    return (1.0 - te**2) * through / (1.0 - (te * through) ** 2), (1.0 - tm**2) * through / (1.0 - (tm * through) ** 2)


def lets_through(slab: Material, frequency_hz: float) -> bool:
    """Whether surfaces behind a slab are heard. Absorption is least at normal incidence."""
    te, _ = slab_transmission(
        slab.relative_permittivity, slab.conductivity_s_per_m, slab.thickness_m, frequency_hz, np.ones(1)
    )
    return bool(amplitude_to_db(te[0] ** 2) > OPAQUE_DB)


def slab_reflection(
    relative_permittivity: float,
    conductivity_s_per_m: float,
    thickness_m: float,
    frequency_hz: float,
    incidence_cosine: ArrayLike,
) -> tuple[Complex, Complex]:
    """R of a slab, TE [K] and TM [K], at its front face; arguments as in :func:`slab_transmission`.

    TE is the sign of the electric field, TM that of the magnetic one: a perfect conductor has -1 and +1.
    """
    through, te, tm = _slab_terms(
        relative_permittivity, conductivity_s_per_m, thickness_m, frequency_hz, incidence_cosine
    )
    return te * (1.0 - through**2) / (1.0 - (te * through) ** 2), tm * (1.0 - through**2) / (1.0 - (tm * through) ** 2)


def _slab_terms(
    permittivity: float, conductivity: float, thickness_m: float, frequency_hz: float, incidence_cosine: ArrayLike
) -> tuple[Complex, Complex, Complex]:
    """exp(-jq) and the surface's Fresnel coefficients TE, TM."""
    cosine = np.asarray(incidence_cosine, dtype=np.float64)
    for name, bad, value, expected in (
        ("relative_permittivity", not permittivity > 0.0, permittivity, "above 0"),
        ("conductivity", not conductivity >= 0.0, conductivity, "at least 0 S/m"),
        ("thickness", not thickness_m >= 0.0, thickness_m, "at least 0 m"),
        ("frequency", not frequency_hz > 0.0, frequency_hz, "above 0 Hz"),
        ("incidence_cosine", not np.all((cosine > 0.0) & (cosine <= 1.0)), incidence_cosine, "above 0 and at most 1"),
    ):
        if bad:
            raise InputError(f"slab {name}", f"{value!r}", expected)
    eta = complex_permittivity(permittivity, conductivity, frequency_hz)
    # eta - 1 + cos^2 is eta - sin^2 without the cancellation that a slab of air has at grazing incidence.
    root = np.sqrt(eta - 1.0 + cosine**2 + 0j)
    root = np.where(root.imag > 0.0, -root, root)  # exp(-jq) decays, for eta < sin^2 too
    te = (cosine - root) / (cosine + root)
    tm = (eta * cosine - root) / (eta * cosine + root)
    wavenumber = 2.0 * np.pi * frequency_hz / SPEED_OF_LIGHT
    return np.exp(-1j * wavenumber * thickness_m * root), te, tm


@dataclass(frozen=True)
class Crossings:
    """The surfaces between the radar and K points.

    :param factor: [K] one-way amplitude over that of free space, co-polarised, in the path table's convention
    :param count: [K] surfaces crossed
    :param given_up: points behind more surfaces than were followed; their factor is 0
    """

    factor: Complex
    count: NDArray[np.int64]
    given_up: int


def panes_between(
    mi_scene: Any,
    merged_scene: MergedScene,
    materials: MaterialMapping,
    frequency_hz: float,
    points: Real,
    polarization: Polarization = "V",
    maximum_crossings: int = MAXIMUM_CROSSINGS,
) -> Crossings:
    """One-way transmission along the straight lines from the radar to points.

    The field starts as the unit vector theta^ (V) or phi^ (H) of the radar's spherical coordinates. At every surface it
    is split into the part across the plane of incidence (TE) and the part in it (TM), each is multiplied with its T,
    and what arrives is projected on the first vector again. With one pane that is cos^2(a) T_TE + sin^2(a) T_TM, a the
    angle between the vector and the TE axis. A pane takes the place of air, so that T exp(+j k d cos theta) counts: the
    path's length is that of free space. Bending of the ray (its shift of d tan theta at most) is left out. Out and back
    is the square, by reciprocity, for a target that keeps the polarisation.

    :param mi_scene: Mitsuba scene in the radar frame, radar at the origin; its shape ``part-N`` is
        ``merged_scene.meshes[N]``
    :param materials: those that ``merged_scene`` was made with
    :param points: [K, 3] in the radar frame [m]; surfaces nearer than the ray caster's own error count as behind it
    """
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    slabs = _slab_of_shape(mi_scene, merged_scene, materials)
    distance = np.linalg.norm(points, axis=1)
    direction = unit(points)
    axis = polarization_axis(direction, polarization)
    field = axis.astype(np.complex128)
    count = np.zeros(len(points), dtype=np.int64)
    surfaces = _SurfaceWalker(mi_scene, direction, distance - ray_margin_m(distance))
    for _ in range(maximum_crossings):
        hit, mesh_id, normal = surfaces.next_surface()
        if not hit.any():
            break
        count[hit] += 1
        for shape in np.unique(mesh_id[hit]):
            here = hit & (mesh_id == shape)
            field[here] = field_behind_slab(slabs[int(shape)], frequency_hz, direction[here], normal[here], field[here])
        surfaces.leave(np.linalg.norm(field, axis=1) < FADED)
    beyond = surfaces.next_surface()[0]
    factor = np.where(beyond, 0.0, np.einsum("ki,ki->k", field, axis).conj())
    return Crossings(factor=factor, count=count, given_up=int(beyond.sum()))


def polarization_axis(direction: Real, polarization: Polarization) -> Real:
    """[K, 3] theta^ (V, pointing down at the horizon) or phi^ (H, pointing left) of unit directions [K, 3].

    Straight up and down it is undefined; the limit from +x is returned.
    """
    x, y, z = direction.T
    across = np.hypot(x, y)
    level = np.where(across > 0.0, across, 1.0)
    cosine, sine = np.where(across > 0.0, x / level, 1.0), y / level
    if polarization == "H":
        return np.stack([-sine, cosine, np.zeros_like(z)], axis=1)
    return np.stack([z * cosine, z * sine, -across], axis=1)


def mesh_of_shape(mi_scene: Any) -> dict[int, int]:
    """Index into ``MergedScene.meshes`` by the number with which a ray names the shape it met."""
    import drjit as dr
    import mitsuba as mi

    return {
        int(mi.UInt32(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))).numpy()[0]): int(
            shape.id().removeprefix("part-")
        )
        for shape in mi_scene.shapes()
    }


def _slab_of_shape(mi_scene: Any, merged_scene: MergedScene, materials: MaterialMapping) -> dict[int, Material]:
    """Material by the number with which a ray names the shape it met."""
    slabs = slabs_of(merged_scene, materials)
    return {number: slabs[mesh] for number, mesh in mesh_of_shape(mi_scene).items()}


def field_behind_slab(
    material: Material, frequency_hz: float, direction: Real, normal: Real, field: Complex
) -> Complex:
    """The field [K, 3] behind one slab.

    :param direction: [K, 3] unit direction of the wave; either sense of it gives the same
    :param normal: [K, 3] unit normal of the slab, on either side
    :param field: [K, 3] in front, across ``direction``
    """
    cosine = np.clip(np.abs(dots(direction, normal)), 1e-6, 1.0)
    te, tm = slab_transmission(
        material.relative_permittivity,
        material.conductivity_s_per_m,
        material.thickness_m,
        frequency_hz,
        cosine,
    )
    replaced_air = np.exp(2j * np.pi * frequency_hz / SPEED_OF_LIGHT * material.thickness_m * cosine)
    across = np.cross(direction, normal)
    # At normal incidence there is no plane of incidence, and T_TE = T_TM: any axis will do.
    across = unit(np.where(lengths(across)[:, None] > 1e-6, across, polarization_axis(direction, "V")))
    along = np.cross(across, direction)
    kept_te = (te * replaced_air * np.einsum("ki,ki->k", field, across))[:, None] * across
    return kept_te + (tm * replaced_air * np.einsum("ki,ki->k", field, along))[:, None] * along


class _SurfaceWalker:
    """Rays from the origin, from one surface to the next.

    A ray restarts a margin behind each surface. A second hit on the same triangle is an error of rounding, and skipped.
    """

    def __init__(self, mi_scene: Any, direction: Real, reach: Real) -> None:
        self.scene, self.direction, self.reach = mi_scene, direction, reach
        self.travelled = np.zeros(len(direction))
        self.last = np.full((len(direction), 2), -1, dtype=np.int64)

    def next_surface(self) -> tuple[NDArray[np.bool_], NDArray[np.int64], Real]:
        """Whether there is one [K], its shape's id [K] and its unit normal [K, 3]."""
        found = np.zeros(len(self.direction), dtype=bool)
        shape = np.zeros(len(self.direction), dtype=np.int64)
        normal = np.zeros((len(self.direction), 3))
        pending = np.flatnonzero(self.travelled < self.reach)
        while len(pending):
            distance, triangle, n = self._cast(pending)
            here = np.isfinite(distance)
            again = here & (triangle == self.last[pending]).all(axis=1)
            new = pending[here & ~again]
            found[new], shape[new], normal[new] = True, triangle[here & ~again, 0], n[here & ~again]
            self.last[pending[here]] = triangle[here]
            self.travelled[pending[here]] += distance[here] + ray_margin_m(
                self.travelled[pending[here]] + distance[here]
            )
            self.travelled[pending[~here]] = np.inf
            pending = pending[again & (self.travelled[pending] < self.reach[pending])]
        return found, shape, normal

    def leave(self, rays: NDArray[np.bool_]) -> None:
        """Follow these [K] no further."""
        self.travelled[rays] = np.inf

    def _cast(self, index: NDArray[np.int64]) -> tuple[Real, NDArray[np.int64], Real]:
        start = self.travelled[index, None] * self.direction[index]
        hits = first_hits(self.scene, start, self.direction[index], (self.reach - self.travelled)[index])
        triangle = np.stack([hits.shape, hits.primitive], axis=1)
        return np.where(hits.valid, hits.distance, np.inf), triangle, hits.normal
