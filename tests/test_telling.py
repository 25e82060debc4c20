"""What the values that a user handles say of themselves: one to five lines, the same in a notebook."""

from __future__ import annotations

from collections.abc import Callable
from html import unescape
from pathlib import Path

import pytest
from small_dataset import make_dataset, make_frame

from datafactory import load_scene
from datafactory.api.planning import ScenePlan
from datafactory.effects.plan import Decision, EffectPlan
from shared.physics.errors import Told
from shared.radar import Radar
from trainer import RadarDataset, load_imager, pretrained_run
from trainer.data.dataset import Example

SCENES = Path(__file__).resolve().parents[1] / "scenes"
DECISIONS = (Decision("specular", True, "", "", -3.0), Decision("refraction", False, "", "", -90.0))


VALUES: dict[str, tuple[Callable[[], Told], list[str]]] = {
    "Radar": (Radar, ["77 GHz", "128 chirps of 1024", "3 TX x 16 RX, 48", "630 x 450", "0.15 m", "94 mm wide"]),
    "Array": (lambda: Radar().array, ["3 TX x 16 RX, 48 virtual channels, 94 mm wide, 0 mm high"]),
    "Scene": (lambda: load_scene(SCENES / "street.usda"),
              ["scene street", "310 objects", "13 point targets", "40 of them move", "warned: 13"]),
    "Plan": (lambda: ScenePlan(EffectPlan("street", -30.0, DECISIONS, {}), 8, {"specular": 0.25}, None),
             ["on: specular", "off: refraction", "8 frames", "-30 dB", "0.25 processor seconds"]),
    "Run": (lambda: load_imager(pretrained_run("sparse6"))[0],
            ["unrolled", "sparse6", "RX 0, 1, 6, 10, 13, 15", "681 train"]),
    "Frame": (lambda: make_frame(2),
              ["frame 2: points", "(1.0, -2.0, 0.1) m", "10.0 m/s", "2 targets, 2 boxes", "image [6, 20]"]),
}  # fmt: skip


@pytest.mark.parametrize("name", VALUES)
def test_a_value_says_what_it_is_in_five_lines(name: str) -> None:
    make, facts = VALUES[name]
    value = make()
    told = str(value)
    assert 1 <= len(told.splitlines()) <= 5
    assert max(map(len, told.splitlines())) <= 200
    assert [fact for fact in facts if fact not in told] == []
    shown = value._repr_html_()
    assert unescape(shown.removeprefix("<pre>").removesuffix("</pre>")) == told
    assert repr(value) != told


def test_an_example_says_its_shapes(tmp_path: Path) -> None:
    example = RadarDataset(make_dataset(tmp_path / "data"), "train")[1]
    assert isinstance(example, Example)
    assert str(example).splitlines() == [
        "frame 1: scene, street é",
        "input [3, 6, 8] (peak, range, channel), image [6, 20] (range, u)",
    ]
    assert example._repr_html_() == f"<pre>{example}</pre>"


def test_what_a_scene_is_called_is_no_markup() -> None:
    """A name from a file stands in a notebook's page as it is."""
    shown = ScenePlan(EffectPlan("<b>x", -30.0, DECISIONS, {}), 1, {}, None)._repr_html_()
    assert "&lt;b&gt;x" in shown
    assert "<b>" not in shown
