"""Scenes made ready for the chain."""

from pathlib import Path

from manual import ROOT

from datafactory.frame.deal import PreparedScene
from datafactory.paths.merged_scene import merge_scene
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.readers.open import open_scene

SCENES = ROOT / "scenes"
TINY, STREET = SCENES / "tiny.usda", SCENES / "street.usda"
EFFECT_SCENES = SCENES / "effects"


def prepared_scene(path: Path) -> PreparedScene:
    """The scene of a file."""
    scene = open_scene(str(path))
    materials = load_materials().map_materials([item.material for item in scene.objects], scene.stated)
    return PreparedScene(scene.name, scene.content_hash(), merge_scene(scene, materials), materials)
