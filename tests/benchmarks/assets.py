"""Cross sections of the shipped vehicles and furniture by aspect: the last column of docs/notes/assets.md.

python tests/benchmarks/assets.py            at 20 m, the sensor 0.5 m high, no ground
"""

import numpy as np

from datafactory.paths.backend import select_variant, set_threads
from datafactory.paths.merged_scene import merge_scene
from datafactory.paths.rays import RayFan
from datafactory.paths.solver import TraceSettings
from datafactory.paths.trace import trace
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose
from datafactory.scenes.readers.open import open_scene
from shared.radar import load_radar

ASSETS = ("saloon", "hatchback", "suv", "van", "truck", "bus", "lamp", "traffic_light", "bollard", "sign_round", "bin")
ASPECTS_DEG = np.arange(0.0, 360.0, 15.0)
DISTANCE_M, RAYS = 20.0, 20_000


def cross_sections_dbsm(name: str) -> np.ndarray:
    """[aspects] sum of the powers of all echoes, as a cross section at the asset's middle; 0 is from ahead."""
    scene = open_scene(f"shipped:assets/{name}")
    materials = load_materials().map_materials([item.material for item in scene.objects], scene.stated)
    merged = merge_scene(scene, materials)
    waveform = load_radar("avr-qdm-110").waveform
    found = []
    for aspect in ASPECTS_DEG:
        angle = np.radians(aspect)
        pose = Pose((DISTANCE_M * np.cos(angle), DISTANCE_M * np.sin(angle), 0.5), yaw_deg=aspect + 180.0)
        table = trace(merged, pose, waveform.mid_sweep_hz, TraceSettings(rays=RAYS), RayFan(RAYS), 1)
        power = sum(float((np.abs(part.amplitude) ** 2).sum()) for part in (table.scattered, table.specular))
        section = (4.0 * np.pi) ** 3 * DISTANCE_M**4 * power / waveform.wavelength_m**2
        found.append(10.0 * np.log10(max(section, 1e-9)))
    return np.array(found)


if __name__ == "__main__":
    select_variant()
    set_threads(1)
    for each in ASSETS:
        levels = cross_sections_dbsm(each)
        print(
            f"{each:14s} ahead {levels[0]:5.1f}  side {levels[6]:5.1f}  behind {levels[12]:5.1f}  "
            f"median {np.median(levels):5.1f}  smallest {levels.min():5.1f}  largest {levels.max():5.1f} dBsm",
            flush=True,
        )
