"""A small dataset with cubes and boxes: point targets where the boxes stand, made in a second."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from datafactory.frame.points import target_list
from datafactory.run.shards import plan_shards, write_shard
from shared.dataset import Box, Frame, arrow_schema, description
from shared.dataset.manifest import write_manifest
from shared.radar import ImageGrid, Radar
from shared.radar.waveform import Waveform
from shared.signal import if_signal, target_amplitudes
from shared.signal.spectrum import range_doppler, select_doppler

RADAR = Radar(
    name="small",
    waveform=Waveform(chirps=16, samples=128, range_bins=80, bandwidth_hz=400e6),
    grid=ImageGrid(bins=40),
)


def box(x: float, y: float, name: str = "car", speed: float = 0.0, power: float = 1e-12, yaw: float = 0.0) -> Box:
    return Box((x, y, 0.0), (4.0, 2.0, 1.5), yaw, (speed, 0.0, 0.0), name, f"/{name} at {x:g}", power)


def frame(frame_id: int, boxes: Sequence[Box], store: str = "cube") -> Frame:
    """A point target of 20 dBsm in the middle of every box, without noise."""
    position = np.array([item.center for item in boxes]).reshape(-1, 3)
    velocity = np.array([item.velocity for item in boxes]).reshape(-1, 3)
    amplitude = target_amplitudes(RADAR, position, np.full(len(boxes), 20.0), np.zeros(len(boxes)))
    cube = if_signal(RADAR, position, velocity, amplitude).astype(np.complex64)
    selection = select_doppler(range_doppler(cube, RADAR), 0.0, 1)
    image = np.zeros((80, 40), np.float32)
    image[20, 10] = 1.0
    level = 20.0 * np.log10(np.abs(amplitude) + 1e-30)
    return Frame(
        frame_id, "scene", "street", 1, (10.0 * frame_id, 1.0, 0.5), (3.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0),
        range_channel=selection.range_channel.astype(np.complex64),
        velocity=selection.velocities_mps(RADAR.waveform).astype(np.float32),
        image=image,
        image_peak=1e-6,
        noise_power=0.0,
        targets=target_list(position, velocity, level, [item.object for item in boxes], RADAR),
        boxes=tuple(boxes),
        cube=cube if store == "cube" else None,
    )  # fmt: skip


def write(folder: Path, frames: Sequence[Frame], splits: Sequence[str], store: str = "cube") -> Path:
    schema = arrow_schema(description(RADAR, 1, store))
    plans = plan_shards(splits, frames_per_shard=2)
    shards = [write_shard(folder / plan.path, [frames[i] for i in plan.frame_ids], schema) for plan in plans]
    write_manifest(folder, {"version": 1, "counts": {}, "shards": [shard.model_dump() for shard in shards]})
    return folder
