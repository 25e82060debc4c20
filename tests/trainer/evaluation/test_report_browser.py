"""The page of an evaluation in a real browser: what stands on the screen, and what choices and clicks do to it.

Every test also fails where the page logs an error or a warning, or asks for anything but its own file.
"""

import base64
import io

import numpy as np
import pytest
from browser import installed_browser
from matplotlib import colormaps
from matplotlib.image import imread
from PIL import Image
from tiny_radar import RADAR

from shared.radar import Radar
from trainer.evaluation.report.page import ReportFrame, report_page
from trainer.evaluation.report.tables import MetricRow, metrics_table

BROWSER = installed_browser()
if BROWSER is None:
    pytest.skip("there is no Chromium or Chrome; make browser fetches one", allow_module_level=True)
playwright = pytest.importorskip("playwright.sync_api", reason="there is no playwright; make browser installs it")

HOSTILE = "hall </script><!--<script><b> & \\u003c, frame 1"
ROWS, COLUMNS = RADAR.waveform.range_bins, RADAR.grid.bins
LEFT, RIGHT, TOP, BOTTOM = 46, 8, 22, 34
"""The canvases' margins [pixels], as in drawing.js."""
FULL_SCALE = np.rint(255 * np.array(colormaps["magma"](255)[:3]))
"""Colour of 0 dB."""
CURVES = {"left": (0, 114, 178), "right": (213, 94, 0), "truth": (0, 0, 0)}
WAIT_MS = 30_000

# One bin of 0 dB an image, all else at the floor: [range bin, u bin].
FIRST = {"das full": (7, 5), "iaa full": (7, 11), "truth": (7, 15)}
SECOND = {"das full": (3, 2), "iaa full": (3, 8), "truth": (3, 17)}

DOPPLER = (9, 3)
"""Range bin and Doppler cell of 0 dB."""


def camera():
    buffer = io.BytesIO()
    Image.new("RGB", (40, 20), (10, 200, 30)).save(buffer, format="jpeg")
    return buffer.getvalue()


CAMERA = camera()


def frame(name, spots):
    images = {}
    for image, (row, column) in spots.items():
        images[image] = np.zeros((ROWS, COLUMNS), np.uint8)
        images[image][row, column] = 255
    doppler = np.zeros((ROWS, RADAR.waveform.chirps), np.uint8)
    doppler[DOPPLER] = 255
    return ReportFrame(name, spots["truth"][0], images, ("range-Doppler map", doppler), CAMERA)


def html(frames, radar=RADAR):
    rows = [
        MetricRow("detection", method, "full", "precision", {"d_max": "2 bins"}, value, 0.125, 0.5, 9)
        for method, value in (("das", 0.25), ("iaa", 0.375))
    ]
    return report_page("A title", "A summary", radar, frames, [], metrics_table(rows, {}, {}))


@pytest.fixture(scope="module")
def chromium():
    assert BROWSER is not None
    playwright.expect.set_options(timeout=WAIT_MS)
    with playwright.sync_playwright() as driver:
        browser = BROWSER.launched(driver, ["--disable-gpu", "--host-resolver-rules=MAP * ~NOTFOUND"], WAIT_MS)
        yield browser
        browser.close()


@pytest.fixture
def opened(chromium, tmp_path):
    """Opens a page from disk and waits until it says that it is ready; afterwards: no error, no other request."""
    complaints, requests = [], []
    tab = chromium.new_page(viewport={"width": 1320, "height": 1000})
    tab.on("console", lambda message: complaints.append(message.text))
    tab.on("pageerror", lambda error: complaints.append(str(error)))
    tab.on("request", lambda request: requests.append(request.url))
    path = tmp_path / "report.html"

    def open_page(text):
        path.write_text(text)
        tab.goto(path.as_uri())
        playwright.expect(tab.locator("body")).to_have_attribute("data-ready", "yes")
        return tab

    yield open_page
    tab.close()
    assert complaints == []
    assert requests == [path.as_uri()]


@pytest.fixture
def page(opened):
    return opened(html([frame(HOSTILE, FIRST), frame("hall, frame 2", SECOND)]))


def canvas(page, name):
    """[height, width, 3] colours of the canvas of this id, on the page's white."""
    url = page.evaluate("(name) => document.getElementById(name).toDataURL('image/png')", name)
    picture = imread(io.BytesIO(base64.b64decode(url.split(",")[1])))
    return np.rint(255 * (1 - picture[..., 3:] * (1 - picture[..., :3])))


def full_scale_at(page, name):
    """Middle of the one bin of 0 dB in an image, which nothing covers: x, y [pixels]."""
    y, x = np.nonzero((canvas(page, name) == FULL_SCALE).all(axis=-1))
    assert x.size
    assert x.size == (np.ptp(x) + 1) * (np.ptp(y) + 1)
    return x.mean() + 0.5, y.mean() + 0.5


def bin_at(row, column, width=400, height=460):
    """Where the middle of a bin belongs: u rises to the left, range upwards."""
    across, up = (column + 0.5) / COLUMNS, (row + 0.5) / ROWS
    return LEFT + (width - LEFT - RIGHT) * (1 - across), TOP + (height - TOP - BOTTOM) * (1 - up)


def assert_cut_peaks(page, side, column):
    """The curve of this side is highest at this u bin, at 0 dB."""
    picture = canvas(page, "cut")[TOP - 2 : -BOTTOM, LEFT:-RIGHT]
    y, x = np.nonzero(np.abs(picture - CURVES[side]).max(axis=-1) < 60)
    assert x.size
    assert y.min() < 10
    expected = picture.shape[1] * (1 - column / COLUMNS)
    assert abs(x[y == y.min()].mean() + 0.5 - expected) < 3


def assert_reads(page, spots):
    """The line below the cut names each image's highest level in the cut's range bin."""
    reading = page.locator("#reading")
    for name, (_, column) in spots.items():
        playwright.expect(reading).to_contain_text(f"{name}: highest 0.0 dB at u = {RADAR.grid.u[column]:.3f}")


def assert_shows(page, left, right, truth, spots):
    assert_reads(page, {name: spots[name] for name in (left, right, truth)})
    for side, name in (("left", left), ("right", right), ("truth", truth)):
        np.testing.assert_allclose(full_scale_at(page, f"image-{side}"), bin_at(*spots[name]), atol=1.0)
        assert_cut_peaks(page, side, spots[name][1])


def test_the_page_opens_on_its_first_frame(page):
    assert page.locator("#frame option").all_inner_texts() == [HOSTILE, "hall, frame 2"]
    assert_shows(page, "das full", "iaa full", "truth", FIRST)
    assert page.locator("#row-text").inner_text() == f"7 ({7 * RADAR.waveform.range_step_m:.2f} m)"


def test_another_method_changes_its_image_and_curve_and_stays_with_the_next_frame(page):
    page.select_option("#left", "iaa full")
    playwright.expect(page.locator("#reading")).not_to_contain_text("das full")
    np.testing.assert_allclose(full_scale_at(page, "image-left"), bin_at(*FIRST["iaa full"]), atol=1.0)
    page.select_option("#right", "das full")
    assert_shows(page, "iaa full", "das full", "truth", FIRST)
    page.select_option("#frame", label="hall, frame 2")
    assert_shows(page, "iaa full", "das full", "truth", SECOND)
    assert page.locator("#row-text").inner_text().startswith("3 (")


def test_a_click_into_an_image_moves_the_cut(page):
    reading, truth = page.locator("#reading"), page.locator("#image-truth")
    x, y = bin_at(10, 4)
    truth.click(position={"x": x, "y": y})
    playwright.expect(page.locator("#row-text")).to_have_text(f"10 ({10 * RADAR.waveform.range_step_m:.2f} m)")
    playwright.expect(reading).to_contain_text("truth: highest -60.0 dB")
    assert (canvas(page, "cut")[:200, LEFT:-RIGHT].min(axis=-1)[20:] > 200).all()  # no curve leaves the floor
    # The image itself stays as it was.
    np.testing.assert_allclose(full_scale_at(page, "image-truth"), bin_at(*FIRST["truth"]), atol=1.0)
    x, y = bin_at(7, 0)
    truth.click(position={"x": x, "y": y})
    assert_shows(page, "das full", "iaa full", "truth", FIRST)


def test_the_sliders_move_the_cut_and_the_floor(page):
    page.locator("#row").fill("11")
    playwright.expect(page.locator("#row-text")).to_contain_text("11 (")
    playwright.expect(page.locator("#reading")).to_contain_text("truth: highest -60.0 dB")
    before = canvas(page, "cut")
    page.locator("#floor").fill("-20")
    playwright.expect(page.locator("#floor-text")).to_have_text("-20 dB")
    assert (canvas(page, "cut") != before).any()


def test_the_table_is_filtered(page):
    body, count = page.locator("#body tr"), page.locator("#count")
    assert body.locator("td").count() == 2 * 11
    assert count.inner_text() == "2 rows"
    page.select_option("#filter-method", "iaa")
    playwright.expect(count).to_have_text("1 row")
    assert body.locator("td").all_inner_texts()[:6] == [
        "detection",
        "iaa",
        "full",
        "precision",
        "d_max=2 bins",
        "0.3750",
    ]
    page.select_option("#filter-method", "")
    playwright.expect(count).to_have_text("2 rows")


def test_of_two_choices_the_last_is_shown_whichever_decodes_first(page):
    """The second frame's pictures are still to be decoded when the first frame, long decoded, is chosen again."""
    page.evaluate(
        """async () => {
            const choose = (index) => { at("frame").value = index; chooseFrame(); return refresh(); };
            await Promise.all([choose("1"), choose("0")]);
        }"""
    )
    assert_shows(page, "das full", "iaa full", "truth", FIRST)


def test_no_bin_is_lost_where_bins_outnumber_pixels(opened):
    radar = Radar(name="avr-qdm-110")
    truth = np.zeros((radar.waveform.range_bins, radar.grid.bins), np.uint8)
    truth[::5, ::5] = 255
    page = opened(html([ReportFrame("grid", 1, {"das full": np.zeros_like(truth), "truth": truth})], radar))
    drawn = (canvas(page, "image-truth") == FULL_SCALE).all(axis=-1)
    assert truth.shape[0] > drawn.shape[0]
    assert drawn.sum() == (truth == 255).sum()


def test_zero_is_not_called_negative(opened):
    """Labels are pixels: they are caught on their way into the canvas."""
    radar = Radar(name="avr-qdm-110")
    truth = np.zeros((radar.waveform.range_bins, radar.grid.bins), np.uint8)
    page = opened(html([ReportFrame("empty", 1, {"das full": truth, "truth": truth})], radar))
    labels = page.evaluate(
        """async () => {
            const texts = [], draw = CanvasRenderingContext2D.prototype.fillText;
            CanvasRenderingContext2D.prototype.fillText = function (text, ...place) {
              texts.push(text);
              return draw.call(this, text, ...place);
            };
            await refresh();
            return texts;
        }"""
    )
    assert "0.0" in labels
    assert "-0.0" not in labels


def test_a_page_without_frames_still_has_its_table(opened):
    page = opened(html([]))
    assert not page.locator("#look").is_visible()
    assert page.locator("#count").inner_text() == "2 rows"


def test_the_pointer_reads_the_values_of_all_images(page):
    pointer = page.locator("#pointer")
    row, column = FIRST["iaa full"]
    x, y = bin_at(row, column)
    page.locator("#image-left").hover(position={"x": x, "y": y})
    u, range_m = RADAR.grid.u[column], row * RADAR.waveform.range_step_m
    expected = (
        f"range {range_m:.2f} m, u {u:.3f} (azimuth {np.degrees(np.arcsin(u)):.1f}\N{DEGREE SIGN}, "
        f"x {range_m * np.sqrt(1 - u * u):.2f} m, y {range_m * u:.2f} m): "
        "das full -60.0 dB; iaa full 0.0 dB; truth -60.0 dB"
    )
    playwright.expect(pointer).to_have_text(expected)
    # The same bin is marked in every image.
    for side in ("left", "right", "truth"):
        box = page.locator(f"#image-{side}").bounding_box()
        mark = page.locator(f"#image-{side} + i").bounding_box()
        assert mark["x"] + mark["width"] / 2 - box["x"] == pytest.approx(x, abs=1.0)
        assert mark["y"] + mark["height"] / 2 - box["y"] == pytest.approx(y, abs=1.0)
    page.locator("h1").hover()
    playwright.expect(pointer).to_have_text("")
    assert not page.locator("#image-left + i").is_visible()


def test_from_above_an_echo_stands_where_it_is(page):
    page.locator("#row").fill("1")  # the cut's arc elsewhere
    page.select_option("#view", "above")
    playwright.expect(page.locator("#row-text")).to_contain_text("1 (")
    far = RADAR.waveform.range_bins * RADAR.waveform.range_step_m
    left, right = np.clip(RADAR.grid.u_start + RADAR.grid.step * np.array([COLUMNS, 0]), -1.0, 1.0)
    scale = min((400 - LEFT - RIGHT) / (far * (left - right)), (460 - TOP - BOTTOM) / far)
    for side, name in (("left", "das full"), ("right", "iaa full"), ("truth", "truth")):
        row, column = FIRST[name]
        range_m, u = row * RADAR.waveform.range_step_m, RADAR.grid.u[column]
        lit = np.argwhere((canvas(page, f"image-{side}") == FULL_SCALE).all(axis=-1)) + 0.5
        expected = TOP + scale * (far - range_m * np.sqrt(1 - u * u)), LEFT + scale * (far * left - range_m * u)
        # A bin covers many pixels, a piece of a ring: one of them is its middle.
        assert np.abs(lit - expected).max(axis=1).min() <= 1.0
        size = np.ptp(lit, axis=0) + 1
        assert (
            size <= scale * 1.5 * np.array([RADAR.waveform.range_step_m + 1.0, 1.0 + range_m * RADAR.grid.step])
        ).all()
    x = LEFT + scale * (far * left - 5 * RADAR.waveform.range_step_m * RADAR.grid.u[2])
    y = TOP + scale * (far - 5 * RADAR.waveform.range_step_m * np.sqrt(1 - RADAR.grid.u[2] ** 2))
    page.locator("#image-truth").click(position={"x": x, "y": y})
    playwright.expect(page.locator("#row-text")).to_contain_text("5 (")


def test_a_nearer_farthest_range_is_drawn_larger(page):
    page.locator("#far").fill("8")
    playwright.expect(page.locator("#far-text")).to_have_text(f"{8 * RADAR.waveform.range_step_m:.1f} m")
    across, up = (FIRST["truth"][1] + 0.5) / COLUMNS, 7.5 / 8
    expected = LEFT + (400 - LEFT - RIGHT) * (1 - across), TOP + (460 - TOP - BOTTOM) * (1 - up)
    np.testing.assert_allclose(full_scale_at(page, "image-truth"), expected, atol=1.0)


def test_the_range_doppler_map_stands_below_and_reads_its_velocity(page):
    row, cell = DOPPLER
    chirps, waveform = RADAR.waveform.chirps, RADAR.waveform
    expected = (
        LEFT + (400 - LEFT - RIGHT) * (cell + 0.5) / chirps,
        TOP + (460 - TOP - BOTTOM) * (1 - (row + 0.5) / ROWS),
    )
    np.testing.assert_allclose(full_scale_at(page, "doppler"), expected, atol=1.0)
    page.locator("#doppler").hover(position={"x": expected[0], "y": expected[1]})
    text = f"range {row * waveform.range_step_m:.2f} m, velocity {waveform.velocities_mps[cell]:.2f} m/s: 0.0 dB"
    playwright.expect(page.locator("#pointer")).to_have_text(text)
    page.locator("#doppler").click(position={"x": expected[0], "y": expected[1]})
    playwright.expect(page.locator("#row-text")).to_contain_text(f"{row} (")


def test_the_camera_picture_is_shown_where_there_is_one(opened):
    bare = frame("without", SECOND)
    page = opened(html([frame("with", FIRST), ReportFrame(bare.name, bare.row, bare.images)]))
    size = page.evaluate("async () => { const p = at('camera-picture'); await p.decode(); return p.naturalWidth; }")
    assert size == 40
    page.select_option("#frame", label="without")
    playwright.expect(page.locator("#camera")).not_to_be_visible()
    assert not page.locator("#doppler").is_visible()


def test_of_many_frames_one_is_parsed_at_first(opened):
    page = opened(html([frame(f"hall, frame {number}", FIRST) for number in range(50)]))
    assert page.evaluate("() => [data.frames.length, parsed.size]") == [50, 1]
