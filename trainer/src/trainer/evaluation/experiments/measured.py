"""A measured row of channels, by all estimators and the networks that fit it. Nothing in it is simulated.

A snapshot of a half-wavelength line is looked at whole and in parts, a cube at one range bin and as a picture of what
stands around it, seen from above. Every method lists its lines; what they leave of the row's power says whether they
explain it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from threadpoolctl import threadpool_limits

from shared.physics.errors import InputError, figure_text
from shared.physics.units import power_to_db
from shared.pictures import SPAN_DB, draw_from_above, level_db, range_weighted_db
from shared.signal.model_error import row_noise
from trainer.estimators.array import LineArray, draw_lines
from trainer.estimators.base import ESTIMATORS, UNIFORM_ESTIMATORS
from trainer.estimators.baselines import Music
from trainer.estimators.fitting import fit_lines, score_peaks
from trainer.estimators.lines import line_amplitudes
from trainer.estimators.ml import MaximumLikelihood
from trainer.evaluation.experiments.bench import Bench, Experiment, Results
from trainer.evaluation.experiments.contenders import kind_of
from trainer.evaluation.experiments.measured_input import MeasuredInput, snapshot_radar
from trainer.evaluation.report.figures import Look, colour_bar, legend_below, panels
from trainer.evaluation.report.tables import Numbers
from trainer.evaluation.store import Values
from trainer.metrics.bootstrap import Interval
from trainer.run.answers import Circumstances, NetworkAnswer, estimator_answer, network_answer
from trainer.run.detections import CANDIDATES
from trainer.run.folder import RUN_FILE, load_imager
from trainer.run.other_radars import fitted_imager

COLUMNS = 3
SHOWN_DEG = 15.0
"""On either side of the strongest line, in the cuts of a snapshot."""
FARTHEST = 2.0
"""Of the range of the row: as far as the picture reaches."""
DRAWN_BINS = (3, 3)
"""Range bins and angles over which every level is drawn: a line of one pixel could not be seen."""
PANEL_INCHES = 3.4
"""Width of a panel of the picture from above."""


def cut_figure(
    measured: MeasuredInput,
    title: str,
    spectra: Mapping[tuple[str, str], Values],
    reference: NDArray[np.float64],
    notes: Mapping[str, str],
) -> Figure:
    """Levels over azimuth of all methods, a panel for each array; left of the radar on the left.

    :param spectra: "u" and "spectrum" by (method, array)
    :param reference: angles to be drawn [deg]
    :param notes: beside an array's name
    """
    look = Look(spectra)
    columns = min(COLUMNS, len(look.arrays))
    where = "" if measured.radar is None else f", {measured.place}"
    title = f"{title}: {figure_text(measured.path.name)}{where}"
    lines = -(-len(look.arrays) // columns)
    size = max(4.6 * columns, 7.0), 3.3 * lines + 1.1
    figure, axes = panels(lines, columns, size, title, len(look.arrays), sharex=True, sharey=True)
    for axis, array in zip(axes.ravel(), look.arrays, strict=False):
        for (method, of_array), values in spectra.items():
            if of_array == array:
                spectrum = values["spectrum"].astype(np.float64)
                degrees = np.rad2deg(np.arcsin(values["u"]))
                axis.plot(degrees, level_db(spectrum, float(spectrum.max())), color=look.colour(method), lw=1.1)
        for angle in reference:
            axis.axvline(angle, color="grey", lw=0.8, ls=":")
        name = figure_text(array)
        axis.set(title=f"{name}: {notes[array]}" if array in notes else name, ylim=(-SPAN_DB, 1.0))
        axis.set(xlabel="azimuth [deg]", xlim=_limits(measured, reference))
        axis.grid(alpha=0.25)
        axis.tick_params(labelbottom=True)
    for axis in axes[:, 0]:
        axis.set_ylabel("level [dB]")
    legend_below(figure, look.method_handles())
    return figure


def cartesian_figure(measured: MeasuredInput, images: Mapping[tuple[str, str], Values]) -> Figure:
    """Range-angle images of a cube's strongest Doppler peaks seen from above: y to the left, x ahead [m].

    Levels of amplitude times range, below each image's maximum.

    :param images: "image" [R, U] and "u" by (method, array)
    """
    assert measured.radar is not None
    waveform = measured.radar.waveform
    columns = min(COLUMNS, math.ceil(math.sqrt(len(images))))
    bins = min(max(int(FARTHEST * measured.row), 16), waveform.range_bins)
    # A panel is as high as the range and as wide as twice the largest y.
    widest = 2.0 * max(float(np.abs(values["u"]).max()) for values in images.values())
    lines = -(-len(images) // columns)
    size = PANEL_INCHES * columns + 1.4, (PANEL_INCHES / widest + 0.5) * lines + 0.8
    title = f"Seen from above: {figure_text(measured.path.name)}"
    figure, axes = panels(lines, columns, size, title, len(images), sharex=True, sharey=True)
    for axis, ((method, array), values) in zip(axes.ravel(), images.items(), strict=False):
        levels = maximum_filter(range_weighted_db(values["image"])[:bins], DRAWN_BINS)
        draw_from_above(axis, levels, waveform.range_step_m, values["u"])
        axis.set_title(figure_text(f"{method}, {array}"))
    for axis in axes[-1]:
        axis.set_xlabel("y, to the left [m]")
    for axis in axes[:, 0]:
        axis.set_ylabel("x, ahead [m]")
    colour_bar(figure, axes)
    return figure


def _limits(measured: MeasuredInput, reference: NDArray[np.float64]) -> tuple[float, float]:
    """Azimuths from left to right [deg]: all of a cube's, those around the reference of a snapshot, or all."""
    if measured.radar is None and len(reference):
        middle = float(np.mean(reference))
        return middle + SHOWN_DEG, middle - SHOWN_DEG
    return float(np.rad2deg(np.arcsin(measured.u[-1]))), float(np.rad2deg(np.arcsin(measured.u[0])))


LINES = "lines.md"
"""File of the lines of all methods."""
Found = dict[tuple[str, str], Values]
"""By (method, array)."""
LINE_FIT = "line-fit"
METHODS = (*ESTIMATORS, *UNIFORM_ESTIMATORS, LINE_FIT)
PICTURED = ("das", "iaa", "likes", "omp-cfar")
"""Estimators of which a cube's picture is drawn; the others are as slow as they are alike."""
LEAST_DB = -15.0
"""Lines below a spectrum's maximum that are listed where nobody tells the number of targets: errors of calibration
leave -19 to -21 dB of a row's power."""
MOST_LINES = 8
FOUND_WITHIN_DEG = 1.0
WITHIN = f"within {FOUND_WITHIN_DEG:g} deg"


class Measured(Experiment):
    """The row by every method on every one of its element sets, and by the networks that fit it; of a cube a picture.

    :param methods: of :data:`METHODS` those that are not among them are left out; None for all
    :param networks: with the name that tables have for them, see :func:`fitting_networks`
    """

    name = "measured"
    title = "A measured row"
    caption = (
        "One row of measured channels, and parts of it. Levels below each spectrum's maximum; dotted, where the number "
        "of targets is told: maximum likelihood of as many on all elements. Lines reach down from their level where a "
        "method finds lines instead of a spectrum. Maximum likelihood and MUSIC with forward-backward smoothing over "
        "subarrays of half the length (music-fbss, which needs a uniform line) are told the number of targets where it "
        "is known, the others never are. Every method is told the noise with what the calibration leaves. Weaker lines "
        "are errors of calibration or echoes, drawn where they stand above what a method takes for noise."
    )

    def __init__(
        self,
        measured: MeasuredInput,
        methods: Sequence[str] | None = None,
        networks: Sequence[tuple[str, NetworkAnswer]] = (),
    ) -> None:
        self.measured, self._networks = measured, networks
        self._methods = METHODS if methods is None else tuple(name for name in methods if name in METHODS)
        self._spectra: Found = {}
        self._pictures: Found = {}
        self._reference = np.empty(0)

    def count(self, bench: Bench, results: Results, found: Numbers) -> None:
        with threadpool_limits(limits=1):
            self._look()
        for n, angle in enumerate(self._reference, 1):
            found.known(("ml", "reference"), f"angle {n} [deg]", {"elements": "all"}, float(angle))
        for key, values in self._spectra.items():
            angles = _degrees(values["lines"])
            numbers: dict[str, float] = {}
            for n, (angle, level) in enumerate(zip(angles, values["levels_db"], strict=True), 1):
                numbers |= {f"angle {n} [deg]": float(angle), f"level {n} [dB]": float(level)}
            numbers["power left [dB]"] = float(values["left_db"])
            if len(self._reference):
                which = "both" if len(self._reference) == 2 else "all"
                # As many lines as the reference, each near one.
                as_many = len(angles) == len(self._reference)
                near = as_many and np.all(np.abs(np.sort(angles) - self._reference) <= FOUND_WITHIN_DEG)
                numbers[f"{which} {WITHIN}"] = float(near)
            for metric, value in numbers.items():
                found.add(key, metric, {}, Interval(value, math.nan, math.nan))

    def figures(self, bench: Bench, results: Results, found: Numbers) -> dict[str, Figure]:
        notes = {}  # how many methods find all, where it is known how many there are
        for array in dict.fromkeys(array for _, array in self._spectra):
            near = [row.value for row in found.rows if row.array == array and row.metric.endswith(WITHIN)]
            if near:
                notes[array] = f"{sum(near):.0f} of {len(near)} find all {WITHIN}"
        drawn = {self.name: cut_figure(self.measured, self.title, self._spectra, self._reference, notes)}
        if self._pictures:
            drawn[f"{self.name}-picture"] = cartesian_figure(self.measured, self._pictures)
        return drawn

    def texts(self) -> dict[str, str]:
        return {LINES: _line_list(self.measured, self._spectra, self._reference)}

    def _look(self) -> None:
        measured, methods, frame = self.measured, self._methods, self.measured.frame
        places, left = reference_lines(measured)
        self._reference = _degrees(places)
        for name, elements in measured.elements.items():
            x, line = measured.snapshot[None, elements], measured.line(elements)
            # Where the number of targets is known the noise is what as many lines leave, if that is more.
            noise = np.maximum(row_noise(x, frame.noise_power, frame.model_error_db), left)
            for method in methods:
                if _applies(method, measured, elements):
                    image = _imaging(method, measured.targets)(x, line, measured.u, noise)
                    self._spectra[method, name] = _judged(measured, elements, measured.u, image[0])
        if measured.radar is not None:
            unused = tuple(np.flatnonzero(measured.element < 0).tolist())
            for method in (name for name in PICTURED if name in methods):
                images, _ = estimator_answer(method, measured.radar, unused).peaks(frame)
                key = method, next(iter(measured.elements))
                self._pictures[key] = {"image": images[0], "u": measured.radar.grid.u}
        for name, answer in self._networks:
            key, u = (name, answer.array.name), answer.radar.grid.u
            images, _ = answer.images(frame.cells.range_channel, Circumstances(frame.noise_power, frame.model_error_db))
            if measured.radar is not None:
                self._pictures[key] = {"image": images[0], "u": u}
            spectrum = images[0, measured.row].astype(np.float64)
            self._spectra[key] = _judged(measured, measured.element[answer.channels], u, spectrum)


def fitting_networks(
    measured: MeasuredInput, runs: Sequence[Path]
) -> tuple[list[tuple[str, NetworkAnswer]], list[str]]:
    """(the runs whose array the row has, with their names; a line for each other one).

    :raises InputError: a run that cannot be read
    """
    networks, obstacles = [], []
    for path in runs:
        try:
            run, imager = load_imager(path)
            radar = measured.radar or snapshot_radar(measured, run.radar)
            fitted, channels, _ = fitted_imager(run, imager, str(path), radar, str(measured.path))
            answer = network_answer(run, fitted, channels, radar)
            if (measured.element[answer.channels] < 0).any():
                problem = f"a channel of {run.array.name!r} is dead or off the line"
                raise InputError(measured.path, problem, "all of them alive")
            name = f"{kind_of(run)}:{path.resolve().name}" if len(runs) > 1 else kind_of(run)
            networks.append((name, answer))
        except InputError as error:
            if not path.joinpath(RUN_FILE).is_file():
                raise
            obstacles.append(f"left out: {error}")
    return networks, obstacles


def _line_list(measured: MeasuredInput, spectra: Found, reference: NDArray[np.float64]) -> str:
    """Markdown: the lines of all methods beside each other, a table for each array, and what they leave."""
    tables = []
    for array in dict.fromkeys(array for _, array in spectra):
        lines = [f"| {array} | azimuth [deg] (level [dB]) | power left [dB] |", "|---|---|---|"]
        for (method, of_array), values in spectra.items():
            if of_array == array:
                pairs = zip(_degrees(values["lines"]), values["levels_db"], strict=True)
                listed = ", ".join(f"{angle:.2f} ({level:.1f})" for angle, level in pairs if np.isfinite(angle))
                lines.append(f"| {method} | {listed} | {float(values['left_db']):.1f} |")
        tables.append("\n".join(lines) + "\n")
    told = ""
    if measured.targets is not None:
        angles = ", ".join(f"{angle:.3f}" for angle in reference)
        told = f", {measured.targets} told (maximum likelihood of as many on all elements: {angles} deg)"
    where = "" if measured.radar is None else f", {measured.place}"
    error_db = measured.frame.model_error_db
    error = "no model error" if math.isinf(error_db) else f"model error {error_db:g} dB"
    return f"Measured row{where}{told}, {error}\n\n" + "\n".join(tables)


def reference_lines(measured: MeasuredInput) -> tuple[NDArray[np.float64], float]:
    """([K] u by maximum likelihood on all elements, rising, what these lines leave in a channel [W]).

    None, and nothing left, where the number of targets is not known.
    """
    if measured.targets is None:
        return np.empty(0), 0.0
    count = len(measured.snapshot)
    line = measured.line(np.arange(count))
    u, amplitude = MaximumLikelihood(measured.targets).locate(measured.snapshot[None], line)
    left = measured.snapshot - line.manifold(u[0]) @ amplitude[0]
    return u[0], float(np.sum(np.abs(left) ** 2)) / (count - measured.targets)


def _applies(method: str, measured: MeasuredInput, elements: NDArray[np.intp]) -> bool:
    """MUSIC with smoothing needs a uniform line, maximum likelihood a number of targets."""
    if method in UNIFORM_ESTIMATORS:
        gaps = np.diff(np.sort(measured.positions_m[elements])) / measured.wavelength_m
        return len(gaps) > 0 and bool(np.ptp(gaps) < 1e-3 and gaps.min() > 1e-3)
    return method != "ml" or measured.targets is not None


def _imaging(method: str, targets: int | None) -> Callable[..., NDArray[np.float64]]:
    """What makes [1, U] of one row, a line, angles [U] and the row's noise."""
    if method == LINE_FIT:
        return _fitted_lines
    if method == "ml" and targets is not None:
        return MaximumLikelihood(targets).image
    # AIC knows white noise alone: it counts errors of calibration as targets where it is not told their number.
    return Music("forward-backward", targets).image if method == "music-fbss" else ESTIMATORS[method]().image


def _fitted_lines(
    row: NDArray[np.complexfloating], array: LineArray, u: NDArray[np.floating], noise_power: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The lines of :func:`trainer.estimators.fitting.fit_lines` from the peaks of LIKES on; they are told all noise."""
    candidates = score_peaks(ESTIMATORS["likes"]().image(row, array, u, noise_power), u, CANDIDATES)
    lines = fit_lines(row, array, float(noise_power[0]), candidates, -np.inf)
    angles = np.where(np.isfinite(lines.u), lines.u, 0.0)
    return draw_lines(angles, np.abs(lines.amplitude), array, u)


def _judged(
    measured: MeasuredInput, elements: NDArray[np.intp], u: NDArray[np.float64], spectrum: NDArray[np.float64]
) -> Values:
    """Spectrum, its lines with their levels below its maximum [dB], and the power that lines there leave [dB]."""
    x, targets = measured.snapshot[None, elements], measured.targets
    lines = score_peaks(spectrum[None], u, targets or MOST_LINES)[0]
    heights = np.interp(np.nan_to_num(lines), u, spectrum)
    levels = power_to_db((heights / max(spectrum.max(), np.finfo(np.float64).tiny)) ** 2)
    levels[np.isnan(lines)] = -np.inf
    if targets is None:
        lines, levels = lines[levels >= LEAST_DB], levels[levels >= LEAST_DB]
    else:
        order = np.argsort(lines)
        lines, levels = lines[order], levels[order]
    seen = lines[np.isfinite(lines)][None]
    left = line_amplitudes(x, seen, measured.line(elements))[1] if seen.size else x
    left_db = power_to_db(np.sum(np.abs(left) ** 2) / np.sum(np.abs(x) ** 2))
    return {
        "u": np.asarray(u), "spectrum": spectrum.astype(np.float32), "lines": lines,
        "levels_db": np.where(np.isfinite(levels), levels, -400.0), "left_db": np.asarray(left_db),
    }  # fmt: skip


def _degrees(u: NDArray[np.floating]) -> NDArray[np.float64]:
    return np.rad2deg(np.arcsin(np.clip(u, -1.0, 1.0)))
