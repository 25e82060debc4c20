"""The only module that calls Sionna's path solver: it takes a merged scene and a pose and returns float64 arrays.

The trace is monostatic and isotropic, at mid-sweep, in the radar's own frame. Patterns, powers, array and waveform are
applied later. This module adapts Sionna RT 2.2 as follows, each with a test in
``tests/datafactory/paths/test_trace.py``:

* First-hit directions are replaced by :class:`datafactory.paths.rays.RayFan` (the solver's lattice covers the sphere).
* A wave keeps its direction through a pane. The crossings are removed from the vertices, and are not counted as
  bounces.
* Amplitudes are conjugated: ``Paths.a`` belongs to exp(-j 2 pi f tau), the IF signal to exp(+j 2 pi f tau).
* The line of sight from TX to RX is left out.
* The solver runs in its deterministic mode. That fixes the set of paths. Their order still depends on the threads'
  timing (observed on a busy machine). They are sorted here, because sums in float32 depend on the order.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from datafactory.defaults import DEFAULT_DEPTH, DEFAULT_RAYS
from datafactory.paths.backend import select_variant
from datafactory.paths.columns import Columns
from datafactory.paths.geometry import Geometry, aligned_rows, name_of
from datafactory.paths.merged_scene import MergedScene
from datafactory.paths.rays import RayFan
from datafactory.paths.scattering import LOBE_EXPONENT, MIRROR_SHARE
from datafactory.paths.slabs import Slabs
from datafactory.paths.table import DIFFUSE, REFRACTED, SPECULAR
from datafactory.scenes.materials.table import Material
from shared.physics.vectors import Complex, Index, Mask, Real
from shared.radar.front_end import Polarization

PATTERNS: dict[str, dict[str, Any]] = {
    "lambertian": {"scattering_pattern": "lambertian"},
    "backscattering": {
        "scattering_pattern": "backscattering",
        "alpha_r": LOBE_EXPONENT,
        "alpha_i": LOBE_EXPONENT,
        "lambda_": MIRROR_SHARE,
    },
}
"""Diffuse patterns of the material table, as :mod:`datafactory.paths.scattering` has them."""
LEAST_SOLVER_RAYS = 12_500
"""The solver follows no fewer, where there are as many: fewer miss chains of mirrors between small faces."""
SAME_M = 0.02
"""Chains whose vertices differ by less, all of them together, are one [m]: the solver's are in float32."""
CROSSINGS = 2
"""Largest number of panes on a whole path: one pane, on the way out and on the way back."""


@dataclass(frozen=True)
class TraceSettings:
    """How a frame is traced.

    :param rays: directions sent from the TX
    :param depth: largest number of bounces, 1 to 3; from 2 on targets are seen over mirrors, one on either way, and
        chains of mirrors alone have up to 3: a handful of paths, and nearly all that a third bounce adds to a cell
    :param paths_a_cell: most paths that are scattered once in a resolution cell (:mod:`datafactory.paths.cells`), of
        the default's rays or fewer; see :attr:`most_in_a_cell`. 0 keeps all
    :param solver_share: of so many rays the solver follows one to chains of mirrors, which are few
    :param twice_share: of so many rays one is followed to what is scattered twice: weak echoes, spread over many cells
    :param specular, diffuse: kinds of bounce to follow
    :param refraction: follow waves through panes, up to ``CROSSINGS`` of them
    :param diffraction: add echoes of edges, and of point targets hidden behind one
    :param corners: add the echoes of right-angled corners, in place of the mirror paths along their edges
    :param point_targets: add the echoes of targets given by their cross section
    :param finite_mirrors: reduce a reflection by the facet's finite size, instead of an infinite plane's
    :param surface_phase: give every cell of a rough surface its own phase
    :param polarization: of TX and RX, "V" or "H" each
    """

    rays: int = DEFAULT_RAYS
    depth: int = DEFAULT_DEPTH
    paths_a_cell: int = 6
    solver_share: int = 4
    twice_share: int = 32
    specular: bool = True
    diffuse: bool = True
    refraction: bool = False
    diffraction: bool = False
    corners: bool = False
    point_targets: bool = True
    finite_mirrors: bool = True
    surface_phase: bool = True
    polarization: tuple[Polarization, Polarization] = ("V", "V")

    @property
    def steps(self) -> int:
        """Largest number of interactions on a path of the solver."""
        return self.depth + (CROSSINGS if self.refraction else 0)

    @property
    def most_in_a_cell(self) -> int:
        """``paths_a_cell``, and of more rays than the default's as many times more.

        Where the paths of a cell stand in it is drawn, and the truth's cells are not those that are thinned: with K
        paths a cell's power scatters by up to 1 / sqrt(K) of it. With the same K more rays would buy nothing.
        """
        return max(self.paths_a_cell, round(self.paths_a_cell * self.rays / DEFAULT_RAYS))

    def solver_rays(self, rays: int) -> int:
        """How many of a fan's rays the solver follows."""
        return max(rays // self.solver_share, min(rays, LEAST_SOLVER_RAYS))

    def capacity(self, rays: int) -> int:
        """Paths that the solver may keep: one for every ray and step, so that none is ever left out."""
        return rays * self.steps


@dataclass(frozen=True)
class Bundle(Columns):
    """Traced paths: n of them, vertices from TX to RX, crossings of panes taken out."""

    vertices: Real  # [n, depth, 3]
    interactions: Index  # [n, depth] SPECULAR or DIFFUSE, 0 beyond the path's end
    triangles: Index  # [n, depth] index into the merged scene's triangles, -1 beyond the end
    crossings: Index  # [n] panes passed
    amplitude: Complex  # [n]

    @staticmethod
    def none(depth: int) -> Bundle:
        """No paths, of at most ``depth`` bounces."""
        whole = np.zeros((0, depth), dtype=np.int64)
        return Bundle(np.zeros((0, depth, 3)), whole, whole, whole[:, 0], np.zeros(0, dtype=np.complex128))

    def of_bounces(self, count: int) -> Bundle:
        """Its paths of so many bounces."""
        if count > self.interactions.shape[1]:
            return Bundle.none(count)
        return self.take((self.interactions > 0).sum(axis=1) == count).cut(count)

    def cut(self, depth: int) -> Bundle:
        """The same paths without the columns beyond ``depth``."""
        return replace(
            self,
            vertices=self.vertices[:, :depth],
            interactions=self.interactions[:, :depth],
            triangles=self.triangles[:, :depth],
        )

    def with_reverses(self) -> Bundle:
        """The same paths, and the way back of each whose way back is not among them.

        TX and RX stand at one place: by reciprocity a chain runs both ways with one amplitude. The solver follows rays
        from its first mirror on, meets a small one by chance, and often finds one way alone (docs/notes/speckle.md).
        """
        count = len(self.vertices)
        if not count:
            return self
        back = replace(
            self,
            vertices=self.vertices[:, ::-1],
            interactions=self.interactions[:, ::-1],
            triangles=self.triangles[:, ::-1],
        )
        found = cKDTree(self.vertices.reshape(count, -1))
        away_m, _ = found.query(back.vertices.reshape(count, -1), distance_upper_bound=SAME_M)
        return Bundle.joined([self, back.take(~np.isfinite(away_m))])

    def in_fixed_order(self) -> Bundle:
        """The same paths, sorted by their vertices: the solver's order depends on which of its threads ends first."""
        count, depth = self.interactions.shape
        return self.take(np.lexsort(self.vertices.reshape(count, 3 * depth).T[::-1]))


def radio_scene(geometry: Geometry, slabs: Slabs, settings: TraceSettings) -> Any:
    """Sionna's own Scene of a geometry, which is made once and shows what the geometry shows.

    :param slabs: of every mesh, always the same for one geometry
    """
    from sionna import rt

    if geometry.radio is None:
        geometry.stand_on(_radio_scene(geometry, slabs.materials))
    scene = geometry.radio
    scene.frequency = slabs.frequency_hz
    scene.tx_array, scene.rx_array = (
        rt.PlanarArray(num_rows=1, num_cols=1, vertical_spacing=0.5, horizontal_spacing=0.5, pattern="iso",
                       polarization=polarization)
        for polarization in settings.polarization
    )  # fmt: skip
    return scene


def _radio_scene(geometry: Geometry, slabs: Sequence[Material]) -> Any:
    from sionna import rt

    scene = rt.load_scene()
    radio = {
        slab.name: rt.RadioMaterial(
            name=f"m-{slab.name}",
            relative_permittivity=slab.relative_permittivity,
            conductivity=slab.conductivity_s_per_m,
            thickness=slab.thickness_m,
            scattering_coefficient=slab.scattering_coefficient,
            **PATTERNS[slab.pattern],
        )
        for slab in slabs
    }
    scene.edit(
        add=[
            rt.SceneObject(mi_mesh=mesh, name=mesh.id(), radio_material=radio[slab.name])
            for mesh, slab in zip(geometry.meshes, slabs, strict=True)
        ]
    )
    scene.add(rt.Transmitter("radar-tx", position=[0.0, 0.0, 0.0]))
    scene.add(rt.Receiver("radar-rx", position=[0.0, 0.0, 0.0]))
    return scene


def solver_paths(scene: Any, settings: TraceSettings, fan: RayFan, seed: int) -> Any:
    """Sionna's own Paths of a frame.

    :param seed: of the solver's choices between kinds of bounce; 0 to 2**32 - 1
    """
    from sionna import rt

    with _rays_of_fan(fan):
        return rt.PathSolver(deterministic=True)(
            scene,
            max_depth=settings.steps,
            samples_per_src=fan.count,
            max_num_paths_per_src=settings.capacity(fan.count),
            synthetic_array=True,
            los=False,
            specular_reflection=settings.specular,
            diffuse_reflection=settings.diffuse,
            refraction=settings.refraction,
            seed=seed,
        )


def solve(
    scene: Any, merged_scene: MergedScene, settings: TraceSettings, fan: RayFan, seed: int
) -> tuple[Bundle, dict[str, int]]:
    """Trace one frame.

    :param scene: of :func:`radio_scene`
    :param fan: all rays of the frame, of which ``settings`` say how many are followed
    :param seed: of the solver's choices between kinds of bounce; 0 to 2**32 - 1
    :return: the paths; counts: ``invalid``, padded entries, and ``truncated``, 1 where the capacity was reached
    """
    fan = replace(fan, count=settings.solver_rays(fan.count))
    paths = solver_paths(scene, settings, fan, seed)
    first = merged_scene.first[:-1].tolist()
    shapes = {scene.objects[name_of(index)].object_id: begin for index, begin in enumerate(first)}
    valid = paths.valid.numpy().reshape(-1)
    bundle = _without_crossings(_bundle_of(paths, valid, shapes), settings.depth)
    truncated = int(valid.sum() >= settings.capacity(fan.count))
    return bundle, {"invalid": int((~valid).sum()), "truncated": truncated}


@contextmanager
def _rays_of_fan(fan: RayFan) -> Iterator[None]:
    """Replace the full-sphere lattice of the solver's candidate generator by the fan."""
    import mitsuba as mi
    from sionna.rt.path_solvers import sb_candidate_generator as generator
    from sionna.rt.path_solvers import sb_deterministic as deterministic

    square = aligned_rows(fan.unit_square().T)

    def lattice(count: int):
        return mi.Point2f(*square)

    replaced = [(module, module.fibonacci_lattice) for module in (generator, deterministic)]
    try:
        for module, _ in replaced:
            module.fibonacci_lattice = lattice
        yield
    finally:
        for module, original in replaced:
            module.fibonacci_lattice = original


def _bundle_of(paths: Any, valid: Mask, shapes: dict[int, int]) -> Bundle:
    """The valid paths as float64.

    :param shapes: of each of Sionna's objects the first triangle
    """

    def columns(values: Any) -> NDArray:
        return np.moveaxis(values.numpy()[:, 0, 0], 0, 1)[valid]

    vertices = columns(paths.vertices).astype(np.float64)
    interactions = columns(paths.interactions).astype(np.int64)
    shape, primitive = columns(paths.objects).astype(np.int64), columns(paths.primitives).astype(np.int64)
    real, imaginary = (part.numpy().reshape(-1)[valid].astype(np.float64) for part in paths.a)
    triangles = np.full(shape.shape, -1, dtype=np.int64)
    for object_id, first in shapes.items():
        here = (shape == object_id) & (interactions > 0)
        triangles[here] = first + primitive[here]
    return Bundle(vertices, interactions, triangles, np.zeros(len(real), dtype=np.int64), real - 1j * imaginary)


def _without_crossings(bundle: Bundle, depth: int) -> Bundle:
    """The paths without crossings of panes, which are counted; paths of more than ``depth`` bounces are dropped."""
    crossed = bundle.interactions == REFRACTED
    bounces = np.isin(bundle.interactions, (SPECULAR, DIFFUSE))
    rows = np.arange(len(crossed))[:, None]
    order = np.argsort(~bounces, axis=1, kind="stable")
    past = ~bounces[rows, order]
    kept = replace(
        bundle,
        vertices=np.where(past[:, :, None], 0.0, bundle.vertices[rows, order]),
        interactions=np.where(past, 0, bundle.interactions[rows, order]),
        triangles=np.where(past, -1, bundle.triangles[rows, order]),
        crossings=crossed.sum(axis=1),
    )
    count = bounces.sum(axis=1)
    return kept.take((count > 0) & (count <= depth)).cut(depth)


def load_solver() -> None:
    """Import Sionna now: a second of work, for a process that has nothing else to do yet."""
    select_variant()
    from sionna import rt  # noqa: F401
