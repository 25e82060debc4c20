"""The price list's picture: labels that can be read, differences measured as such, and how these are timed."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import combinations

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from datafactory.accuracy import chart, report
from datafactory.accuracy.clock import STAGES, in_turn
from datafactory.accuracy.front import EVERYTHING
from datafactory.accuracy.power import Effort
from datafactory.accuracy.row import DEFAULTS, Row

ROW = Row(
    knob=DEFAULTS, setting="all, power", default=True, kind="power", seconds=6.0,
    stage_seconds=dict.fromkeys(STAGES, 1.0), seconds_beside=None, cube_error_db=-45.0, image_error_db=-40.0,
    image_l2_db=-45.0, power_error_db=-40.0, power_l1_db=-20.0, power_l1_range_weighted_db=-20.0, power_bias_db=0.0,
    detections_changed=1.0, doppler_rows_changed=1.0, peak_mb=100.0, paths=1000.0, work=1e9, reference="many rays",
)  # fmt: skip
"""The default's row, after which others are shaped."""


def test_two_frames_are_timed_in_turn():
    calls = []

    def made(name, clock):
        calls.append(name)
        return clock("truth", lambda: name)

    value, first, second = in_turn(3, partial(made, "with"), partial(made, "without"))
    assert value == "with"
    assert calls == ["with", "without"] * 3
    assert [len(clock.measured["truth", ""]) for clock in (first, second)] == [3, 3]
    assert [Effort(1, repeats=repeats).in_turn for repeats in (1, 5)] == [2, 5]


def test_changes_are_shown_against_what_was_timed_beside_them():
    slow = replace(ROW, knob="diffuse", setting="off", seconds=7.25, seconds_beside=9.5)
    figure = chart.draw([ROW, slow], "tiny")
    texts = [text.get_text() for axis in figure.axes for text in axis.texts]
    assert "-2.25 s, -40 dB" in texts


def test_an_effect_has_the_plans_figure_beside_it():
    split = replace(ROW, knob="refraction", setting="on", seconds=7.25, seconds_beside=7.0)
    changes_db = {"refraction": -46.2}
    figure = chart.draw([ROW.planned(changes_db), split.planned(changes_db)], "tiny")
    texts = [text.get_text() for axis in figure.axes for text in axis.texts]
    assert "+0.25 s, -46 dB" in texts
    assert [row[report.HEADINGS.index("plan dB")] for row in report.table_rows([ROW, split.planned(changes_db)])] == [
        "", "-46.2",
    ]  # fmt: skip


@pytest.mark.parametrize("step_db", [1.0, 3.0])
def test_rays_of_points_close_together_stand_apart(step_db):
    front = [
        replace(ROW, knob=EVERYTHING, kind="front", setting=f"-9 dB: {rays} rays, depth 1", image_error_db=-80.0,
                cube_error_db=-15.0 - step_db * place, power_error_db=-80.0, seconds=1.0 + 0.04 * place)
        for place, rays in enumerate((3125, 6250, 12_500))
    ]  # fmt: skip
    dear = replace(front[0], setting="-9 dB: 800000 rays, depth 1", cube_error_db=-45.0, seconds=40.0)
    figure = chart.draw([*front, dear], "tiny")
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    labels = [text for text in figure.axes[0].texts if text.get_text().endswith(" rays")]
    boxes = [label.get_window_extent(canvas.get_renderer()) for label in labels]
    assert [label.get_text() for label in labels] == ["3 125 rays", "6 250 rays", "800 000 rays"]
    assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
