"""Where drawn poses stand and what they see, by rays into the triangles: ``tests/benchmarks/drawn_poses.py SCENE ...``.

For each scene, of 200 poses dealt as a run deals them:

- *blocked*: more than a tenth of a fan of rays over the field of view ends within 1 m.
- *wall*: no ray of the fan reaches 15 m.
- *nothing*: no ray of the fan meets anything within 95 m.
- *covered*: straight up something is met, as in a building.
- *shared*: of the places that rays of validation and test poses meet, the share that lies within 1 m of a place that a
  training pose meets.
"""

from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from datafactory.frame.draws import frame_seed, generator, split_of
from datafactory.paths.merged_scene import MergedScene, merge_scene
from datafactory.scenes.ground import free_ground
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose, sample_pose
from datafactory.scenes.readers.open import open_scene
from datafactory.view.subject import RayCaster

FIELD_DEG = 58.0
RAYS = 59
NEAR_M, WALL_M, SIGHT_M = 1.0, 15.0, 95.0
BLOCKED_SHARE = 0.1
SHARED_M = 1.0

Real = NDArray[np.float64]


def fan() -> Real:
    """[RAYS, 3] level unit vectors over the field of view, in the radar frame."""
    angle = np.radians(np.linspace(-FIELD_DEG, FIELD_DEG, RAYS))
    return np.stack([np.cos(angle), np.sin(angle), np.zeros(RAYS)], axis=1)


def distances(merged: MergedScene, pose: Pose) -> tuple[Real, bool]:
    """[RAYS] free paths of a pose's fan [m], and whether anything is above it."""
    directions = np.concatenate([fan(), [[0.0, 0.0, 1.0]]])
    met = RayCaster(merged, pose).cast(np.zeros_like(directions), directions).distance
    return met[:-1], bool(np.isfinite(met[-1]))


def measured(source: str, poses: int, seed: int) -> dict[str, float]:
    """The shares of one scene."""
    scene = open_scene(source)
    ground = free_ground(scene)
    table = load_materials()
    merged = merge_scene(scene, table.map_materials([item.material for item in scene.objects], scene.stated))
    blocked = wall = nothing = covered = 0
    places: dict[str, list[Real]] = {"train": [], "other": []}
    for frame_id in range(poses):
        split = split_of(frame_id)
        pose = sample_pose(ground, split, generator(frame_seed(seed, frame_id), "pose"))
        free, above = distances(merged, pose)
        blocked += bool(np.mean(free < NEAR_M) > BLOCKED_SHARE)
        wall += bool(free.max() < WALL_M)
        nothing += bool(free.min() > SIGHT_M)
        covered += above
        met = free < SIGHT_M
        world = np.asarray(pose.position) + (fan() * np.where(met, free, 0.0)[:, None]) @ pose.rotation().T
        places["train" if split == "train" else "other"].append(world[met])
    train, other = (np.concatenate(places[name]) for name in ("train", "other"))
    shared = np.isfinite(cKDTree(train).query(other, distance_upper_bound=SHARED_M)[0]).mean() if len(other) else 0.0
    shares = {"blocked": blocked, "wall": wall, "nothing": nothing, "covered": covered}
    return {name: count / poses for name, count in shares.items()} | {"shared": float(shared)}


def main(
    scenes: Annotated[list[str], typer.Argument(help="Scenes, as --scene takes them.")],
    poses: int = 200,
    seed: int = 0,
) -> None:
    """One line a scene."""
    for source in scenes:
        shares = measured(source, poses, seed)
        print(source, ", ".join(f"{name} {100.0 * share:.1f} %" for name, share in shares.items()))


if __name__ == "__main__":
    typer.run(main)
