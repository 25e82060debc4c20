"""Scenes to multipath to 77 GHz FMCW radar data in Parquet shards.

The functions here are those behind the commands of the same names. They are imported when they are first used, so that
``import datafactory`` loads nothing that computes. What this module names is stable; other modules may change.
"""

from typing import TYPE_CHECKING

from shared.processes.lazy import lazy_names

if TYPE_CHECKING:
    from datafactory.api.asking import load_scene as load_scene
    from datafactory.api.making import Converted as Converted
    from datafactory.api.making import convert as convert
    from datafactory.api.making import merge as merge
    from datafactory.api.making import render as render
    from datafactory.api.making import trace as trace
    from datafactory.api.planning import ScenePlan as ScenePlan
    from datafactory.api.planning import plan as plan
    from datafactory.frame.points import read_targets as read_targets
    from datafactory.paths.storage import read_paths as read_paths
    from datafactory.run.pipeline import Report as Report
    from datafactory.run.portions import RunFailed as RunFailed
    from datafactory.scenes.poses import Pose as Pose
    from datafactory.scenes.poses import read_poses as read_poses
    from datafactory.scenes.scene import Scene as Scene
    from shared.physics.errors import InputError as InputError
    from shared.radar import Radar as Radar
    from shared.radar import load_radar as load_radar

__version__: str
_MODULES = {
    "datafactory.api.asking": ("load_scene",),
    "datafactory.api.making": ("Converted", "convert", "merge", "render", "trace"),
    "datafactory.api.planning": ("ScenePlan", "plan"),
    "datafactory.frame.points": ("read_targets",),
    "datafactory.paths.storage": ("read_paths",),
    "datafactory.run.pipeline": ("Report",),
    "datafactory.run.portions": ("RunFailed",),
    "datafactory.scenes.poses": ("Pose", "read_poses"),
    "datafactory.scenes.scene": ("Scene",),
    "shared.physics.errors": ("InputError",),
    "shared.radar": ("Radar", "load_radar"),
}
__all__ = sorted(name for names in _MODULES.values() for name in names)
__getattr__, __dir__ = lazy_names(__name__, _MODULES)
