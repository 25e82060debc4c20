"""Small Sionna scenes for tests that hold our physics against Sionna's own, its geometry, and one slab's numbers."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from datafactory.paths.geometry import placed
from datafactory.paths.merged_scene import MergedScene, merge_scene
from datafactory.paths.rays import RayFan
from datafactory.paths.slabs import Slabs
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import PathTable
from datafactory.paths.trace import trace
from datafactory.paths.view import View
from datafactory.scenes.chain import Chain, Operation, Samples
from datafactory.scenes.chain import placed as put
from datafactory.scenes.materials.table import Material, MaterialMapping
from datafactory.scenes.motion import Moving
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import PointTarget, Scene, SceneObject
from shared.physics.units import SPEED_OF_LIGHT

FREQUENCY_HZ = 77.5e9
WAVELENGTH_M = 299_792_458.0 / FREQUENCY_HZ
AT_ORIGIN = Pose((0.0, 0.0, 0.0))


def material(
    name: str, permittivity: float, conductivity: float, thickness_m: float, scattering=0.0, pattern="lambertian"
) -> Material:
    """Smooth, unless it scatters."""
    return Material(name, permittivity, conductivity, thickness_m, scattering, pattern, "test", (77.0, 78.0), ())


def mapping(*materials: Material) -> MaterialMapping:
    """Materials by their own names."""
    return MaterialMapping(entries={item.name: (item, "test") for item in materials}, unknown=())


MATERIALS = mapping(
    material("metal", 1.0, 1e7, 0.1), material("glass", 6.31, 1.211, 0.006), material("air", 1.0, 0.0, 0.05)
)


def mesh(name: str, vertices: Any, triangles: Any, of: str, velocity=(0.0, 0.0, 0.0)) -> SceneObject:
    return SceneObject(name, np.array(vertices, dtype=float), np.array(triangles, dtype=np.int32), of, velocity)


def plate(name: str, centre: Any, across: Any, up: Any, of: str, velocity=(0.0, 0.0, 0.0)) -> SceneObject:
    """A flat rectangle, centre +- across +- up [m]."""
    c, a, b = (np.array(v, dtype=float) for v in (centre, across, up))
    return mesh(name, [c - a - b, c + a - b, c + a + b, c - a + b], [[0, 1, 2], [0, 2, 3]], of, velocity)


def slabs(of: MergedScene) -> Slabs:
    """Of the meshes of a scene."""
    return Slabs(of.slabs, FREQUENCY_HZ)


def view_of(of: MergedScene, pose: Pose = AT_ORIGIN, settings: TraceSettings | None = None) -> View:
    """A scene from one pose at its time."""
    geometry = placed(of, pose).mi_scene
    return View(geometry, of, slabs(of), pose, settings or TraceSettings())


def everything(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.bool_]:
    """A sight that nothing stands in the way of."""
    return np.ones(len(end), dtype=bool)


def view_with(of: Slabs, sight: Any, settings: TraceSettings | None = None, **found: Any) -> View:
    """A view without a geometry: what is in sight of it is said, and which edges or corners it has."""
    view = View(None, scene_of(), of, AT_ORIGIN, settings or TraceSettings())
    vars(view).update(found, sight=sight)
    return view


def every_one(source: Any) -> Any:
    """What is seen of all candidates of a source of echoes."""
    return source.seen(np.ones(len(source.candidates), dtype=bool))


def scene_of(
    *objects: SceneObject, targets: Sequence[PointTarget] = (), materials: MaterialMapping = MATERIALS
) -> MergedScene:
    return merge_scene(Scene("test", objects, tuple(targets)), materials)


def traced(
    of: MergedScene, pose: Pose = AT_ORIGIN, fan: RayFan | None = None, seed: int = 1, **settings: Any
) -> PathTable:
    """One trace of the settings' rays; in a plain fan where none is given."""
    chosen = TraceSettings(**settings)
    return trace(of, pose, FREQUENCY_HZ, chosen, fan or RayFan(chosen.rays), seed)


def sionna_scene(of: MergedScene, pose: Pose | None = None) -> Any:
    """The scene in the radar frame as Sionna has it; its ``mi_scene`` is Mitsuba's. Call ``select_variant`` first."""
    import mitsuba as mi
    from sionna import rt

    scene = rt.load_scene()
    objects = []
    for index, part in enumerate(of.meshes):
        shape = mi.Mesh(f"part-{index}", vertex_count=len(part.vertices), face_count=len(part.triangles))
        parameters = mi.traverse(shape)
        parameters["vertex_positions"] = part.seen_from(pose or Pose((0.0, 0.0, 0.0))).ravel()
        parameters["faces"] = part.triangles.astype(np.uint32).ravel()
        parameters.update()
        slab = MATERIALS[part.material]
        radio = rt.RadioMaterial(
            f"m-{index}",
            relative_permittivity=slab.relative_permittivity,
            conductivity=slab.conductivity_s_per_m,
            thickness=slab.thickness_m,
        )
        objects.append(rt.SceneObject(mi_mesh=shape, name=f"part-{index}", radio_material=radio))
    scene.edit(add=objects)
    scene.frequency = FREQUENCY_HZ
    return scene


def channel(
    scene: Any, tx: tuple[float, float, float], rx: tuple[float, float, float], polarization: str = "V", **kinds: bool
) -> tuple[NDArray[np.complex128], NDArray[np.int64]]:
    """Sionna's channel coefficients [n] from ``tx`` to ``rx`` and the kinds of interaction on each path [depth, n]."""
    from sionna import rt

    antenna = rt.PlanarArray(
        num_rows=1, num_cols=1, vertical_spacing=0.5, horizontal_spacing=0.5, pattern="iso", polarization=polarization
    )
    scene.tx_array = scene.rx_array = antenna
    scene.add(rt.Transmitter("tx", position=list(tx)))
    scene.add(rt.Receiver("rx", position=list(rx)))
    chosen = {"los": False, "specular_reflection": False, "diffuse_reflection": False, "refraction": False, **kinds}
    paths = rt.PathSolver(deterministic=True)(scene, max_depth=2, samples_per_src=200_000, seed=1, **chosen)
    valid = paths.valid.numpy().reshape(-1)
    real, imaginary = (part.numpy().reshape(-1)[valid].astype(float) for part in paths.a)
    return real + 1j * imaginary, paths.interactions.numpy()[:, 0, 0][:, valid].astype(np.int64)


TURN_DEG_PER_S = 40.0


def turning(item: SceneObject, body: str = "body", yaw: float = TURN_DEG_PER_S, forward: float = 3.0) -> SceneObject:
    """The object, turning about the world's z through (8, 0, 0) and moving along x, for 2 s."""
    times = np.array([0.0, 2.0])
    chain = Chain(
        (
            Operation("translate", Samples(times, np.array([[8.0, 0, 0], [8.0 + 2.0 * forward, 0, 0]]))),
            Operation("rotate", Samples(times, np.array([[0.0], [2.0 * yaw]])), "Z"),
        )
    )
    points = item.vertices - np.array([8.0, 0.0, 0.0])
    vertices, local = put(points, chain.at(0.0)[0]), (points, np.arange(len(points)))
    return SceneObject(
        item.name, vertices, item.triangles, item.material, motion=Moving(body, chain), local=local
    ).as_it_moves()


Complex = NDArray[np.complex128]


def slab_reflection(
    permittivity: float, conductivity: float, thickness_m: float, frequency_hz: float, cosine: ArrayLike
) -> tuple[Complex, Complex]:
    """R, TE and TM, at the front face, for cosines of the angle of incidence."""
    return _at(_slab(permittivity, conductivity, thickness_m, frequency_hz).reflection, cosine)


def slab_transmission(
    permittivity: float, conductivity: float, thickness_m: float, frequency_hz: float, cosine: ArrayLike
) -> tuple[Complex, Complex]:
    """T, TE and TM, without the air that a slab takes the place of."""
    te, tm = _at(_slab(permittivity, conductivity, thickness_m, frequency_hz).transmission, cosine)
    air = np.exp(2j * np.pi * frequency_hz / SPEED_OF_LIGHT * thickness_m * np.asarray(cosine))
    return te / air, tm / air


def _at(coefficients: Callable[..., tuple[Complex, Complex]], cosine: ArrayLike) -> tuple[Complex, Complex]:
    """TE and TM of the only slab, in the shape of the cosines."""
    cosines = np.asarray(cosine, dtype=np.float64)
    te, tm = coefficients(np.zeros(cosines.size, dtype=np.int64), cosines.reshape(-1))
    return te.reshape(cosines.shape), tm.reshape(cosines.shape)


def _slab(permittivity: float, conductivity: float, thickness_m: float, frequency_hz: float) -> Slabs:
    numbers = permittivity, conductivity, thickness_m
    return Slabs([Material("slab", *numbers, 0.0, "lambertian", "", (77.0, 77.0), ())], frequency_hz)
