"""The effect scenes: reproducible bytes, and read as they were meant.

That each shows what ``expected.json`` says of it is proven by tracing it, in ``test_effect_plans.py``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from prepared_scenes import EFFECT_SCENES as EFFECTS

from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene

EXPECTED: dict[str, Any] = json.loads((Path(__file__).parent / "expected.json").read_text(encoding="utf-8"))["scenes"]


@pytest.fixture(scope="module")
def make_effects() -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(EFFECTS.parent))
        import make_effects

        yield make_effects


def scene_of(name: str) -> Scene:
    return open_scene(str(EFFECTS / f"{name}.usda"))


def test_the_committed_files_are_what_the_script_writes(make_effects: ModuleType, tmp_path: Path) -> None:
    make_effects.write_effects(tmp_path)
    written = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    committed = {path.name: path.read_bytes() for path in EFFECTS.iterdir()}
    assert written.keys() == committed.keys()
    assert [name for name in written if written[name] != committed[name]] == []


def test_the_scenes_are_those_written_down(make_effects: ModuleType) -> None:
    shows = {name: said["shows"] for name, said in EXPECTED.items()}
    assert list(shows.items()) == [(scene.name, scene.shows) for scene in make_effects.scenes()]


@pytest.mark.parametrize("name", EXPECTED)
def test_a_scene_opens_as_it_was_meant(name: str) -> None:
    """Without a remark but that pictures of point targets are not traced, its materials by their own names."""
    scene, table = scene_of(name), load_materials()
    assert {table.lookup(item.material)[1] for item in scene.objects} <= {"name"}
    pictures = [warning for warning in scene.warnings if "a point target (radar:rcs_dbsm) stands for them" in warning]
    assert list(scene.warnings) == pictures
    assert len(pictures) == (name in ("trihedral", "target_behind_pane", "moving_car"))
