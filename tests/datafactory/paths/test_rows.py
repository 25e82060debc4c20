"""Unfolded mirrors against mirrors: chains of one to three, static and moving."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from oracles import mirror_path, mirrored

from datafactory.paths.rows import image_seen_from_tx, tx_image_seen_from_rx
from shared.physics.vectors import unit

Plane = tuple[NDArray[np.float64], NDArray[np.float64]]
ORIGIN = np.zeros(3)


def random_chain(
    generator: np.random.Generator, mirrors: int, end: NDArray[np.float64]
) -> tuple[list[Plane], NDArray[np.float64]]:
    """Planes and vertices of a path from the origin to ``end`` on which every reflection is a real one."""
    while True:
        planes = [(generator.uniform(-15.0, 15.0, 3), unit(generator.normal(size=3))) for _ in range(mirrors)]
        _, vertices = mirror_path(ORIGIN, end, planes)
        chain = np.concatenate([[ORIGIN], vertices, [end]])
        sides = [
            ((chain[k] - plane[0]) @ plane[1], (chain[k + 2] - plane[0]) @ plane[1]) for k, plane in enumerate(planes)
        ]
        if all(before * after > 0.5 for before, after in sides) and np.abs(vertices).max() < 60.0:
            return planes, vertices


def moved(planes: list[Plane], velocities: NDArray[np.float64], time_s: float) -> list[Plane]:
    return [(origin + velocity * time_s, normal) for (origin, normal), velocity in zip(planes, velocities, strict=True)]


@pytest.mark.parametrize("mirrors", [0, 1, 2])
def test_image_of_a_scatterer_behind_moving_mirrors(mirrors):
    generator = np.random.default_rng(3)
    for _ in range(10):
        scatterer = generator.uniform(-8.0, 8.0, 3)
        planes, vertices = random_chain(generator, mirrors, scatterer) if mirrors else ([], np.zeros((0, 3)))
        velocities = generator.uniform(-10.0, 10.0, (mirrors + 1, 3))

        def seen_from_tx(time_s, planes=planes, velocities=velocities, scatterer=scatterer):
            image = scatterer + velocities[-1] * time_s
            for plane in reversed(moved(planes, velocities[:-1], time_s)):
                image = mirrored(image, plane)
            return image

        chain = np.concatenate([vertices, [scatterer]])[None]
        position, velocity = image_seen_from_tx(chain, velocities[None], np.array([mirrors]))
        np.testing.assert_allclose(position[0], seen_from_tx(0.0), atol=1e-8)
        np.testing.assert_allclose(velocity[0], seen_from_tx(1.0) - seen_from_tx(0.0), atol=1e-8)


def test_paths_of_different_numbers_of_mirrors_stand_together():
    # Bounces after the scattering one do not change what the TX sees of it.
    generator = np.random.default_rng(4)
    scatterer, after = np.array([6.0, 1.0, 0.5]), np.array([3.0, -4.0, 1.0])
    planes, vertices = random_chain(generator, 1, scatterer)
    direct = np.stack([scatterer, after, after + 1.0])
    mirrored_first = np.stack([vertices[0], scatterer, after])
    position, velocity = image_seen_from_tx(
        np.stack([direct, mirrored_first]), np.tile([1.0, 2.0, 3.0], (2, 3, 1)), np.array([0, 1])
    )
    np.testing.assert_allclose(position, [scatterer, mirrored(scatterer, planes[0])], atol=1e-9)
    # Mirror and point move alike: so does the image.
    np.testing.assert_allclose(velocity, np.tile([1.0, 2.0, 3.0], (2, 1)), atol=1e-9)


@pytest.mark.parametrize("mirrors", [1, 2, 3])
@pytest.mark.parametrize("moving", [False, True])
def test_delay_law_of_mirrors_holds_for_every_pair_of_elements(mirrors, moving):
    generator = np.random.default_rng(5)
    for _ in range(10):
        planes, vertices = random_chain(generator, mirrors, ORIGIN)
        velocities = generator.uniform(-10.0, 10.0, (mirrors, 3)) * moving
        image, velocity, axes = tx_image_seen_from_rx(vertices[None], velocities[None])
        np.testing.assert_allclose(axes[0] @ axes[0].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(axes[0]) == pytest.approx((-1.0) ** mirrors)
        for _ in range(5):
            tx, rx = generator.uniform(-0.3, 0.3, (2, 3))
            time_s = generator.uniform(0.0, 0.02)
            exact, _ = mirror_path(tx, rx, moved(planes, velocities, time_s))
            law = np.linalg.norm(rx - (image[0] + velocity[0] * time_s + axes[0] @ tx))
            assert law == pytest.approx(exact, abs=1e-8)
