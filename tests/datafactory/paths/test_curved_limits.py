"""Curved mirrors where the closed form ends: foci, saddles, degenerate triangles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from curved_bodies import (
    joined,
    sphere,
    torus,
    tube,
)
from curved_scenes import (
    amplitudes,
    body,
    traced,
)
from scipy.special import fresnel
from sionna_scenes import WAVELENGTH_M

from datafactory.paths import curved_echoes
from datafactory.paths.curved_feet import CurvedFeet
from datafactory.paths.table import PathTable

pytestmark = pytest.mark.usefixtures("variant")


def test_the_inside_of_a_cylinder_beyond_its_focus():
    """A pipe's far wall, 1 + kappa R = 1 - R / r: the line focus takes a quarter of a cycle."""
    pipe = tube(2.0, 0.2, 90, start=-0.5 * np.pi, turn=np.pi)
    for range_m in (1.0, 1.7, 3.0, 9.0):
        table = traced(body(pipe, (range_m - 2.0, 0.0, 0.0)))
        sine, cosine = fresnel(np.sqrt(2.0) * 0.1 * np.sqrt(2.0 / (range_m * WAVELENGTH_M)))
        along = np.sqrt(2.0) * (cosine + 1j * sine) * np.exp(-0.25j * np.pi)
        gain = along / np.sqrt(abs(1.0 - range_m / 2.0)) * (1.0 if range_m < 2.0 else -1j)
        infinite = -WAVELENGTH_M / (8.0 * np.pi * range_m)
        echoes = amplitudes(table)
        assert len(echoes) == 1
        assert abs(20.0 * np.log10(abs(echoes[0] / (infinite * gain)))) < 0.6
        assert abs(np.angle(echoes[0] / (infinite * gain))) < 0.15


def finite(table: PathTable) -> bool:
    return all(
        np.isfinite(np.asarray(v)).all() for kind in (table.scattered, table.specular) for v in vars(kind).values()
    )


def test_at_a_focus_the_echo_is_finite_and_counted():
    for of, centre in ((sphere(2.0, 32), (0.0, 0.0, 0.0)), (tube(2.0, 9.0, 40), (0.0, 0.0, 0.0)),
                       (sphere(2.0, 32), (0.01, 0.0, 0.0)), (tube(2.0, 9.0, 40), (0.0, 0.02, 0.0))):  # fmt: skip
        table = traced(body(of, centre))
        assert finite(table)
        assert np.abs(amplitudes(table)).max(initial=0.0) < 1.0
        assert len(table) + table.counts["triangles_round_their_focus"] > 0


def test_a_saddle_has_its_two_curvatures():
    """The inner side of a torus, seen along its plane from within its hole, off its axis."""
    ring, thick, eye = 3.0, 0.8, 1.5
    table = traced(body(torus(ring, thick, 120, 48), (-eye, 0.0, 0.0)))
    assert finite(table)
    range_m = np.concatenate([table.scattered.range_m(), table.specular.range_m()])
    here = np.argmin(np.abs(range_m - (ring - thick - eye)))
    kappa = np.array([1.0 / thick, -1.0 / (ring - thick)])
    gain = 1.0 / np.sqrt(np.prod(1.0 + kappa * range_m[here]))
    expected = WAVELENGTH_M / (8.0 * np.pi * range_m[here]) * gain
    assert abs(20.0 * np.log10(abs(amplitudes(table)[here]) / expected)) < 0.3


def test_near_a_focus_the_magnitude_is_bounded():
    feet = replace(_feet(), curvature=np.array([[-0.5, 3.0], [-0.5 * (1.0 + 1e-9), 0.0], [0.7, 0.7]]))
    factor = curved_echoes.focus_factors(feet, WAVELENGTH_M)
    assert (np.abs(factor) >= 0.5 * WAVELENGTH_M * 0.25 * 2.0 * 0.999).all()
    np.testing.assert_allclose(factor[2], 2.4)


def _feet():
    count = 3
    foot = np.tile([2.0, 0.0, 0.0], (count, 1))
    return CurvedFeet(
        triangle=np.arange(count), surface=np.zeros(count, dtype=int), foot=foot, seen_to=foot, normal=-0.5 * foot,
        curvature=np.zeros((count, 2)), axes=np.tile(np.eye(3)[1:], (count, 1, 1)),
    )  # fmt: skip


def test_degenerate_triangles_and_doubled_ones_change_nothing():
    vertices, triangles = sphere(0.5, 32)
    extra = np.concatenate(
        [triangles, triangles[:50, ::-1], np.stack([triangles[:9, 0]] * 2 + [triangles[:9, 1]], axis=1)]
    )
    alone, with_more = (traced(body((vertices, part), (5.0, 0.3, 0.2))) for part in (triangles, extra))
    np.testing.assert_allclose(amplitudes(with_more), amplitudes(alone), rtol=1e-9)
    two = joined(sphere(0.5, 32), (sphere(0.5, 32)[0] + [0.0, 3.0, 0.0], sphere(0.5, 32)[1]))
    assert len(traced(body(two, (5.0, 0.3, 0.2)))) == 2
