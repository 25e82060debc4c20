"""What moves, in one trace: Doppler, places at the pose's time, and the phases that rough surfaces keep."""

from __future__ import annotations

import numpy as np
import pytest
from traced_walls import (
    power,
    rectangle,
    traced,
    wall,
)

from datafactory.paths.table import PathTable
from datafactory.scenes.poses import Pose
from datafactory.synthesis.cube import cube_of_paths
from shared.radar import FrontEnd, Radar
from shared.radar.antenna import IsotropicPattern
from shared.radar.waveform import Waveform
from shared.signal.spectrum import range_doppler

pytestmark = pytest.mark.usefixtures("variant")


def peak_velocity(table: PathTable) -> float:
    """Velocity [m/s] of the strongest range-Doppler cell."""
    waveform = Waveform(samples=128, range_bins=128, chirps=64)
    front_end = FrontEnd(tx_pattern=IsotropicPattern(), rx_pattern=IsotropicPattern())
    radar = Radar(waveform=waveform, front_end=front_end)
    spectra = range_doppler(cube_of_paths(table.illuminated(front_end), radar).astype(np.complex64), radar)
    return float(waveform.velocities_mps[(np.abs(spectra) ** 2).sum(axis=(0, 2)).argmax()])


@pytest.mark.parametrize("kind", ["mirror", "rough"])
@pytest.mark.parametrize("speed", [-6.0, 3.0])
def test_a_moving_objects_velocity_appears_in_the_doppler(kind, speed):
    table = traced(wall(kind, half_m=0.5, velocity=(speed, 0.0, 0.0)), rays=5_000)
    assert len(table) > 0
    assert peak_velocity(table) == pytest.approx(speed, abs=0.2)  # half a cell


@pytest.mark.parametrize("kind", ["mirror", "rough"])
@pytest.mark.parametrize("yaw_deg", [0.0, 90.0])
def test_driving_ahead_brings_the_wall_nearer(kind, yaw_deg):
    pose = Pose((0.0, 0.0, 0.0), yaw_deg=yaw_deg, velocity=(5.0, 0.0, 0.0) if yaw_deg == 0.0 else (0.0, 5.0, 0.0))
    ahead = wall(kind, half_m=0.5)
    if yaw_deg:
        ahead = rectangle("wall", (0.0, 10.0, 0.0), (0.5, 0.0, 0.0), (0.0, 0.0, 0.5), kind)
    table = traced(ahead, pose=pose, rays=5_000)
    assert peak_velocity(table) == pytest.approx(-5.0, abs=0.2)


def test_objects_stand_where_they_are_at_the_poses_time():
    moving = wall("mirror", velocity=(-4.0, 0.0, 0.0))
    table = traced(moving, pose=Pose((0.0, 0.0, 0.0), time_s=0.5))
    assert table.specular.range_m()[0] == pytest.approx(8.0, abs=1e-4)
    np.testing.assert_allclose(table.specular.image_velocity[0], [-8.0, 0.0, 0.0], atol=1e-4)


def test_a_moving_mirror_moves_its_image_twice_as_fast():
    table = traced(wall("mirror", velocity=(-3.0, 5.0, 0.0)), pose=Pose((0.0, 0.0, 0.0), time_s=0.5))
    np.testing.assert_allclose(table.specular.image[0], [2.0 * 8.5, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(table.specular.image_velocity[0], [-6.0, 0.0, 0.0], atol=1e-9)


def test_neighbouring_poses_share_a_rough_surfaces_phases():
    # The same lattice seen 1 mm and 10 cm further: phases of the surface stay, or are drawn anew; powers stay.
    def phases(step_m: float) -> dict[tuple[float, ...], complex]:
        wide = wall("rough")  # wider than the beam, so that the same rays hit it from all three places
        pose = Pose((0.0, step_m, 0.0))
        rough, smooth = (traced(wide, pose=pose, rays=5_000, surface_phase=given) for given in (True, False))
        assert power(rough.scattered) == pytest.approx(power(smooth.scattered), rel=1e-9)
        turn = rough.scattered.amplitude / smooth.scattered.amplitude
        near = np.linalg.norm(rough.scattered.rx_point, axis=1) < 30.0  # where float32 hits agree to a millimetre
        return dict(zip(map(tuple, np.round(rough.scattered.rx_point[near], 2)), turn[near], strict=True))

    here, near, far = phases(0.0), phases(1e-3), phases(0.1)

    def kept(there: dict[tuple[float, ...], complex]) -> float:
        both = here.keys() & there.keys()
        assert len(both) > 500
        return float(np.mean([abs(here[place] - there[place]) < 1e-9 for place in both]))

    assert kept(near) > 0.9
    assert kept(far) < 0.1
