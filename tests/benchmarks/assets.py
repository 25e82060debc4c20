"""Cross sections of the shipped vehicles and furniture by aspect, and what a population adds to a city's frames.

python tests/benchmarks/assets.py            cross sections over aspects, at 20 m, the sensor 0.5 m high, no ground
python tests/benchmarks/assets.py --city     6 frames of munich, 20 000 rays: processor time, power of what was put in
"""

from __future__ import annotations

import sys
import time

import numpy as np

from datafactory.api.asking import load_scene, order_of
from datafactory.api.options import OrderOptions
from datafactory.frame.chain import SceneSource, illuminated, make_frames
from datafactory.paths.backend import select_variant, set_threads
from datafactory.paths.merged_scene import merge_scene
from datafactory.paths.rays import RayFan
from datafactory.paths.solver import TraceSettings
from datafactory.paths.trace import trace
from datafactory.run.preparation import prepare
from datafactory.scenes.boxes import boxed_things
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.traffic.population import FOLDER
from shared.radar import load_radar

ASSETS = ("saloon", "hatchback", "suv", "van", "truck", "bus", "lamp", "traffic_light", "bollard", "sign_round", "bin")
ASPECTS_DEG = np.arange(0.0, 360.0, 15.0)
DISTANCE_M, RAYS = 20.0, 20_000
ASKED = "cars=20,trucks=2,pedestrians=10,cyclists=4,poles=30,signs=10,parked=0.6"
FRAMES = 6


def cross_sections_dbsm(name: str) -> np.ndarray:
    """[aspects] sum of the powers of all echoes, as a cross section at the asset's middle; 0 is from ahead."""
    scene = open_scene(f"shipped:assets/{name}")
    materials = load_materials().map_materials([item.material for item in scene.objects])
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


def put_in(objects: tuple[str, ...]) -> np.ndarray:
    """[objects + 1] whether each belongs to the population; the last is for -1, whose object is unknown."""
    return np.array([*(name.startswith(f"{FOLDER}/") for name in objects), False])


def city() -> None:
    """Processor time of drawn frames, bare and populated, and the share of power of what was put in."""
    for asked in (None, ASKED):
        scene = load_scene("sionna:munich", populate=asked)
        order = order_of(OrderOptions(scene, radar="avr-qdm-110", frames=2 * FRAMES + 2, rays=20_000, effects="all"))
        prepared = prepare(order, load_materials(), print)
        seconds, shares, moving = [], [], []
        for frame_id in range(0, 2 * FRAMES + 2, 2):
            dealt = prepared.deal.frame(frame_id)
            settings = order.of_scenes
            source = SceneSource(dealt, prepared.scenes[0], settings)
            start = time.process_time()
            list(make_frames([source], order.radar))
            seconds.append(time.process_time() - start)
            if scene.population is None:
                continue
            table = illuminated(source.traced(order.radar), settings, order.radar)
            ours = put_in(table.objects)
            power = [
                (np.abs(part.amplitude) ** 2, ours[part.object_index]) for part in (table.scattered, table.specular)
            ]
            total = sum(float(values.sum()) for values, _ in power)
            shares.append(sum(float(values[own].sum()) for values, own in power) / total)
            things = [thing for thing in boxed_things(scene) if thing.name.startswith(f"{FOLDER}/")]
            centers = np.array([thing.at(dealt.where.time_s).center for thing in things])
            away = np.linalg.norm(centers - dealt.where.position, axis=1)
            moving.append(int((away < 90.0).sum()))
        # The first frame finds the scene's shapes.
        print(
            "populated" if asked else "bare",
            "first",
            round(seconds[0], 2),
            "then",
            np.round(seconds[1:], 2),
            "mean",
            round(float(np.mean(seconds[1:])), 2),
        )
        if shares:
            print("share of power", np.round(shares, 3), "things within 90 m", moving)


if __name__ == "__main__":
    select_variant()
    set_threads(1)
    if "--city" in sys.argv:
        city()
        raise SystemExit
    for each in ASSETS:
        levels = cross_sections_dbsm(each)
        print(
            f"{each:14s} ahead {levels[0]:5.1f}  side {levels[6]:5.1f}  behind {levels[12]:5.1f}  "
            f"median {np.median(levels):5.1f}  smallest {levels.min():5.1f}  largest {levels.max():5.1f} dBsm",
            flush=True,
        )
