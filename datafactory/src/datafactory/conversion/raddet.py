"""The layout of RADDet (Zhang, Nowruzi, Laganiere, "RADDet: Range-Azimuth-Doppler based Radar Object Detection for
Dynamic Road Users", CRV 2021), as its loader reads it (https://github.com/ZhangAoCanada/RADDet):

    train|test/RAD/part1/NNNNNN.npy      complex64 [range, azimuth, Doppler]
    train|test/gt/part1/NNNNNN.pickle    {"classes": [...], "boxes": [n, 6], "cart_boxes": [n, 4]}
    config.json                          sizes, resolutions, and the means that the loader normalises with

- Row i is the range (rows - 1 - i) steps: the nearest is last. Column j is sin(angle) = 2 j / columns - 1, to the
  right. Cell k is the velocity (k - cells / 2) steps, receding is positive.
- ``boxes`` holds middles and widths over rows, columns and cells, ``cart_boxes`` over rows (ahead) and columns (to the
  right, the radar in the middle) of a grid of squares, one range step wide.
- Values are over the noise's amplitude. The loader takes log10(|x|^2 + 1): in W all of them would be 0.
"""

from __future__ import annotations

import json
import math
import pickle
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datafactory.run.room import free_bytes
from shared.dataset import Box, Frame
from shared.dataset.boxes import footprint, range_and_u
from shared.dataset.folder import Dataset
from shared.dataset.locations import Location
from shared.dataset.reading import radar_of, read_frame
from shared.dataset.writing import write_json, write_text
from shared.physics.errors import InputError
from shared.radar import Radar
from shared.signal.spectrum import range_doppler
from shared.signal.steering import manifold
from shared.signal.windows import cell_noise_power

Real = NDArray[np.float64]

CLASSES = ("person", "bicycle", "car", "motorcycle", "bus", "truck")
"""Of RADDet, in its order."""
CLASS_OF = {"pedestrian": "person", "cyclist": "bicycle"} | {name: name for name in CLASSES}
"""RADDet's class by ours."""

FOLDERS = {"train": "train", "validation": "train", "test": "test"}
"""RADDet has two; its loader takes the last tenth of the first for validation."""
PART = {"train": "part1", "validation": "part2", "test": "part1"}

LARGEST_RANGE_BINS = 256
"""RADDet's number of range bins. More are cut: a frame of 256 x 256 x 128 has 67 MB."""
STRIDE = 16
"""RADDet's network halves every axis four times."""
AZIMUTH_BINS = 256


@dataclass(frozen=True)
class Grid:
    """The axes of a frame in this layout.

    :param rows: range bins, from :param range_step_m: on
    :param cells: Doppler bins of :param velocity_step_mps: m/s
    """

    rows: int
    range_step_m: float
    cells: int
    velocity_step_mps: float
    columns: int = AZIMUTH_BINS

    @staticmethod
    def of(radar: Radar) -> Grid:
        """As many range bins as RADDet has, or the largest multiple of its stride that there are.

        :raises InputError: fewer than one stride
        """
        waveform = radar.waveform
        rows = min(LARGEST_RANGE_BINS, waveform.range_bins // STRIDE * STRIDE)
        if rows == 0:
            raise InputError("--to raddet", f"{waveform.range_bins} range bins", f"at least {STRIDE}, RADDet's stride")
        step = float(waveform.velocities_mps[1] - waveform.velocities_mps[0]) if waveform.chirps > 1 else 0.0
        return Grid(rows, waveform.range_step_m, waveform.chirps, step)

    @property
    def shape(self) -> tuple[int, int, int]:
        return self.rows, self.columns, self.cells


def write_raddet(dataset: Dataset, out: Path, progress: Callable[[int, int], None]) -> tuple[int, tuple[str, ...]]:
    """Write a dataset with cubes; returns the number of frames and what is said of the rest.

    :raises InputError: no cubes, no frame with a box of RADDet's classes, a disk that is too small
    """
    description = dataset.description()
    if "cube" not in description["shapes"]:
        raise InputError(dataset.path, "has no cubes, of which RADDet's spectra are made", "one made with --store cube")
    radar = radar_of(description, dataset.path)
    grid, left_out = Grid.of(radar), Counter[str]()
    wanted = list(_labelled(dataset, grid, left_out))
    if not wanted:
        raise InputError(dataset.path, "no frame has a box of RADDet's classes", f"objects of class {sorted(CLASS_OF)}")
    needed, free = len(wanted) * np.dtype(np.complex64).itemsize * math.prod(grid.shape), free_bytes(out)
    if needed > free:
        fault = f"{len(wanted)} frames need {needed / 1e6:.0f} MB; {out.parent} has {free / 1e6:.0f} MB free"
        raise InputError("--out", fault, "another disk, or fewer frames")
    weights, levels = azimuth_weights(radar), _Levels()
    for done, (split, shard, row, known) in enumerate(wanted):
        progress(done, len(wanted))
        frame = read_frame(shard, row, columns=("cube",))
        spectra = rad(frame, radar, grid, weights)
        levels.add(spectra)
        for kind, suffix, content in (("RAD", "npy", None), ("gt", "pickle", pickle.dumps(known, protocol=4))):
            path = out / FOLDERS[split] / kind / PART[split] / f"{frame.frame_id:06d}.{suffix}"
            path.parent.mkdir(parents=True, exist_ok=True)
            if content is None:
                np.save(path, spectra)
            else:
                path.write_bytes(content)
    progress(len(wanted), len(wanted))
    notes = tuple(f"{count} {what}" for what, count in sorted(left_out.items())) + _assumed(radar, grid)
    write_json(out / "config.json", config(radar, grid, levels), sort_keys=False)
    write_text(out / "README.md", _readme(dataset, notes))
    return len(wanted), notes


def _labelled(
    dataset: Dataset, grid: Grid, left_out: Counter[str]
) -> Iterator[tuple[str, Location, int, dict[str, object]]]:
    """Split, shard, row and ground truth of the frames that the loader takes."""
    for split in dataset.splits:
        for shard, row in dataset.rows(split):
            known = truth(read_frame(shard, row, columns=("boxes",)), grid, left_out)
            if known["classes"]:
                yield split, shard, row, known
            else:
                left_out["frames without a box of these classes, which the loader refuses"] += 1


def azimuth_weights(radar: Radar) -> NDArray[np.complex64]:
    """[C, columns] of delay-and-sum towards sin(angle) = 2 j / columns - 1, to the right.

    RADDet has an FFT over the channels of a uniform array here: the same sum, for channels anywhere.
    """
    right = 2.0 * np.arange(AZIMUTH_BINS) / AZIMUTH_BINS - 1.0
    channels = radar.array.channels
    weights = manifold(radar.array.virtual[:, 1], radar.waveform.wavelength_m, -right).conj() / channels
    return weights.astype(np.complex64)


def rad(frame: Frame, radar: Radar, grid: Grid, weights: NDArray[np.complex64]) -> NDArray[np.complex64]:
    """[range, azimuth, Doppler] spectra of a frame's cube, over the amplitude of the noise in them."""
    if frame.cube is None:
        raise ValueError(f"frame {frame.frame_id} has no cube")
    spectra = range_doppler(frame.cube, radar)[: grid.rows]
    noise = np.float32(np.sqrt(cell_noise_power(radar) / radar.array.channels))
    images = spectra.astype(np.complex64, copy=False) @ (weights / noise)  # [range, Doppler, azimuth]
    return np.ascontiguousarray(images[::-1].transpose(0, 2, 1))


def truth(frame: Frame, grid: Grid, left_out: Counter[str]) -> dict[str, object]:
    """The ground truth of a frame.

    :param left_out: counts the boxes that have no place in it
    """
    classes, boxes, flat = list[str](), list[Real](), list[Real]()
    for box in frame.boxes:
        name = CLASS_OF.get(box.class_name)
        if name is None:
            left_out[f"boxes of class {box.class_name!r}, which RADDet does not have"] += 1
        elif box.power == 0.0:
            left_out["boxes of objects that the radar does not see"] += 1
        elif float(np.linalg.norm(box.center)) >= grid.rows * grid.range_step_m:
            left_out["boxes beyond the range that is kept"] += 1
        else:
            classes.append(name)
            boxes.append(_over_cells(box, grid))
            flat.append(_over_squares(box, grid))
    return {
        "classes": classes,
        "boxes": np.array(boxes).reshape(-1, 6),
        "cart_boxes": np.array(flat).reshape(-1, 4),
    }


def _over_cells(box: Box, grid: Grid) -> Real:
    """[6] middle and width over rows, columns and Doppler cells; at least one of each wide."""
    range_m, u = range_and_u(box)
    row = (grid.rows - 1) - range_m / grid.range_step_m
    column = 0.5 * grid.columns * (1.0 - u)
    x, y = footprint(box, 16).T
    rate = (x * box.velocity[0] + y * box.velocity[1] + box.center[2] * box.velocity[2]) / range_m
    cell = rate / (grid.velocity_step_mps or 1.0) + grid.cells // 2
    middle, width = zip(*(_span(values) for values in (row, column, cell)), strict=True)
    places = np.array(middle)
    places[2] %= grid.cells  # a faster object appears in the cell that it folds into
    places[:2] = np.clip(places[:2], 0.0, np.array([grid.rows, grid.columns]) - 1.0)
    return np.concatenate([places, width])


def _over_squares(box: Box, grid: Grid) -> Real:
    """[4] middle and width over rows (ahead) and columns (to the right) of squares of a range step."""
    x, y = footprint(box).T
    row = (grid.rows - 1) - x / grid.range_step_m
    column = grid.rows - y / grid.range_step_m
    middle, width = zip(*(_span(values) for values in (row, column)), strict=True)
    return np.concatenate([np.clip(middle, 0.0, np.array([grid.rows, 2 * grid.rows]) - 1.0), width])


def _span(values: Real) -> tuple[float, float]:
    """The middle of some values and how far they reach, at least 1."""
    low, high = float(values.min()), float(values.max())
    return 0.5 * (low + high), max(1.0, high - low)


class _Levels:
    """The loader's input, log10(|x|^2 + 1), over all frames: least, largest, mean."""

    def __init__(self) -> None:
        self.least, self.largest, self._sum, self._count = np.inf, 0.0, 0.0, 0

    def add(self, spectra: NDArray[np.complex64]) -> None:
        level = np.log10(np.abs(spectra) ** 2 + 1.0)
        self.least, self.largest = min(self.least, float(level.min())), max(self.largest, float(level.max()))
        self._sum += float(level.sum(dtype=np.float64))
        self._count += level.size

    @property
    def mean(self) -> float:
        return self._sum / self._count


def config(radar: Radar, grid: Grid, levels: _Levels) -> dict[str, object]:
    """What the loader's ``config.json`` says of the data; training has its own settings beside it."""
    gigahertz = radar.waveform.mid_sweep_hz / 1e9
    return {
        "DATA": {
            "train_set_dir": "train",
            "test_set_dir": "test",
            "all_classes": list(CLASSES),
            "global_mean_log": levels.mean,
            "global_max_log": levels.largest,
            "global_min_log": levels.least,
            "global_variance_log": levels.largest - levels.mean,
            "max_boxes_per_frame": 30,
            "trainset_portion": 0.8,
        },
        "MODEL": {"input_shape": list(grid.shape)},
        "RADAR_CONFIGURATION": {
            # Equal: columns are uniform in the sine of the angle, whatever the elements' spacing.
            "designed_frequency": gigahertz,
            "config_frequency": gigahertz,
            "range_size": grid.rows,
            "doppler_size": grid.cells,
            "azimuth_size": grid.columns,
            "range_resolution": grid.range_step_m,
            "angular_resolution": 2.0 / grid.columns,
            "velocity_resolution": grid.velocity_step_mps,
        },
    }


def _assumed(radar: Radar, grid: Grid) -> tuple[str, ...]:
    cut = f"; ranges beyond {grid.rows} bins are cut" if grid.rows < radar.waveform.range_bins else ""
    return (
        f"sizes {' x '.join(map(str, grid.shape))}, RADDet has 256 x 256 x 64{cut}",
        f"azimuth by delay-and-sum over {radar.array.channels} channels, RADDet has 8",
        "no stereo images, no ADC, no anchors.txt: RADDet's anchor_kmeans.py makes the last",
        "validation frames stand in train, as part2: RADDet has no third split",
    )


def _readme(dataset: Dataset, notes: tuple[str, ...]) -> str:
    lines = ["# Simulated frames in the layout of RADDet", "", *(f"- {note}" for note in notes), ""]
    source = json.dumps(dataset.manifest.get("arguments", {}).get("seed"))
    return "\n".join([*lines, f"Made by `datafactory convert --to raddet` of a dataset with the seed {source}.", ""])
