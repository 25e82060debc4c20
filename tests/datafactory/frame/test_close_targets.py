"""Drawn close targets: all in view, whatever board looks at them."""

import numpy as np
import pytest

from datafactory.frame.points import CloseTargets, PointTargets, draw_close_targets, rayleigh_length
from shared.radar import load_radar


@pytest.mark.parametrize("name", ["avr-qdm-110", "iwr1843", "awr2944", "mmwcas-azimuth"])
def test_every_target_stands_in_the_image_by_itself(name: str) -> None:
    radar, settings = load_radar(name), CloseTargets()
    apart, u = [], []
    for seed in range(100):
        position = draw_close_targets(radar, settings, np.random.default_rng(seed)).position
        range_m = np.linalg.norm(position, axis=1)
        assert (range_m <= radar.waveform.ranges_m[-1]).all()
        u.append(position[:, 1] / range_m)
        # Targets of a group come one after the other, from right to left, a range bin apart at most.
        near = np.abs(np.diff(range_m)) <= radar.waveform.range_step_m
        apart.append(np.abs(np.diff(u[-1]))[near])
    seen = np.concatenate(u)
    assert seen.min() >= radar.grid.u[0] - 1e-12
    assert seen.max() <= radar.grid.u[-1] + 1e-12
    assert np.concatenate(apart).min() >= 0.5 * settings.separation_rl[0] * rayleigh_length(radar)


def test_the_list_of_a_file_s_targets_holds_what_the_image_shows() -> None:
    # Ahead; behind, which a line of elements sees ahead; along the line; and 200 m away, which folds to 46 m.
    position = np.array([(20.0, 1.0, 0.0), (-10.0, 1.0, 0.0), (0.0, 5.0, 0.0), (200.0, 0.0, 0.0)])
    radar, none = load_radar("avr-qdm-110"), np.zeros(4)
    targets = PointTargets(position, np.zeros((4, 3)), none, none)
    assert [round(target.range_m, 1) for target in targets.truth(radar)] == [20.0]
    assert targets.path_table(radar).counts == {"close_targets": 4, "folded_beyond_range": 1, "targets_out_of_view": 3}
