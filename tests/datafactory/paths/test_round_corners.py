"""Many targets round corners at once: the echoes are those of each target alone, over all edges, byte for byte."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from numpy.typing import NDArray
from sionna_scenes import WAVELENGTH_M, box, plate, scene_of, slabs

from datafactory.paths import diffraction
from datafactory.paths.diffraction import EdgeRays, rays_over_edges
from datafactory.paths.edges import edges_of
from datafactory.paths.round_corners import TARGETS_AT_ONCE, Hidden, echoes_round_corners
from datafactory.paths.table import ScatteredPaths
from datafactory.scenes.poses import Pose

STREET = scene_of(
    box("house", (5.0, 0.5, -1.0), (30.0, 40.0, 9.0), "metal"),
    box("kiosk", (9.0, -4.0, -1.0), (11.0, -2.0, 2.0), "glass"),
    plate("sign", (6.0, -1.5, 1.5), (0.0, 0.4, 0.0), (0.0, 0.0, 0.4), "metal"),
)
EDGES = edges_of(STREET).seen_from(Pose((0.0, 2.0, 0.0), velocity=(3.0, 0.0, 0.0)))
COUNT = 2 * TARGETS_AT_ONCE + 5


def targets(generator: np.random.Generator) -> NDArray[np.float64]:
    """Behind the house's corner and around the kiosk, and some upon an edge and at its end."""
    position = generator.uniform((6.0, -8.0, -1.0), (25.0, 0.0, 2.0), (COUNT, 3))
    position[5], position[6] = EDGES.start[3], EDGES.start[3] + 0.5 * EDGES.direction[3]
    return position


def half_of_all(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.bool_]:
    """A sight that hides about half of what there is, the same for the same line."""
    return np.sin(1e3 * (start + 2.0 * end)).sum(axis=1) > 0.0


def echoes(
    position: NDArray[np.float64], owner: NDArray[np.int32], polarization=("V", "V")
) -> tuple[ScatteredPaths, dict[str, int]]:
    velocity = np.stack([position[:, 1], 0.1 * position[:, 0], 0.0 * position[:, 0]], axis=1)
    hidden = Hidden(position, velocity, 0.1 + position[:, 0], owner)
    return echoes_round_corners(EDGES, slabs(STREET), half_of_all, hidden, polarization)


def same_bytes(one: object, other: object) -> None:
    for item in fields(one):  # type: ignore[arg-type]
        if item.name not in ("geometry", "candidate"):  # a target's number is its place among those asked for
            np.testing.assert_array_equal(getattr(one, item.name), getattr(other, item.name), err_msg=item.name)


@pytest.mark.parametrize("polarization", [("V", "V"), ("V", "H")])
def test_all_targets_together_have_the_echoes_that_each_has_alone(generator, polarization) -> None:
    position, owner = targets(generator), np.arange(100, 100 + COUNT, dtype=np.int32)
    together, counts = echoes(position, owner, polarization)
    alone = [echoes(position[n : n + 1], owner[n : n + 1], polarization) for n in range(COUNT)]
    assert len(together) > COUNT
    same_bytes(together, ScatteredPaths.joined([paths for paths, _ in alone]))
    assert counts == {name: sum(one[name] for _, one in alone) for name in counts}
    assert 0 < counts["targets_unreached"] < COUNT


@pytest.mark.parametrize("source", [(0.0, 0.0, 0.0), (4.0, -2.0, 0.5)])
def test_the_first_look_at_edges_drops_none_that_has_a_ray(generator, monkeypatch, source) -> None:
    """Against all edges for all targets, which is what the first look saves."""
    position = targets(generator)
    fast = rays_over_edges(EDGES, np.array(source), position, WAVELENGTH_M)

    def every(start, direction, length, z_source, rho_source, observers, wavelength_m):
        return tuple(index.reshape(-1) for index in np.indices((len(observers), len(start))))

    looked_at = len(diffraction._worth_a_look(*first_look(np.array(source), position))[0])
    monkeypatch.setattr(diffraction, "_worth_a_look", every)
    with np.errstate(divide="ignore", invalid="ignore"):  # targets upon edges, which the first look leaves out
        slow = rays_over_edges(EDGES, np.array(source), position, WAVELENGTH_M)
    assert isinstance(slow, EdgeRays)
    same_bytes(fast, slow)
    same_bytes(fast.geometry, slow.geometry)
    assert 0 < len(fast) <= looked_at < 0.8 * len(EDGES) * COUNT


def first_look(source: NDArray[np.float64], position: NDArray[np.float64]):
    z, rho = diffraction._cylindrical(EDGES.start, EDGES.direction, source)
    length = np.linalg.norm(EDGES.end - EDGES.start, axis=1)
    return EDGES.start, EDGES.direction, length, z, rho, position, WAVELENGTH_M
