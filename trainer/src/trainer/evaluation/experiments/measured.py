"""A measured snapshot of a half-wavelength line of elements, e.g. two corner reflectors, by all estimators.

Nothing in it is simulated. The reference is maximum likelihood of two targets on all elements; the estimators are
given all elements, the first 48, the first 10, and the first 48 thinned as the radar's arrays are. Networks are
trained for their radar's elements and cannot take part.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from shared.physics.errors import InputError, figure_text
from shared.physics.units import SPEED_OF_LIGHT
from trainer.captures.matlab_files import read_complex_arrays
from trainer.captures.numpy_files import read_npy
from trainer.estimators.base import ESTIMATORS, UNIFORM_ESTIMATORS, Estimator, LineArray
from trainer.estimators.ml import MaximumLikelihood
from trainer.estimators.music import Music
from trainer.evaluation.experiments.bench import Bench, Results, Task
from trainer.evaluation.report.style import SPAN_DB, Look, legend_below, level_db, new_figure, subplots
from trainer.evaluation.rows import MetricRow, SummaryColumn
from trainer.evaluation.store import Values, digest
from trainer.metrics.resolution import strongest_peaks

WAVELENGTH_M = SPEED_OF_LIGHT / 77e9
"""Of the carrier; u does not depend on it, since the elements stand half of it apart."""
FIRST = (48, 10)
AXIS = np.linspace(-0.6, 0.6, 2401)
"""u scanned, in steps of 0.03 degrees."""
TARGETS = 2
METHODS: dict[str, Callable[[], Estimator]] = {
    **ESTIMATORS,
    "music-fbss": lambda: Music("forward-backward", targets=TARGETS),
}
"""AIC, which knows only white noise, would count errors of calibration as targets."""
FOUND_WITHIN_DEG = 1.0
SHOWN_DEG = 15.0


class Measured:
    """Does it hold on a real snapshot?"""

    name = "measured"
    cells = name
    title = "A measured snapshot of two reflectors"
    caption = (
        "One measured snapshot of a half-wavelength line of elements, and parts of it. Levels below each spectrum's "
        "maximum; dotted: maximum likelihood of two targets on all elements. Lines reach down from their level where "
        "a method finds lines instead of a spectrum. Maximum likelihood and MUSIC with forward-backward smoothing over "
        "subarrays of half the length (music-fbss, which needs a uniform line) are told that there are two targets, "
        "the others are not. Weaker lines beside the two are what these leave, errors of calibration or echoes, drawn "
        "where they stand above what a method takes for noise."
    )
    summary: tuple[SummaryColumn, ...] = ()

    def obstacle(self, bench: Bench) -> str | None:
        return None if bench.measured else "no --measured file"

    def tasks(self, bench: Bench) -> Sequence[Task]:
        assert bench.measured is not None
        snapshot = read_snapshot(bench.measured)
        content = hashlib.sha256(snapshot.tobytes()).hexdigest()
        return [
            Task(method, name, "", digest([content, elements.tolist()]), partial(_spectrum, snapshot, elements, method))
            for name, elements in element_sets(bench, len(snapshot)).items()
            for method in _methods(elements)
        ]

    def rows(self, bench: Bench, results: Results) -> list[MetricRow]:
        assert bench.measured is not None
        reference = reference_degrees(read_snapshot(bench.measured))
        found = [
            MetricRow(self.name, "ml", "reference", f"angle {n} [deg]", "elements=all", angle, angle, angle, 1)
            for n, angle in enumerate(reference, 1)
        ]
        for (method, array, _), values in results.items():
            angles = _degrees(values["spectrum"])
            for n, angle in enumerate(angles, 1):
                found.append(MetricRow(self.name, method, array, f"angle {n} [deg]", "", angle, math.nan, math.nan, 1))
            both = float(_found_both(values["spectrum"], reference))
            metric = f"both within {FOUND_WITHIN_DEG:g} deg"
            found.append(MetricRow(self.name, method, array, metric, "", both, math.nan, math.nan, 1))
        return found

    def figures(self, bench: Bench, results: Results) -> dict[str, Figure]:
        assert bench.measured is not None
        reference = reference_degrees(read_snapshot(bench.measured))
        look = Look([method for method, _, _ in results], [array for _, array, _ in results])
        columns = min(3, len(look.arrays))
        lines = -(-len(look.arrays) // columns)
        figure = new_figure(4.6 * columns, 3.3 * lines + 0.9, f"{self.title}: {figure_text(bench.measured.name)}")
        axes = subplots(figure, lines, columns, sharex=True, sharey=True)
        degrees = np.rad2deg(np.arcsin(AXIS))
        for axis, array in zip(axes.ravel(), look.arrays, strict=False):
            for (method, of_array, _), values in results.items():
                if of_array == array:
                    spectrum = values["spectrum"].astype(np.float64)
                    axis.plot(degrees, level_db(spectrum, float(spectrum.max())), color=look.colour(method), lw=1.1)
            both = [values["spectrum"] for (_, of_array, _), values in results.items() if of_array == array]
            count = sum(_found_both(spectrum, reference) for spectrum in both)
            for angle in reference:
                axis.axvline(angle, color="grey", lw=0.8, ls=":")
            axis.set(
                title=f"{figure_text(array)}: {count} of {len(both)} find both within {FOUND_WITHIN_DEG:g} deg",
                xlabel="azimuth [deg]",
                xlim=(SHOWN_DEG + 3.5, 3.5 - SHOWN_DEG),
                ylim=(-SPAN_DB, 1.0),
            )
            axis.grid(alpha=0.25)
            axis.tick_params(labelbottom=True)
        for axis in axes.ravel()[len(look.arrays) :]:
            axis.set_visible(False)
        for axis in axes[:, 0]:
            axis.set_ylabel("level [dB]")
        legend_below(figure, look.method_handles())
        return {self.name: figure}


def read_snapshot(path: Path) -> NDArray[np.complex128]:
    """[C] the snapshot of a MATLAB file with one complex vector, or of a complex vector in a .npy file.

    :raises InputError: no such file, not readable, no or several complex vectors, values that are not finite
    """
    if not path.is_file() or path.suffix not in (".mat", ".npy"):
        raise InputError("--measured", f"{path}", "a .mat or .npy file with one complex vector")
    found = {"array": read_npy(path)} if path.suffix == ".npy" else read_complex_arrays(path)
    vectors = {
        k: np.asarray(v) for k, v in found.items() if np.iscomplexobj(v) and np.size(v) == max(np.shape(v), default=0)
    }
    if len(vectors) != 1:
        raise InputError(path, f"complex vectors {sorted(vectors)}", "exactly one")
    snapshot = next(iter(vectors.values())).ravel().astype(np.complex128)
    if len(snapshot) <= 2 * TARGETS or not np.isfinite(snapshot).all():
        raise InputError(path, f"{len(snapshot)} elements", f"more than {2 * TARGETS} finite ones")
    return snapshot


def element_sets(bench: Bench, count: int) -> dict[str, NDArray[np.intp]]:
    """Which elements of the measured line form which array, by its name."""
    sets = {f"all {count}": np.arange(count)}
    sets.update({f"first {first}": np.arange(first) for first in FIRST if first < count})
    line = np.round((bench.radar.array.virtual[:, 1] - bench.radar.array.virtual[:, 1].min()) / _spacing(bench)).astype(
        int
    )
    for contender in bench.contenders:
        places = np.sort(line[contender.channels])
        name = f"{contender.array.name} of {line.max() + 1}"
        if len(places) < len(line) and places[-1] < count:
            sets[name] = places.astype(np.intp)
    return sets


def _spacing(bench: Bench) -> float:
    """Of the grid that the radar's virtual elements stand on [m]; half a wavelength where there is none."""
    line = LineArray(bench.radar.array.virtual[:, 1], bench.radar.waveform.wavelength_m)
    return line.spacing_m or 0.5 * line.wavelength_m


def half_wavelength_line(elements: NDArray[np.intp]) -> LineArray:
    """Elements of a line at half a wavelength; by the measurement's convention u rises with the phase exp(+j pi n
    u)."""
    return LineArray(-0.5 * WAVELENGTH_M * elements.astype(np.float64), WAVELENGTH_M)


def reference_degrees(snapshot: NDArray[np.complex128]) -> NDArray[np.float64]:
    """[2] azimuths by maximum likelihood on all elements [deg], rising."""
    line = half_wavelength_line(np.arange(len(snapshot)))
    return np.rad2deg(np.arcsin(MaximumLikelihood(TARGETS).locate(snapshot[None], line)[0][0]))


def noise_estimate(snapshot: NDArray[np.complex128]) -> float:
    """Power in an element that two lines do not explain: noise and errors of calibration."""
    line = half_wavelength_line(np.arange(len(snapshot)))
    u, amplitude = MaximumLikelihood(TARGETS).locate(snapshot[None], line)
    left = snapshot - line.manifold(u[0]) @ amplitude[0]
    return float(np.sum(np.abs(left) ** 2)) / (len(snapshot) - TARGETS)


def _methods(elements: NDArray[np.intp]) -> list[str]:
    uniform = len(set(np.diff(elements).tolist())) == 1
    return [name for name in METHODS if uniform or name not in UNIFORM_ESTIMATORS]


def _spectrum(snapshot: NDArray[np.complex128], elements: NDArray[np.intp], method: str) -> Values:
    estimator = METHODS[method]()
    line = half_wavelength_line(elements)
    image = estimator.image(snapshot[elements][None], line, AXIS, noise_estimate(snapshot))
    return {"spectrum": image[0].astype(np.float32)}


def _degrees(spectrum: NDArray[np.float32]) -> NDArray[np.float64]:
    """[2] azimuths of the two highest peaks [deg], rising; NaN for those missing."""
    return np.rad2deg(np.arcsin(strongest_peaks(spectrum[None].astype(np.float64), AXIS, TARGETS)[0]))


def _found_both(spectrum: NDArray[np.float32], reference: NDArray[np.float64]) -> bool:
    return bool(np.all(np.abs(_degrees(spectrum) - reference) <= FOUND_WITHIN_DEG))
