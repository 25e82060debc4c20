"""What several themes need: small radars, whole frames, one trace, a stage of USD."""

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from oracles import if_cube, relative_error
from sionna_scenes import AT_ORIGIN, mapping, material, plate, scene_of
from sionna_scenes import traced as trace_of
from usd_files import mesh, stage, translated

from datafactory.frame.measurement import Processing, image, measure
from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.scenes.poses import Pose
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import SceneObject
from datafactory.synthesis.cube import cube_of_paths
from shared.dataset import Frame
from shared.radar import FrontEnd, ImageGrid, Radar
from shared.radar.antenna import IsotropicPattern
from shared.radar.arrays import AntennaArray
from shared.radar.waveform import Waveform

MIRROR = "mirror"
"""Name of the perfect conductor among :data:`MATERIALS`; ``rough`` scatters diffusely, ``vacuum`` does nothing."""
UTM = (500_000.0, 5_480_000.0, 320.0)
"""Easting, northing and height of a place in the middle of a UTM zone [m]."""
MATERIALS = mapping(
    material(MIRROR, 1.0, 1e7, 0.1),
    material("rough", 5.0, 1.0, 0.1, scattering=0.6),
    material("vacuum", 1.0, 0.0, 0.1),
)


def small_radar(**waveform: object) -> Radar:
    """12 channels, a frame of 10 ms in 16 chirps of 128 samples, 38 m of range, 30 angles; isotropic elements."""
    fields: dict[str, object] = {"samples": 128, "chirps": 16, "chirp_interval_s": 640e-6, **waveform}
    fields.setdefault("range_bins", fields["samples"])
    full = Radar.model_construct(waveform=Waveform.model_validate(fields))  # not validated: turns may overlap
    array = AntennaArray(tx_m=full.array.tx_m[:2], rx_m=tuple(full.array.rx_m[i] for i in (0, 1, 6, 10, 13, 15)))
    front_end = FrontEnd(tx_pattern=IsotropicPattern(), rx_pattern=IsotropicPattern())
    return full.model_copy(update={"name": "small", "array": array, "front_end": front_end, "grid": ImageGrid(bins=30)})


def points(position: ArrayLike, velocity: ArrayLike | None = None, amplitude: ArrayLike | None = None) -> PathTable:
    """Echoes of points [K, 3] m, moving with [K, 3] m/s, of amplitude 1 where not given."""
    place = np.array(position, dtype=float).reshape(-1, 3)
    rate = np.zeros_like(place) if velocity is None else np.array(velocity, dtype=float).reshape(-1, 3)
    level = np.ones(len(place)) if amplitude is None else np.array(amplitude)
    return PathTable(scattered=ScatteredPaths.of_points(place, rate, level))


def cube_error(paths: PathTable, radar: Radar, tolerance: float = 1e-6) -> float:
    """Relative L2 error of the cube against the float64 sum of eq. (1) over all paths, chirps and channels."""
    return relative_error(cube_of_paths(paths, radar, tolerance), if_cube(paths, radar))


def frame_of(paths: PathTable, radar: Radar, noise: bool = True) -> Frame:
    """The whole method after tracing: cube, noise, Doppler choice, truth image, targets."""
    processing = Processing(noise=noise)
    measurement = measure(Frame(0, "scene", "hard", 0), paths, radar, processing)
    frame, _ = next(image([measurement], radar))
    return frame


def not_finite(frame: Frame) -> int:
    """Values of a frame's columns that are NaN or infinite."""
    targets = np.array([[t.range_m, t.u, t.velocity_mps, t.amplitude_db] for t in frame.targets])
    levels = np.array([frame.image_peak, frame.noise_power])
    numbers = (frame.range_channel, frame.velocity, frame.image, levels, targets)
    return sum(int(np.count_nonzero(~np.isfinite(values))) for values in numbers)


def not_finite_paths(paths: PathTable) -> int:
    """Values of a table's columns that are NaN or infinite."""
    columns = [*vars(paths.scattered).values(), *vars(paths.specular).values()]
    return sum(int(np.count_nonzero(~np.isfinite(column))) for column in columns)


def wall_ahead(distance_m: float = 10.0, material: str = MIRROR, name: str = "wall") -> SceneObject:
    """A square of 60 m ahead, facing the radar."""
    return plate(name, (distance_m, 0.0, 0.0), (0.0, 30.0, 0.0), (0.0, 0.0, 30.0), material)


def traced(objects: Sequence[SceneObject], pose: Pose = AT_ORIGIN, **settings: Any) -> PathTable:
    """The multipath of objects of :data:`MATERIALS` as traced: amplitudes not yet illuminated."""
    return trace_of(scene_of(*objects, materials=MATERIALS), pose, **{"rays": 20_000, "depth": 1, **settings})


def stage_of(
    meshes: Mapping[str, tuple[NDArray, NDArray]], metres: float = 1.0, offset: ArrayLike = (0.0, 0.0, 0.0)
) -> str:
    """A USD layer of named meshes (vertices [V, 3] m, triangles [T, 3]) in units of ``metres``, moved by [3] m."""
    place = translated(*(np.asarray(offset) / metres).tolist())
    body = "".join(
        mesh(name, vertices / metres, faces.tolist(), more=place) for name, (vertices, faces) in meshes.items()
    )
    return stage(body, f'metersPerUnit = {metres}\n upAxis = "Z"')


def read_back(
    meshes: Mapping[str, tuple[NDArray, NDArray]], metres: float, offset: ArrayLike = (0.0, 0.0, 0.0)
) -> tuple[SceneObject, ...]:
    """The objects of such a :func:`stage_of`, written and read."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "stage.usda"
        path.write_text(stage_of(meshes, metres, offset), encoding="utf-8")
        return open_scene(str(path)).objects
