"""A dataset with cubes in the folders of RADDet, as its loader reads them (https://github.com/ZhangAoCanada/RADDet).

    .venv/bin/datafactory render --scene scenes/street.usda --frames 8 --store cube --out build/cubes
    .venv/bin/python examples/to_raddet.py build/cubes --out build/raddet

RADDet is a measured set of range-azimuth-Doppler spectra with boxes of road users (Zhang, Nowruzi and Laganiere, CRV
2021). The files:

    train|test/RAD/part1/NNNNNN.npy      complex64 [range, azimuth, Doppler]
    train|test/gt/part1/NNNNNN.pickle    {"classes": [...], "boxes": [n, 6], "cart_boxes": [n, 4]}
    config.json                          sizes, resolutions, and the means that the loader normalises with

- Row i is the range (rows - 1 - i) steps: the nearest is last. Column j is sin(angle) = 2 j / columns - 1, to the
  right. Cell k is the velocity (k - cells / 2) steps, receding is positive.
- ``boxes`` holds middles and widths over rows, columns and cells, ``cart_boxes`` over rows (ahead) and columns (to the
  right, the radar in the middle) of a grid of squares, one range step wide.
- Values are over the noise's amplitude. The loader takes log10(|x|^2 + 1): in W all of them would be 0.
- Validation frames stand in ``train``, as ``part2``: RADDet has no third split. There are no stereo images and no
  ``anchors.txt``, which RADDet's ``anchor_kmeans.py`` makes.
"""

from __future__ import annotations

import argparse
import json
import pickle
from collections import Counter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shared.dataset import Box, Frame
from shared.dataset.folder import open_dataset
from shared.dataset.reading import radar_of
from shared.radar import Radar
from shared.signal.signal import manifold
from shared.signal.spectrum import range_doppler
from shared.signal.windows import cell_noise_power

Real = NDArray[np.float64]

CLASSES = ("person", "bicycle", "car", "motorcycle", "bus", "truck")
"""Of RADDet, in its order; of ours a pedestrian is a person."""
FOLDERS = {"train": ("train", "part1"), "validation": ("train", "part2"), "test": ("test", "part1")}
ROWS, STRIDE, COLUMNS = 256, 16, 256
"""RADDet's range and azimuth bins: more rows are cut, to a multiple of what its network divides them by."""


def main() -> None:
    options = argparse.ArgumentParser(description="A dataset with cubes in the folders of RADDet.")
    options.add_argument("dataset", help="folder of a dataset made with --store cube")
    options.add_argument("--out", type=Path, required=True, help="a new folder")
    chosen = options.parse_args()
    dataset = open_dataset(chosen.dataset)
    if "cube" not in dataset.description()["shapes"]:
        options.error(f"{chosen.dataset} has no cubes: make it with --store cube")
    if chosen.out.exists():
        options.error(f"{chosen.out} is there already")
    radar = radar_of(dataset.description(), dataset.path)
    left_out, levels, count = Counter[str](), list[tuple[float, float, float]](), 0
    for split in dataset.splits:
        for frame in dataset.frames(split, ("cube", "boxes")):
            known = truth(frame, radar, left_out)
            if not known["classes"]:  # the loader refuses such a frame
                left_out["frames without a box of these classes"] += 1
                continue
            spectra = rad(frame, radar)
            folder, part = FOLDERS[split]
            for kind in ("RAD", "gt"):
                (chosen.out / folder / kind / part).mkdir(parents=True, exist_ok=True)
            name = f"{frame.frame_id:06d}"
            np.save(chosen.out / folder / "RAD" / part / f"{name}.npy", spectra)
            (chosen.out / folder / "gt" / part / f"{name}.pickle").write_bytes(pickle.dumps(known, protocol=4))
            level = np.log10(np.abs(spectra) ** 2 + 1.0)  # as the loader takes it
            levels.append((float(level.min()), float(level.max()), float(level.mean(dtype=np.float64))))
            count += 1
    if not count:
        options.error(f"{chosen.dataset}: no frame has a box of {', '.join(CLASSES)}")
    (chosen.out / "config.json").write_text(json.dumps(config(radar, np.array(levels)), indent=2), encoding="utf-8")
    print(f"{count} frames in {chosen.out}")
    for what, number in sorted(left_out.items()):
        print(f"left out: {number} {what}")


def rows_of(radar: Radar) -> int:
    return min(ROWS, radar.waveform.range_bins // STRIDE * STRIDE)


def rad(frame: Frame, radar: Radar) -> NDArray[np.complex64]:
    """[range, azimuth, Doppler] spectra of a frame's cube, over the amplitude of the noise in them.

    RADDet has an FFT over the channels of a uniform array; delay-and-sum is the same for channels anywhere.
    """
    assert frame.cube is not None
    channels = radar.array.channels
    right = 2.0 * np.arange(COLUMNS) / COLUMNS - 1.0
    weights = manifold(radar.array.virtual[:, 1], radar.waveform.wavelength_m, -right).conj() / channels
    weights /= np.sqrt(cell_noise_power(radar) / channels)
    spectra = range_doppler(frame.cube, radar)[: rows_of(radar)].astype(np.complex64, copy=False)
    images = spectra @ weights.astype(np.complex64)  # [range, Doppler, azimuth]
    return np.ascontiguousarray(images[::-1].transpose(0, 2, 1))


def truth(frame: Frame, radar: Radar, left_out: Counter[str]) -> dict[str, object]:
    """The ground truth of a frame; ``left_out`` counts the boxes that have no place in it."""
    classes, boxes, flat = list[str](), list[Real](), list[Real]()
    for box in frame.boxes:
        name = "person" if box.class_name == "pedestrian" else box.class_name
        if name not in CLASSES:
            left_out[f"boxes of class {name!r}, which RADDet does not have"] += 1
        elif box.power == 0.0:
            left_out["boxes of objects that the radar does not see"] += 1
        elif float(np.linalg.norm(box.center)) >= rows_of(radar) * radar.waveform.range_step_m:
            left_out["boxes beyond the range that is kept"] += 1
        else:
            classes.append(name)
            boxes.append(over_cells(box, radar))
            flat.append(over_squares(box, radar))
    return {"classes": classes, "boxes": np.array(boxes).reshape(-1, 6), "cart_boxes": np.array(flat).reshape(-1, 4)}


def over_cells(box: Box, radar: Radar) -> Real:
    """[6] middle and width over rows, columns and Doppler cells."""
    rows, waveform = rows_of(radar), radar.waveform
    range_m, u = box.range_and_u()
    x, y = box.footprint(16).T
    rate = (x * box.velocity[0] + y * box.velocity[1] + box.center[2] * box.velocity[2]) / range_m
    middle, width = spans(
        (rows - 1) - range_m / waveform.range_step_m,
        0.5 * COLUMNS * (1.0 - u),
        rate / waveform.velocity_step_mps + waveform.chirps // 2,
    )
    middle[2] %= waveform.chirps  # a faster object appears in the cell that it folds into
    middle[:2] = np.clip(middle[:2], 0.0, [rows - 1.0, COLUMNS - 1.0])
    return np.concatenate([middle, width])


def over_squares(box: Box, radar: Radar) -> Real:
    """[4] middle and width over rows (ahead) and columns (to the right) of squares of a range step."""
    rows, step = rows_of(radar), radar.waveform.range_step_m
    x, y = box.footprint().T
    middle, width = spans((rows - 1) - x / step, rows - y / step)
    return np.concatenate([np.clip(middle, 0.0, [rows - 1.0, 2.0 * rows - 1.0]), width])


def spans(*axes: Real) -> tuple[Real, Real]:
    """The middle of each axis' values and how far they reach, at least 1."""
    low, high = (np.array([float(pick(values)) for values in axes]) for pick in (np.min, np.max))
    return 0.5 * (low + high), np.maximum(1.0, high - low)


def config(radar: Radar, levels: Real) -> dict[str, object]:
    """What the loader's ``config.json`` says of the data; training has its own settings beside it.

    :param levels: [frames, 3] least, largest and mean of the loader's input
    """
    least, largest, mean = float(levels[:, 0].min()), float(levels[:, 1].max()), float(levels[:, 2].mean())
    waveform, rows, gigahertz = radar.waveform, rows_of(radar), radar.waveform.mid_sweep_hz / 1e9
    return {
        "DATA": {
            "train_set_dir": "train", "test_set_dir": "test", "all_classes": list(CLASSES),
            "global_mean_log": mean, "global_max_log": largest, "global_min_log": least,
            "global_variance_log": largest - mean, "max_boxes_per_frame": 30, "trainset_portion": 0.8,
        },
        "MODEL": {"input_shape": [rows, COLUMNS, waveform.chirps]},
        "RADAR_CONFIGURATION": {
            # Equal: columns are uniform in the sine of the angle, whatever the elements' spacing.
            "designed_frequency": gigahertz, "config_frequency": gigahertz,
            "range_size": rows, "doppler_size": waveform.chirps, "azimuth_size": COLUMNS,
            "range_resolution": waveform.range_step_m, "angular_resolution": 2.0 / COLUMNS,
            "velocity_resolution": waveform.velocity_step_mps,
        },
    }  # fmt: skip


if __name__ == "__main__":
    main()
