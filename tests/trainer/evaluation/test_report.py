"""The page of an evaluation: one file that loads nothing, whose data are those that were put in."""

import base64
import io
import json
import math
import re
import shutil
import subprocess
from collections.abc import Mapping

import numpy as np
import pytest
from matplotlib.image import imread
from tiny_radar import RADAR

from trainer.data.simulation import TrialCondition
from trainer.evaluation.evaluate import SUMMARY_COLUMNS
from trainer.evaluation.report.figures import Look, image_panels, image_sheet, legend_below, panels, save_figure
from trainer.evaluation.report.page import ReportFigure, ReportFrame, report_page
from trainer.evaluation.report.tables import MetricRow, Numbers, metrics_table, summary, write_table

SHAPE = (RADAR.waveform.range_bins, RADAR.grid.bins)
NODE = shutil.which("node")
HOSTILE = "hall </script><!--<script><b>\u2028 & \\u003c, frame 1"
"""The begin of a comment and of a second element, together, would keep the page's own element from ending."""


def images():
    """Two images and a truth: the truth's only echo stands in range bin 7, column 15."""
    generator = np.random.default_rng(0)
    found = {"das full": generator.integers(0, 200, SHAPE, dtype=np.uint8), "iaa full": np.zeros(SHAPE, np.uint8)}
    found["truth"] = np.zeros(SHAPE, np.uint8)
    found["truth"][7, 15] = 255
    return found


def table():
    rows = [
        MetricRow("detection", "das", "full", "precision", {"d_max": "2 bins"}, 0.25, 0.125, 0.5, 9),
        MetricRow(
            "detection", "iaa", "full", "precision", {"d_max": "2 bins"}, float("nan"), float("nan"), float("inf"), 0
        ),
    ]
    return metrics_table(rows, {("das", "full"): 0.5}, {("das", "full"): 0})


@pytest.fixture(scope="module")
def page():
    figure = ReportFigure("A <title> & {{data}}", "caption </script>", b"\x89PNG not really")
    frames = [ReportFrame(HOSTILE, 7, images()), ReportFrame("hall, frame 2", 3, images())]
    return report_page("Evaluation <of> {{data}}", "all & everything", RADAR, frames, [figure], table())


def embedded(page, element="data"):
    found = re.search(rf'<script type="application/json" id="{element}">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return json.loads(found.group(1))


def test_the_page_loads_nothing(page):
    assert not re.search(r"https?:|<link|@import|url\(|fetch\(|XMLHttpRequest|import\(|<iframe", page)
    sources = re.findall(r'\bsrc\s*=\s*"?([^">]{0,30})', page[: page.rindex("<script>")])
    assert sources
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    script = page[page.rindex("<script>") :]
    assert set(re.findall(r"\.src = (.{0,16})", script)) == {'"data:image/png;', '"data:image/jpeg'}
    assert not re.search(r"<script[^>]+src", page)


def test_intervals_are_not_said_to_be_all_of_one_kind(page):
    """Those of shares are Wilson's."""
    assert "Value with its 95 % interval." in page


def test_no_text_of_the_data_is_taken_for_markup(page):
    # The page's own script, its data and one element a frame, and no mark of the template left or filled twice.
    assert page.count("</script>") == 4
    assert page.count("<script") == 4
    assert "<!--" not in page
    assert "\u2028" not in page
    assert page.count("<h1>") == 1
    assert "Evaluation &lt;of&gt; {{data}}" in page
    assert "A &lt;title&gt; &amp; {{data}}" in page
    assert page.count('"axes"') == 1


def test_the_embedded_images_are_those_put_in(page):
    data = embedded(page)
    assert [frame["name"] for frame in data["frames"]] == [HOSTILE, "hall, frame 2"]
    assert (data["axes"]["range_bins"], data["axes"]["u_bins"]) == SHAPE
    for name, levels in images().items():
        picture = imread(io.BytesIO(base64.b64decode(embedded(page, "frame-0")["images"][name])))
        np.testing.assert_array_equal(np.rint(255 * picture).astype(np.uint8), levels)
    assert len(data["colours"]) == 256
    assert data["table"]["columns"][:3] == ["experiment", "method", "array"]
    assert data["table"]["rows"][0][5:10] == [0.25, 0.125, 0.5, 9, 0.5]
    assert data["table"]["rows"][1][5:10] == [None, None, None, 0, None]


def test_undefined_numbers_are_null_in_both_tables(tmp_path):
    write_table(table(), tmp_path)
    lines = (tmp_path / "metrics.csv").read_text().splitlines()
    assert lines[2] == '"detection","iaa","full","precision","d_max=2 bins",,,,0,,'
    assert not list(tmp_path.glob("*.partial"))


@pytest.mark.parametrize("kind", [bool, float])
def test_a_mean_of_nothing_is_undefined(kind):
    found = Numbers("detection", 0)
    found.mean(("das", "full"), "share", {}, np.zeros(0, kind))
    (row,) = found.rows
    assert np.isnan([row.value, row.low, row.high]).all()
    assert row.samples == 0


@pytest.mark.skipif(NODE is None, reason="there is no node to parse the page's script")
def test_the_script_parses(page, tmp_path):
    script = re.search(r"<script>\n(.*?)</script>", page, re.DOTALL)
    assert script is not None
    assert NODE is not None
    (tmp_path / "page.js").write_text(script.group(1))
    done = subprocess.run(
        [NODE, "--check", tmp_path / "page.js"], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr


def test_panels_show_what_stands_left_on_the_left():
    levels = np.full(SHAPE, -40.0)
    levels[5, -1] = 0.0  # the largest u: farthest left of the radar
    figure = image_sheet({"das": levels}, levels, RADAR, "title")
    picture = figure.axes[0].images[0]
    shown = np.asarray(picture.get_array())
    assert shown[5, 0] == 0.0
    left, right, near, _ = picture.get_extent()
    half = 0.5 * RADAR.grid.step  # a bin's value belongs to its middle
    assert (left, right) == pytest.approx((RADAR.grid.u_stop - half, RADAR.grid.u_start - half))
    assert near == -0.5 * RADAR.waveform.range_step_m
    # The axis runs as the extent does.
    first, last = figure.axes[0].get_xlim()
    assert first > last


def test_a_missing_contender_is_said_in_its_panel():
    empty = np.full(SHAPE, -40.0)
    figure = image_panels(
        {("das", "full"): empty, ("unet", "thin"): empty},
        empty,
        RADAR,
        0,
        "title",
        [(3 * RADAR.waveform.range_step_m, 0.0)],
        0.5,
        {},
    )
    texts = {text.get_text() for axis in figure.axes for text in axis.texts}
    assert texts == {"no das\nfor thin", "no unet\nfor full"}


def test_a_legend_of_many_long_names_stays_within_its_figure():
    figure, _ = panels(1, 1, (4.0, 3.0), "title")
    legend_below(figure, Look((f"unet:a folder of name {n}", "full") for n in range(8)).method_handles())
    figure.draw_without_rendering()
    (legend,) = figure.legends
    box = legend.get_window_extent()
    assert 0.0 <= box.x0 < box.x1 <= figure.bbox.width
    assert len(legend.get_texts()) == 8


def test_a_figure_does_not_name_what_drew_it(tmp_path):
    """That it is the same bytes twice stands in ``test_evaluate.py``."""
    save_figure(panels(1, 2, (3.0, 2.0), "title")[0], tmp_path, "it")
    assert b"matplotlib.org" not in (tmp_path / "it.png").read_bytes()


@pytest.mark.parametrize("shown", [0, 1, 2, None])
def test_as_many_panels_are_shown_as_asked(shown):
    _, axes = panels(1, 2, (3.0, 2.0), "title", shown)
    assert [axis.get_visible() for axis in axes[0]] == [shown is None or place < shown for place in range(2)]


CLOSE, CLOSER = TrialCondition(1.0, 20.0).named, TrialCondition(0.5, 20.0).named
NEAR: dict[str, object] = {"d_max": "2 bins"}


def row(
    method: str, array: str, metric: str, condition: Mapping[str, object], value: float, spread: float = 0.1
) -> MetricRow:
    experiment = "resolution" if metric.startswith("probability") else "detection"
    return MetricRow(experiment, method, array, metric, condition, value, value - spread, value + spread, 9)


ROWS = [
    row("das", "sparse6", "one-to-one F1", NEAR, 0.25),
    row("das", "sparse6", "one-to-one F1", {"d_max": "4 bins"}, 0.95),
    row("unet", "sparse6", "one-to-one F1", NEAR, 0.75, math.nan),
    row("unet", "sparse6", "average precision", {}, 0.5, 0.125),
    row("unet", "sparse6", "detection probability", {"false alarms": "1 a frame"}, 0.1),
    row("unet", "sparse6", "detection probability", {"false alarms": "10 a frame"}, 0.2),
    row("truth", "sparse6", "average precision", {}, 1.0, 0.0),
    row("unet", "sparse4", "one-to-one F1", NEAR, math.nan),
    row("das", "sparse6", "probability of resolution", CLOSE, 0.5),
    row("das", "sparse6", "probability of resolution", {**CLOSE, "phase": "0-60 deg"}, 0.4),
    row("ml", "sparse6", "probability of resolution", CLOSER, 0.6),
    row("iaa", "sparse4", "bias [bins]", {"snr": "20 dB"}, 1.0),
    row("ml", "reference", "angle 1 [deg]", {"elements": "all"}, 1.0),
    row("das", "sparse6", "bias [bins]", {"snr": "20 dB"}, 7.0),
]
SECONDS = {("das", "sparse6"): 0.0123, ("unet", "sparse6"): 1.5, ("unet", "sparse4"): 1.4}
PARAMETERS = {("das", "sparse6"): 0, ("unet", "sparse6"): 1612123, ("unet", "sparse4"): 1612123}


def tables() -> dict[str, list[list[str]]]:
    text = summary(metrics_table(ROWS, SECONDS, PARAMETERS), SUMMARY_COLUMNS)
    parts = [part.splitlines() for part in text.split("\n\n")]
    cells = [[[cell.strip() for cell in line.strip("|").split("|")] for line in part] for part in parts]
    return {part[0][0]: part for part in cells}


def test_a_line_for_each_method_with_the_columns_that_ran():
    head, _, das, unet, truth, ml = tables()["sparse6"]
    assert head == [
        "sparse6", "AP", "P(detect) at 10 FA", "F1", "P(resolve) 1 RL", "0.5 RL", "s an image", "parameters",
    ]  # fmt: skip
    assert das == ["das", "", "", "0.25 (0.15 to 0.35)", "0.50 (0.40 to 0.60)", "", "0.0123", ""]
    assert unet == ["unet", "0.50 (0.38 to 0.62)", "0.20 (0.10 to 0.30)", "0.75", "", "", "1.5", "1 612 123"]
    # The ceilings are no methods of the evaluation: they have no time.
    assert truth == ["truth", "1.00 (1.00 to 1.00)", "", "", "", "", "", ""]
    assert ml == ["ml", "", "", "", "", "0.60 (0.50 to 0.70)", "", ""]


def test_what_is_undefined_is_blank_and_other_numbers_make_no_line():
    head, _, *lines = tables()["sparse4"]
    assert head == ["sparse4", "F1", "s an image", "parameters"]
    assert lines == [["unet", "", "1.4", "1 612 123"]]
    assert "reference" not in tables()


def test_with_none_of_its_experiments_it_is_a_sentence():
    text = summary(
        metrics_table([row("iaa", "sparse4", "bias [bins]", {"snr": "20 dB"}, 1.0)], {("iaa", "sparse4"): 1.0}, {}),
        SUMMARY_COLUMNS,
    )
    assert text == "Nothing to sum up: none of detection, resolution, noise-only was run.\n"


def test_a_name_is_no_markup() -> None:
    hostile = [row("unet:<b>|x\x1b[31m", "a|<script>", "one-to-one F1", NEAR, 0.75)]
    text = summary(metrics_table(hostile, {("unet:<b>|x\x1b[31m", "a|<script>"): 1.0}, {}), SUMMARY_COLUMNS)
    assert "| a\\|&lt;script&gt; |" in text
    assert "| unet:&lt;b&gt;\\|x\\x1b[31m |" in text
