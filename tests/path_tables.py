"""Path tables made at random, for tests that compare formulas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from datafactory.paths.table import PathTable, ScatteredPaths, SpecularPaths


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
    specular = SpecularPaths(
        image=2.0 * point,
        image_velocity=velocity,
        axes=turned,
        amplitude=np.ones(count, dtype=complex),
        depth=np.ones(count, dtype=np.int8),
        object_index=np.zeros(count, dtype=np.int32),
        kinds=np.ones(count, dtype=np.uint8),
    )
    return PathTable(scattered, specular)
