"""Phase fidelity as a figure: how wrong are phase differences over the array and over the frame, far from the origin.

A scatterer, or a mirror, stands at range R from a moving radar, and all of it D from the scene's origin. The whole
chain is judged: world coordinates in float64, the vertices that the tracer gets in float32, what it returns, delays,
phases, and the cube. Of a mirror, the exact echo is that of its world plane; of a rough wall, that of the point of its
world plane nearest to where the ray hit, because which point a ray hits is chance, but that it lies on the wall is not;
of a point target, that of its world position. The reference has the 64 bits of an extended float: 3e-14 m at 500 km.

The phase error is that of the cube's mid-sweep sample. What is common to all elements, or to all chirps, moves no
image: the largest departure from the first element's, or the first chirp's, is the figure. The sidelobe floor is that
of a line array of 256 elements with these phase errors under a Chebyshev window of 200 dB, beyond its main lobe.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from hardcases.case import HardCase
from hardcases.tools import MIRROR, points, traced
from numpy.typing import NDArray
from scipy.signal.windows import chebwin
from sionna_scenes import plate

from datafactory.paths.merged_scene import MergedMesh
from datafactory.paths.table import PathTable
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose
from datafactory.synthesis.cube import cube_of_paths
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar
from shared.radar.waveform import Waveform
from shared.signal.sweep import reference_frequency_hz

RANGES_M = (5.0, 50.0, 200.0)
OFFSETS_M = (0.0, 1e3, 10e3, 500e3)
KINDS = ("point target", "mesh vertex", "mirror", "rough wall")
PHASE_DEG = 0.01
FLOOR_DB = -100.0
DIRECTION = np.array([0.8, 0.59, 0.1]) / np.linalg.norm([0.8, 0.59, 0.1])
VELOCITY = (9.0, 4.0, -0.3)
YAW_DEG = 13.0
CHIRPS = 8
"""Of a frame as long as the default's: 10.3 ms."""
Exact = NDArray[np.longdouble]
Lengths = Callable[[Exact, Exact, float], np.longdouble]
"""Length of an echo [m] from a TX to an RX, positions in the radar frame, at a time [s] after the start."""


@dataclass(frozen=True)
class Fidelity:
    """Worst phase error [deg] over the array and over the frame, and the sidelobe floor [dB] it implies."""

    array_deg: float
    frame_deg: float
    floor_db: float


def radar() -> Radar:
    """The default radar with few samples: phases at mid-sweep do not depend on how many."""
    waveform = Waveform(samples=32, range_bins=32, chirps=CHIRPS, chirp_interval_s=128 * 80.6e-6 / CHIRPS)
    return Radar(waveform=waveform)


@lru_cache(maxsize=64)
def fidelity(kind: str, range_m: float, offset_m: float) -> Fidelity:
    """The figure for one kind of echo at one range and one offset."""
    pose = Pose((offset_m + 0.123456789, 0.7 * offset_m - 0.2, 0.5), YAW_DEG, velocity=VELOCITY)
    world = np.asarray(pose.position) + pose.rotation() @ (range_m * DIRECTION)
    hit = None
    if kind in ("point target", "mesh vertex"):
        paths = _point(pose, world, in_mesh=kind == "mesh vertex")
        exact = _point_lengths(pose, world)
    else:
        normal = pose.rotation() @ -DIRECTION
        across = np.cross(normal, [0.0, 0.0, 1.0])
        half = 0.2 * range_m
        up = np.cross(across, normal)
        sheet = plate("sheet", world, half * across, half * up, MIRROR if kind == "mirror" else "rough")
        found = traced([sheet], pose, rays=4000)
        if kind == "mirror":
            paths = PathTable(points([]).scattered, found.specular)
        else:
            paths = PathTable(found.scattered.take(np.array([len(found.scattered) // 3])))
            hit = paths.scattered.rx_point[0]
        exact = _wall_lengths(pose, sheet.vertices, hit)
    assert len(paths) == 1, f"{len(paths)} paths where one was set up"
    sensor = radar().virtual_sensor
    signal = cube_of_paths(paths, radar(), array=sensor)[:, radar().waveform.samples // 2, :]
    over_array = _phase_error(signal, exact, [0], range(sensor.channels))[0]
    over_frame = _phase_error(signal, exact, range(CHIRPS), range(0, sensor.channels, 51))
    return Fidelity(
        array_deg=float(np.degrees(np.abs(over_array - over_array[0]).max())),
        frame_deg=float(np.degrees(np.abs(over_frame - over_frame[:1]).max())),
        floor_db=sidelobe_floor_db(over_array),
    )


def sidelobe_floor_db(error_rad: NDArray[np.float64]) -> float:
    """Highest sidelobe [dB] of a line array with these phase errors [C], the window's own being at -200 dB."""
    elements = len(error_rad)
    oversampling = 16
    response = np.abs(np.fft.fft(chebwin(elements, at=200.0) * np.exp(1j * error_rad), oversampling * elements))
    # The main lobe of this window ends within 8 resolution cells, wherever a constant slope of the errors has moved it.
    response = np.roll(response, -int(response.argmax()))
    reach = 9 * oversampling
    return float(20.0 * np.log10(response[reach:-reach].max() / response[0]))


def _point(pose: Pose, world: NDArray[np.float64], in_mesh: bool) -> PathTable:
    """A point seen from a pose: as point targets are, in float64, or as the tracer is given vertices, in float32."""
    if in_mesh:
        none = np.zeros((0, 3), dtype=np.int32)
        mesh = MergedMesh(
            load_materials().materials["concrete"], np.zeros(3), world[None], none, np.zeros(0, dtype=np.int32)
        )
        seen = mesh.seen_from(pose).astype(np.float64)
    else:
        seen = (world[None] - np.asarray(pose.position)) @ pose.rotation()
    return points(seen, -np.asarray(VELOCITY)[None] @ pose.rotation())


def _phase_error(
    signal: NDArray, exact: Lengths, chirps: Sequence[int], elements: Sequence[int]
) -> NDArray[np.float64]:
    """[chirps, elements] phase of a signal [all chirps, all elements] less the exact one [rad].

    Both are referred to the first of them, so that errors of a small fraction of a cycle never wrap.
    """
    device, rest = radar(), np.empty((len(chirps), len(elements)), dtype=np.complex128)
    wave = np.longdouble(reference_frequency_hz(device)) / np.longdouble(SPEED_OF_LIGHT)
    tx, rx = (
        np.asarray(places, dtype=np.longdouble) for places in (device.virtual_sensor.tx, device.virtual_sensor.rx)
    )
    for m, chirp in enumerate(chirps):
        for c, element in enumerate(elements):
            length = exact(tx[0], rx[element], chirp * device.waveform.chirp_interval_s)
            rest[m, c] = signal[chirp, element] * np.exp(-2j * np.pi * float(wave * length % 1))
    return np.angle(rest / rest[0, 0])


def _point_lengths(pose: Pose, world: NDArray[np.float64]) -> Lengths:
    """Length of the echo of a resting point in the world, seen from the moving radar."""
    start, motion = _seen(world, pose), _seen_motion()
    return lambda tx, rx, time_s: _length(start + motion * time_s - tx) + _length(start + motion * time_s - rx)


def _wall_lengths(pose: Pose, corners: NDArray[np.float64], hit: NDArray[np.float64] | None) -> Lengths:
    """Length of the echo of a resting wall with these world corners [4, 3].

    :param hit: where a ray struck, in the radar frame; the point of the wall nearest to it scatters. None for a mirror.
    """
    origin, second, _, fourth = (_seen(corner, pose) for corner in corners)
    normal = np.cross(second - origin, fourth - origin)
    normal /= _length(normal)
    motion = _seen_motion()
    start = origin if hit is None else hit - (hit - origin) @ normal * normal

    def length(tx: Exact, rx: Exact, time_s: float) -> np.longdouble:
        at = start + motion * time_s
        if hit is None:
            return _length(tx - 2 * ((tx - at) @ normal) * normal - rx)
        return _length(at - tx) + _length(at - rx)

    return length


def _length(vector: Exact) -> np.longdouble:
    return np.longdouble(np.sqrt(vector @ vector))


def _turn() -> Exact:
    """The pose's own float64 rotation: the attitude is what the product says it is."""
    return Pose((0.0, 0.0, 0.0), YAW_DEG).rotation().astype(np.longdouble)


def _seen(world: NDArray[np.float64], pose: Pose) -> Exact:
    """A world point in the radar frame at the start of the frame."""
    return _turn().T @ (world.astype(np.longdouble) - np.array(pose.position, dtype=np.longdouble))


def _seen_motion() -> Exact:
    """Velocity of the resting world in the radar frame."""
    return -_turn().T @ np.array(VELOCITY, dtype=np.longdouble)


def _worst(kind: str, figure: str) -> float:
    return max(getattr(fidelity(kind, range_m, offset_m), figure) for range_m in RANGES_M for offset_m in OFFSETS_M)


WHERE = "at 5 to 200 m, 0 to 500 km from the origin"
FIGURES = (
    ("array phase", f"float32 coordinates {WHERE}", PHASE_DEG, "deg", "array_deg"),
    ("frame phase", f"as above, over 10 ms at 10 m/s {WHERE}", PHASE_DEG, "deg", "frame_deg"),
    ("sidelobe floor", "phase errors fill the 256-element truth with sidelobes", FLOOR_DB, "dB", "floor_db"),
)
"""Name, hazard, bound, unit, and the field of :class:`Fidelity`."""
CASES = tuple(
    HardCase(f"{name}, {kind}", hazard, bound, unit, partial(_worst, kind, figure))
    for kind in KINDS
    for name, hazard, bound, unit, figure in FIGURES
)
