"""What is said of an order's inputs as they are made ready."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from datafactory.api.asking import load_scene, materials_of, order_of
from datafactory.api.options import OrderOptions
from datafactory.run.preparation import prepare
from datafactory.scenes.scene import Scene
from shared.physics.errors import InputError
from shared.radar import Radar

TINY = Path(__file__).parents[3] / "scenes" / "tiny.usda"
MAP = '[map]\n"bricks" = "glass"\n"brick" = "glass"\n"M_42" = "glass"\n'


def said_of(radar: Radar, materials: Path | None = None) -> list[str]:
    said = list[str]()
    prepare(order_of(OrderOptions(TINY, radar=radar, frames=1)), materials_of(materials), said.append)
    return said


@pytest.mark.parametrize(("carrier_hz", "outside"), [(77e9, ""), (24e9, "(76 to 81 GHz)"), (97e9, "(76 to 81 GHz)")])
def test_materials_beyond_the_range_of_their_source_are_named(carrier_hz: float, outside: str) -> None:
    radar = Radar()
    radar = radar.model_copy(update={"waveform": radar.waveform.model_copy(update={"carrier_hz": carrier_hz})})
    said = [line for line in said_of(radar) if "the sources of these materials do not hold" in line]
    assert len(said) == bool(outside)
    assert all(line.startswith(f"tiny: at {carrier_hz / 1e9 + 0.5:g} GHz") and outside in line for line in said)


def test_names_of_map_that_no_scene_has_are_said(tmp_path: Path) -> None:
    (tmp_path / "materials.toml").write_text(MAP, encoding="utf-8")
    line = "--materials: no material of the scenes has these names of [map]: bricks, M_42; did you mean 'brick'?"
    assert line in said_of(Radar(), tmp_path / "materials.toml")
    assert not any("[map]" in line for line in said_of(Radar()))


def test_two_scenes_of_one_name_are_refused(tmp_path: Path) -> None:
    """Frames name their scene: those of the one would be taken for those of the other."""
    here, there = tmp_path / "one" / "tiny.usda", tmp_path / "other" / "tiny.usda"
    for file in (here, there):
        file.parent.mkdir()
        shutil.copy(TINY, file)

    def names(*scenes: Path | Scene) -> list[str]:
        order = order_of(OrderOptions(list(scenes), radar=Radar(), frames=2))
        return [scene.name for scene in prepare(order, materials_of(None)).job.scenes]

    assert names(here, here, there) == ["tiny"] * 3  # of the same contents
    assert names(here, load_scene(here, populate="poles=1")) == ["tiny"] * 2
    there.write_text(there.read_text(encoding="utf-8").replace('"brick"', '"glass"'), encoding="utf-8")
    with pytest.raises(InputError, match=r"--scene: .*one/tiny.usda and .*other/tiny.usda have one name, 'tiny'"):
        names(here, there)
