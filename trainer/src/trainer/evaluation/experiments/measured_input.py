"""What was measured: a snapshot of a line of elements, or a range bin of a cube with all that stands around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shared.physics.errors import InputError
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.signal.model_error import UNCALIBRATED_DB, model_error_ratio
from shared.signal.tdm import averaged
from trainer.captures.reading import read_arrays
from trainer.data.arrays import ArrayChoice
from trainer.data.measurements import Cells, Measurement, open_measurements
from trainer.estimators.array import LineArray, line_array

CARRIER_HZ = 77e9
"""Taken for a snapshot, of which no radar is known; u does not depend on it, since the elements stand half a wavelength
apart."""
WAVELENGTH_M = SPEED_OF_LIGHT / CARRIER_HZ
HANN = (0.0, -0.5, 1.0, -0.5, 0.0)
"""What a point in the middle of a range bin is in its neighbours: a network that looks along range is shown a snapshot
so."""
FIRST = (48, 10)
"""Elements of a snapshot that are looked at alone: the full array of the paper, and few."""
LEAST_ELEMENTS = 5
AXIS = np.linspace(-0.6, 0.6, 2401)
"""u scanned of a snapshot, in steps of 0.03 degrees."""
AXIS_STEP = 5e-4
"""Of u, where a cube's radar says from where to where."""


@dataclass(frozen=True, eq=False)
class MeasuredInput:
    """One row of channels, and how it is to be judged.

    :param snapshot: [C] the channels
    :param positions_m: [C] y_tx + y_rx
    :param u: [U] angles scanned
    :param elements: indices of the channels that form an array, by its name; the first has all
    :param targets: in the row, where the number is known
    :param frame: the row among its neighbours, in the strongest Doppler peak of a cube; its noise is 0 where it is not
        known
    :param row: its range bin there
    :param element: which element of the snapshot each of the frame's channels is, -1 for dead ones and those off the
        azimuth line; channels that coincide are one element, their mean
    :param radar: of a cube, of which the first frame is taken that is not empty
    :raises InputError: more targets than the elements of its smallest array can tell
    """

    path: Path
    snapshot: NDArray[np.complex128]
    positions_m: NDArray[np.float64]
    wavelength_m: float
    u: NDArray[np.float64]
    elements: dict[str, NDArray[np.intp]]
    targets: int | None
    frame: Measurement
    row: int
    element: NDArray[np.intp]
    radar: Radar | None = None

    def __post_init__(self) -> None:
        fewest = min(map(len, self.elements.values()))
        if self.targets is not None and self.targets > fewest // 2:
            raise InputError("--targets", f"{self.targets} with {fewest} elements", f"at most {fewest // 2}")

    @property
    def numbered(self) -> bool:
        """Whether the cube holds several frames: the name of one says which."""
        return self.radar is not None and self.frame.name != self.path.stem

    @property
    def place(self) -> str:
        """Which row of a cube it is, as text."""
        assert self.radar is not None
        frame = f"frame {self.frame.frame_id}, " if self.numbered else ""
        return f"{frame}range {self.row * self.radar.waveform.range_step_m:.2f} m"

    def line(self, elements: NDArray[np.intp]) -> LineArray:
        """The places of some of its channels."""
        return LineArray(self.positions_m[elements], self.wavelength_m)


def read_measured(
    path: Path,
    targets: int | None = None,
    range_m: float | None = None,
    model_error_db: float | None = None,
) -> MeasuredInput:
    """The row of a file: a snapshot (.mat, .npy), or the range bin of a cube (.npz) that is asked for or the strongest,
    in its first frame that is not empty.

    :param targets: their number in the row, where it is known
    :param range_m: of the row of a cube; the strongest where None
    :param model_error_db: by default the cube's own, and :data:`shared.signal.model_error.UNCALIBRATED_DB` without
    :raises InputError: a file that is none of these or holds no echo, a range beyond the cube's, a model error above
        0 dB, no targets
    """
    if targets is not None and targets < 1:
        raise InputError("--targets", repr(targets), "1 or more; none where their number is not known")
    if model_error_db is not None:
        model_error_ratio(model_error_db)
    if path.suffix == ".npz" and path.is_file():
        return _of_cube(path, targets, range_m, model_error_db)
    if range_m is not None:
        raise InputError("--range", f"{range_m:g} m of a snapshot", "no --range: a snapshot has none")
    snapshot = read_snapshot(path)
    everything = np.arange(len(snapshot))
    sets = {f"all {len(snapshot)}": everything}
    sets.update({f"first {first}": everything[:first] for first in FIRST if first < len(snapshot)})
    error = UNCALIBRATED_DB if model_error_db is None else model_error_db
    rows = (np.array(HANN)[:, None] * snapshot).astype(np.complex64)[None]
    frame = Measurement(path.stem, 0, Cells(rows, np.zeros(rows.shape[:2], np.float32)), 0.0, None, error)
    places = half_wavelength_line(everything).positions_m
    return MeasuredInput(path, snapshot, places, WAVELENGTH_M, AXIS, sets, targets, frame, HANN.index(1.0), everything)


def read_snapshot(path: Path) -> NDArray[np.complex128]:
    """[C] the snapshot of a MATLAB file with one complex vector, or of a complex vector in a .npy file.

    :raises InputError: no such file, not readable, no or several complex vectors, values that are not finite or all 0
    """
    if not path.is_file() or path.suffix not in (".mat", ".npy"):
        raise InputError("--measured", f"{path}", "a .mat or .npy file with one complex vector, or a cube as .npz")
    vectors = {
        k: v for k, v in read_arrays(path).items() if np.iscomplexobj(v) and np.size(v) == max(np.shape(v), default=0)
    }
    if len(vectors) != 1:
        raise InputError(path, f"complex vectors {sorted(vectors)}", "exactly one")
    snapshot = next(iter(vectors.values())).ravel().astype(np.complex128)
    if len(snapshot) < LEAST_ELEMENTS or not np.isfinite(snapshot).all():
        raise InputError(path, f"{len(snapshot)} elements", f"more than {LEAST_ELEMENTS - 1} finite ones")
    if not snapshot.any():
        raise InputError(path, "all elements are 0", "a snapshot with an echo")
    return snapshot


def half_wavelength_line(elements: NDArray[np.intp]) -> LineArray:
    """Elements of a line at half a wavelength; by the measurement's convention u rises with the phase exp(+j pi n
    u)."""
    return LineArray(-0.5 * WAVELENGTH_M * elements.astype(np.float64), WAVELENGTH_M)


def with_arrays(found: MeasuredInput, radar: Radar, arrays: Sequence[ArrayChoice]) -> MeasuredInput:
    """The input with these arrays among its element sets.

    Of a cube they are channels of its radar. A snapshot is thinned as the arrays of ``radar`` are, element for element
    of its grid, as far as they fit.
    """
    sets = dict(found.elements)
    if found.radar is not None:
        for array in arrays:
            kept = np.unique(found.element[array.line(found.radar)])
            if (kept >= 0).any() and array.name not in sets:
                sets[array.name] = kept[kept >= 0]
    else:
        line = line_array(radar)
        steps = (line.positions_m - line.positions_m.min()) / (line.spacing_m or 0.5 * line.wavelength_m)
        grid = np.round(steps).astype(int)
        for array in arrays:
            thinned = np.sort(grid[array.line(radar)])
            if len(thinned) < len(grid) and thinned[-1] < len(found.snapshot):
                sets[f"{array.name} of {grid.max() + 1}"] = thinned.astype(np.intp)
    return replace(found, elements=sets)


def snapshot_radar(found: MeasuredInput, like: Radar) -> Radar:
    """A radar with the snapshot's elements in its own wavelength, for networks; else as ``like``.

    :raises InputError: elements farther than an antenna array may reach
    """
    wavelength = like.waveform.wavelength_m / found.wavelength_m
    places = (found.positions_m - found.positions_m.mean()) * wavelength
    try:
        array = AntennaArray(tx_m=((0.0, 0.0, 0.0),), rx_m=tuple((0.0, float(y), 0.0) for y in places))
    except ValueError as error:
        raise InputError(found.path, f"{len(places)} elements", "a line within two metres") from error
    return like.model_copy(update={"name": found.path.stem, "array": array})


def _of_cube(path: Path, targets: int | None, range_m: float | None, model_error_db: float | None) -> MeasuredInput:
    radar, measurements = open_measurements(path, None, "all")
    used = np.setdiff1d(radar.array.azimuth_channels, np.array(measurements.dead_channels, dtype=np.intp))
    if not len(used):
        raise InputError(path, f"all {radar.array.channels} channels are dead", "a channel with an echo")
    frame = next((one for one in measurements if one.cells.range_channel[0][:, used].any()), None)
    if frame is None:
        raise InputError(path, "all samples are 0", "a frame with an echo")
    unused = np.setdiff1d(np.arange(radar.array.channels), used)
    rows, places = averaged(frame.cells.range_channel[0], radar, unused)
    element = np.full(radar.array.channels, -1, dtype=np.intp)
    element[used] = np.unique(radar.array.unique_elements(radar.waveform.wavelength_m)[1][used], return_inverse=True)[1]
    step, bins = radar.waveform.range_step_m, radar.waveform.range_bins
    if range_m is None:
        # The receiver's offset and what leaks from TX to RX stand in the first bins.
        row = int(np.argmax(np.linalg.norm(rows, axis=1) * np.arange(bins)))
    else:
        row = round(range_m / step)
        if not 0 <= row < bins:
            raise InputError("--range", f"{range_m:g} m", f"0 to {(bins - 1) * step:.4g} m, which {path} holds")
    error = frame.model_error_db if model_error_db is None else model_error_db
    cells = Cells(frame.cells.range_channel[:1], frame.cells.velocity[:1])
    strongest = replace(frame, cells=cells, model_error_db=error)
    u = np.arange(radar.grid.u_start, radar.grid.u_stop, AXIS_STEP)
    return MeasuredInput(
        path, rows[row].astype(np.complex128), places[:, 1], radar.waveform.wavelength_m, u,
        {"full": np.arange(len(places))}, targets, strongest, row, element, radar,
    )  # fmt: skip
