"""The page of ``datafactory view`` in a real browser: it draws, says what the pointer meets, and asks for nothing."""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import GRAPHICS_LIBRARY, WEBGL_ARGUMENTS, installed_browser
from matplotlib.image import imread
from prepared_scenes import TINY

from datafactory.api.viewing import view
from datafactory.scenes.poses import Pose
from datafactory.view.subject import DIRECT, KINDS, material_colour

BROWSER = installed_browser()
if BROWSER is None:
    pytest.skip("there is no Chromium or Chrome; make browser fetches one", allow_module_level=True)
if not (Path(BROWSER.program).with_name(GRAPHICS_LIBRARY).is_file() or not BROWSER.environment):
    pytest.skip("this Chromium draws no WebGL; make browser fetches one that does", allow_module_level=True)
playwright = pytest.importorskip("playwright.sync_api", reason="there is no playwright; make browser installs it")

WAIT_MS = 120_000
"""Every picture is drawn by the processor."""
WIDTH, HEIGHT = 640, 400


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A page that says that it is ready; afterwards: no error, no other request."""
    assert BROWSER is not None
    (path,) = view(
        TINY, tmp_path_factory.mktemp("page") / "tiny.html", rays=2000,
        poses=[Pose((0.0, 0.0, 0.5))],
    )  # fmt: skip
    complaints: list[str] = []
    requests: list[str] = []
    with playwright.sync_playwright() as driver:
        browser = BROWSER.launched(driver, ["--host-resolver-rules=MAP * ~NOTFOUND", *WEBGL_ARGUMENTS], WAIT_MS)
        tab = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
        tab.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
        tab.on("pageerror", lambda error: complaints.append(str(error)))
        tab.on("request", lambda request: requests.append(request.url))
        tab.goto(path.as_uri())
        tab.wait_for_selector("body[data-ready=yes]", timeout=WAIT_MS, state="attached")
        yield tab
        browser.close()
    assert complaints == []
    assert [url for url in requests if not url.startswith("data:")] == [path.as_uri()]


def drawn(page: Any) -> np.ndarray:
    """[HEIGHT, WIDTH, 3] what stands on the screen, 0 to 255."""
    return np.rint(255 * imread(io.BytesIO(page.screenshot(timeout=WAIT_MS)))[..., :3])


def test_what_stands_in_the_legend_is_there_and_can_be_hidden(page: Any) -> None:
    lines = page.locator("#legend label").all_inner_texts()
    assert any(line.startswith(f"{DIRECT}: ") for line in lines)
    assert any(line.startswith("velocity, one second long: ") for line in lines)
    assert {"asphalt", "brick", "concrete"} <= set(lines)
    paths = int(page.evaluate("document.body.dataset.paths"))
    assert paths == sum(int(line.split(": ")[1].split(" of ")[0]) for line in lines if line.split(": ")[0] in KINDS)
    before = drawn(page)
    for box in page.locator("#legend input").all():
        box.uncheck()
    empty = drawn(page)
    right = slice(None), slice(260, None)  # beside the legend
    assert (
        len(np.unique(empty[right].reshape(-1, 3), axis=0)) < len(np.unique(before[right].reshape(-1, 3), axis=0)) / 4
    )
    for box in page.locator("#legend input").all():
        box.check()
    np.testing.assert_allclose(drawn(page)[right], before[right], atol=3.0)


def test_the_ground_has_its_colour_and_a_path_says_what_it_is(page: Any) -> None:
    page.get_by_role("button", name="above").click()
    picture = drawn(page)[:, 260:].reshape(-1, 3)
    asphalt = np.array(material_colour("asphalt"), float)
    share = picture / np.maximum(picture.sum(axis=1, keepdims=True), 1.0)
    assert (np.abs(share - asphalt / asphalt.sum()).max(axis=1) < 0.02).mean() > 0.2
    page.get_by_role("button", name="behind").click()
    told = page.evaluate(
        """() => {
            const line = scene.children.find((child) => child.isLine && child.userData.text);
            const array = line.geometry.attributes.position.array;
            const place = new THREE.Vector3(array[3], array[4], array[5]).multiplyScalar(0.7).project(camera);
            const [x, y] = [innerWidth * (place.x + 1) / 2, innerHeight * (1 - place.y) / 2];
            const at = {clientX: x, clientY: y, bubbles: true};
            renderer.domElement.dispatchEvent(new PointerEvent("pointermove", at));
            return document.getElementById("told").textContent;
        }"""
    )
    assert any(told.startswith(f"{kind}, ") for kind in KINDS), told
    assert " dBW, " in told
