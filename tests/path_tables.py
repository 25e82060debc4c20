"""Path tables made at random, and the radars of tests that compare sums over them."""

from dataclasses import replace

import numpy as np

from datafactory.paths.table import SPECULAR, PathTable, ScatteredPaths, SpecularPaths
from shared.radar import ImageGrid, Radar
from shared.radar.arrays import AntennaArray, line
from shared.radar.waveform import Waveform

SMALL = AntennaArray(tx_m=line(np.array([-0.05, -0.046])), rx_m=line(np.array([-0.045, 0.003, 0.045])))
GRID = ImageGrid(bins=30)
"""Coarse, to keep the references quick: paths are placed within a beam width of its points, so that peaks are seen."""


def radar_of(samples: int = 64, chirps: int = 32, array: AntennaArray = SMALL, **waveform: object) -> Radar:
    """A frame of 10.3 ms like the default's, in fewer chirps: with 32, 3 m/s is the unambiguous velocity."""
    fields = {"samples": samples, "range_bins": samples, "chirps": chirps, "chirp_interval_s": 128 * 80.6e-6 / chirps}
    # Not validated: eq. (1) and (2) hold for turns that overlap, too.
    return Radar.model_construct(waveform=Waveform.model_validate({**fields, **waveform}), array=array)


def truth_radar(samples: int, range_bins: int, chirps: int = 32) -> Radar:
    """The same with the default's array, for truths."""
    radar = radar_of(samples, chirps, Radar().array, range_bins=range_bins)
    return radar.model_copy(update={"grid": GRID})


def a_table(
    generator: np.random.Generator, count: int = 12, nearest_m: float = 0.6, farthest_m: float = 30.0
) -> PathTable:
    """Scattered paths with two different ends, and specular ones by one or two tilted moving mirrors."""
    range_m = np.geomspace(nearest_m, farthest_m, count)
    u = generator.uniform(-0.8, 0.8, count)
    point = range_m[:, None] * np.stack([np.sqrt(0.95 - u**2), u, np.full(count, -np.sqrt(0.05))], axis=1)
    velocity = generator.uniform(-10.0, 10.0, (count, 3))
    scattered = replace(
        ScatteredPaths.of_points(point, velocity, generator.normal(size=count) + 1j * generator.normal(size=count)),
        tx_point=point + generator.uniform(-0.3, 0.3, (count, 3)),
        tx_velocity=generator.uniform(-10.0, 10.0, (count, 3)),
        between_m=generator.uniform(0.0, 3.0, count),
        between_rate_mps=generator.uniform(-5.0, 5.0, count),
    )
    normals = generator.normal(size=(count, 3)) + np.array([4.0, 0.0, 0.0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    reflection = np.eye(3) - 2.0 * normals[:, :, None] * normals[:, None, :]
    turned = np.where(np.arange(count)[:, None, None] % 2, reflection, reflection @ reflection[::-1])
    amplitude, owner = np.ones(count, dtype=complex), np.zeros(count, dtype=np.int32)
    return PathTable(scattered, SpecularPaths.of(2.0 * point, velocity, turned, amplitude, owner, SPECULAR))


def random_reflection(generator: np.random.Generator) -> np.ndarray:
    """[3, 3] a product of one to three mirrors."""
    axes = np.eye(3)
    for _ in range(generator.integers(1, 4)):
        normal = generator.normal(size=3)
        normal /= np.linalg.norm(normal)
        axes = axes - 2.0 * np.outer(normal, normal @ axes)
    return axes


def random_table(
    generator: np.random.Generator,
    scattered: int,
    specular: int,
    limits_m: tuple[float, float],
    span_db: float,
    speed: float,
) -> PathTable:
    """Paths of all kinds: single and multiple bounces, images behind mirrors, over a range of distances and powers."""

    def points(count: int) -> np.ndarray:
        direction = generator.normal(size=(count, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        return direction * np.exp(generator.uniform(np.log(limits_m[0]), np.log(limits_m[1]), count))[:, None]

    def amplitudes(count: int) -> np.ndarray:
        level = 10.0 ** (-span_db / 20.0 * generator.uniform(0.0, 1.0, count))
        return level * np.exp(2j * np.pi * generator.uniform(size=count))

    def velocities(count: int) -> np.ndarray:
        return speed * generator.uniform(-1.0, 1.0, (count, 3))

    paths = ScatteredPaths.of_points(points(scattered), velocities(scattered), amplitudes(scattered))
    # Every second path bounces more than once: another point at the RX's end, and a length between.
    multiple = np.arange(scattered) % 2 == 1
    paths = replace(
        paths,
        rx_point=np.where(multiple[:, None], points(scattered), paths.tx_point),
        rx_velocity=np.where(multiple[:, None], velocities(scattered), paths.tx_velocity),
        between_m=np.where(multiple, generator.uniform(0.0, 20.0, scattered), 0.0),
        between_rate_mps=np.where(multiple, speed * generator.uniform(-1.0, 1.0, scattered), 0.0),
    )
    image, velocity, owner = 2.0 * points(specular), velocities(specular), np.full(specular, -1, dtype=np.int32)
    axes = np.array([random_reflection(generator) for _ in range(specular)]).reshape(specular, 3, 3)
    return PathTable(paths, SpecularPaths.of(image, velocity, axes, amplitudes(specular), owner, SPECULAR))


def different_columns(one: PathTable, other: PathTable) -> list[str]:
    """Names of the columns of two tables that are not the same, in type and bit for bit."""
    different = []
    for kind in ("scattered", "specular"):
        for name, ours in vars(getattr(one, kind)).items():
            theirs = getattr(getattr(other, kind), name)
            if ours.dtype != theirs.dtype or ours.tobytes() != theirs.tobytes():
                different.append(f"{kind}.{name}")
    return different
