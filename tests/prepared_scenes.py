"""Scenes made ready for the chain, with dealt frames at given poses."""

from __future__ import annotations

from pathlib import Path

from datafactory.frame.deal import Deal
from datafactory.frame.prepared import PreparedScene, Sample
from datafactory.paths.merged_scene import merge_scene
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose
from datafactory.scenes.readers.open import open_scene

SCENES = Path(__file__).resolve().parents[1] / "scenes"
EFFECT_SCENES = SCENES / "effects"
AT_ORIGIN = Pose((0.0, 0.0, 0.5))


def prepared_scene(path: Path) -> PreparedScene:
    """The scene of a file."""
    scene = open_scene(str(path))
    materials = load_materials().map_materials([item.material for item in scene.objects])
    return PreparedScene(scene.name, scene.content_hash(), merge_scene(scene, materials), materials)


def a_sample(name: str, *poses: Pose, seed: int = 0) -> Sample:
    """Frames of a scene of ``scenes/effects`` at these poses, half a metre above its origin without any."""
    deal = Deal(seed=seed, scenes=1, poses=poses or (AT_ORIGIN,))
    return Sample(prepared_scene(EFFECT_SCENES / f"{name}.usda"), tuple(map(deal.frame, range(len(deal)))))
