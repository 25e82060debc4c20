"""A measured row of channels, by all estimators and the networks that fit it. Nothing in it is simulated.

A snapshot of a half-wavelength line is looked at whole and in parts, a cube at one range bin and as a picture. Every
method lists its lines; what they leave of the row's power says whether they explain it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import torch
from matplotlib.figure import Figure
from numpy.typing import NDArray

from shared.physics.units import power_to_db
from shared.signal.model_error import row_noise
from trainer.estimators.array import draw_lines
from trainer.estimators.base import ESTIMATORS, UNIFORM_ESTIMATORS, Estimator, LineArray
from trainer.estimators.fitting import fit_lines, score_peaks
from trainer.estimators.lines import line_amplitudes
from trainer.estimators.ml import MaximumLikelihood
from trainer.estimators.music import Music
from trainer.evaluation.experiments.bench import Bench, MeasuredNetwork, Results, Task
from trainer.evaluation.experiments.measured_figures import cartesian_figure, cut_figure
from trainer.evaluation.experiments.measured_input import MeasuredInput
from trainer.evaluation.rows import MetricRow, SummaryColumn
from trainer.evaluation.store import Values, digest
from trainer.run.detections import CANDIDATES

LINE_FIT = "line-fit"
METHODS = (*ESTIMATORS, *UNIFORM_ESTIMATORS, LINE_FIT)
PICTURED = ("das", "iaa", "likes", "omp-cfar")
"""Estimators of which a cube's picture is drawn; the others are as slow as they are alike."""
LEAST_DB = -15.0
"""Lines below a spectrum's maximum that are listed where nobody tells the number of targets: errors of calibration
leave -19 to -21 dB of a row's power."""
MOST_LINES = 8
FOUND_WITHIN_DEG = 1.0
HANN = (0.0, -0.5, 1.0, -0.5, 0.0)
"""What a point in the middle of a range bin is in its neighbours: a network that looks along range is shown a snapshot
so."""
PICTURE = "picture"


class Measured:
    """Does it hold on real hardware?"""

    name = "measured"
    cells = name
    title = "A measured row"
    caption = (
        "One row of measured channels, and parts of it. Levels below each spectrum's maximum; dotted, where the number "
        "of targets is told: maximum likelihood of as many on all elements. Lines reach down from their level where a "
        "method finds lines instead of a spectrum. Maximum likelihood and MUSIC with forward-backward smoothing over "
        "subarrays of half the length (music-fbss, which needs a uniform line) are told the number of targets where it "
        "is known, the others never are. Every method is told the noise with what the calibration leaves. Weaker lines "
        "are errors of calibration or echoes, drawn where they stand above what a method takes for noise."
    )
    summary: tuple[SummaryColumn, ...] = ()

    def obstacle(self, bench: Bench) -> str | None:
        return None if bench.measured else "no --measured file"

    def tasks(self, bench: Bench) -> Sequence[Task]:
        measured = _measured(bench)
        tasks = [
            Task(method, name, "", digest([measured.sha256, elements.tolist()]), partial(_cell, measured, name, method))
            for name, elements in measured.elements.items()
            for method in bench.measured_methods or METHODS
            if _applies(method, measured, elements)
        ]
        everything = next(iter(measured.elements))
        if measured.frame is not None:
            tasks += [
                Task(method, everything, PICTURE, digest([measured.sha256]), partial(_picture, measured, method))
                for method in bench.measured_methods or PICTURED
                if method in PICTURED
            ]
        for network in bench.measured_networks:
            inputs = digest([measured.sha256, network.inputs])
            tasks.append(Task(network.name, network.array, "", inputs, partial(_network_cell, measured, network)))
            if measured.frame is not None:
                picture = partial(_network_picture, measured, network)
                tasks.append(Task(network.name, network.array, PICTURE, inputs, picture))
        return tasks

    def rows(self, bench: Bench, results: Results) -> list[MetricRow]:
        measured = _measured(bench)
        reference = reference_degrees(measured)

        def row(method: str, array: str, metric: str, value: float, condition: str = "") -> MetricRow:
            known = method == "ml" and array == "reference"
            return MetricRow(
                self.name, method, array, metric, condition, value, *((value, value) if known else (math.nan,) * 2), 1
            )

        found = [
            row("ml", "reference", f"angle {n} [deg]", angle, "elements=all") for n, angle in enumerate(reference, 1)
        ]
        for (method, array, condition), values in results.items():
            if condition == PICTURE:
                continue
            angles = _degrees(values["lines"])
            for n, (angle, level) in enumerate(zip(angles, values["levels_db"], strict=True), 1):
                found.append(row(method, array, f"angle {n} [deg]", float(angle)))
                found.append(row(method, array, f"level {n} [dB]", float(level)))
            found.append(row(method, array, "power left [dB]", float(values["left_db"])))
            if len(reference):
                metric = f"{'both' if len(reference) == 2 else 'all'} within {FOUND_WITHIN_DEG:g} deg"
                found.append(row(method, array, metric, float(_all_found(angles, reference))))
        return found

    def figures(self, bench: Bench, results: Results) -> dict[str, Figure]:
        measured = _measured(bench)
        reference = reference_degrees(measured)
        spectra = {(m, a): values for (m, a, condition), values in results.items() if condition != PICTURE}
        counts: dict[str, tuple[int, int]] = {}
        for (_, array), values in spectra.items():
            found, of = counts.get(array, (0, 0))
            counts[array] = found + _all_found(_degrees(values["lines"]), reference), of + 1
        notes = {a: f"{n} of {of} find all within {FOUND_WITHIN_DEG:g} deg" for a, (n, of) in counts.items()}
        figures = {self.name: cut_figure(measured, self.title, spectra, reference, notes if len(reference) else {})}
        if measured.frame is not None:
            images = {(m, a): v for (m, a, condition), v in results.items() if condition == PICTURE}
            if images:
                figures[f"{self.name}-picture"] = cartesian_figure(measured, images)
        return figures


def line_list(bench: Bench, results: Results) -> str:
    """Markdown: the lines of all methods beside each other, a table for each array, and what they leave."""
    measured = _measured(bench)
    tables = []
    arrays = list(dict.fromkeys(array for _, array, condition in results if condition != PICTURE))
    for array in arrays:
        lines = [f"| {array} | azimuth [deg] (level [dB]) | power left [dB] |", "|---|---|---|"]
        for (method, of_array, condition), values in results.items():
            if of_array == array and condition != PICTURE:
                pairs = zip(_degrees(values["lines"]), values["levels_db"], strict=True)
                listed = ", ".join(f"{angle:.2f} ({level:.1f})" for angle, level in pairs if np.isfinite(angle))
                lines.append(f"| {method} | {listed} | {float(values['left_db']):.1f} |")
        tables.append("\n".join(lines) + "\n")
    told = ""
    if measured.targets is not None:
        angles = ", ".join(f"{angle:.3f}" for angle in reference_degrees(measured))
        told = f", {measured.targets} told (maximum likelihood of as many on all elements: {angles} deg)"
    where = ""
    if measured.radar is not None:
        where = f", range {measured.row * measured.radar.waveform.range_step_m:.2f} m"
    error = "no model error" if math.isinf(measured.model_error_db) else f"model error {measured.model_error_db:g} dB"
    return f"Measured row{where}{told}, {error}\n\n" + "\n".join(tables)


def reference_degrees(measured: MeasuredInput) -> NDArray[np.float64]:
    """[K] azimuths by maximum likelihood on all elements [deg], rising; none where the number is not known."""
    if measured.targets is None:
        return np.empty(0)
    line = measured.line(np.arange(len(measured.snapshot)))
    return _degrees(MaximumLikelihood(measured.targets).locate(measured.snapshot[None], line)[0][0])


def told_noise(measured: MeasuredInput, elements: NDArray[np.intp]) -> NDArray[np.float64]:
    """[1] noise of the row that every method is told, with the model error.

    Where the number of targets is known it is what as many lines by maximum likelihood on all elements leave, if that
    is more.
    """
    stated = row_noise(measured.snapshot[None, elements], measured.noise_power, measured.model_error_db)
    if measured.targets is None:
        return np.asarray(stated)
    count = len(measured.snapshot)
    line = measured.line(np.arange(count))
    u, amplitude = MaximumLikelihood(measured.targets).locate(measured.snapshot[None], line)
    left = measured.snapshot - line.manifold(u[0]) @ amplitude[0]
    return np.maximum(stated, float(np.sum(np.abs(left) ** 2)) / (count - measured.targets))


def _measured(bench: Bench) -> MeasuredInput:
    assert bench.measured is not None
    return bench.measured


def _applies(method: str, measured: MeasuredInput, elements: NDArray[np.intp]) -> bool:
    """MUSIC with smoothing needs a uniform line, maximum likelihood a number of targets."""
    if method in UNIFORM_ESTIMATORS:
        gaps = np.diff(np.sort(measured.positions_m[elements])) / measured.wavelength_m
        return len(gaps) > 0 and bool(np.ptp(gaps) < 1e-3 and gaps.min() > 1e-3)
    return method != "ml" or measured.targets is not None


def _estimator(method: str, targets: int | None) -> Estimator:
    if method == LINE_FIT:
        return LineFit()
    if method == "ml":
        assert targets is not None
        return MaximumLikelihood(targets)
    # AIC knows white noise alone: it counts errors of calibration as targets where it is not told their number.
    made: dict[str, Callable[[], Estimator]] = {**ESTIMATORS, "music-fbss": lambda: Music("forward-backward", targets)}
    return made[method]()


class LineFit:
    """The lines of :func:`trainer.estimators.fitting.fit_lines` from the peaks of LIKES on."""

    name = LINE_FIT

    def image(
        self, snapshots: NDArray[np.complexfloating], array: LineArray, u: NDArray[np.floating], noise_power: object
    ) -> NDArray[np.float64]:
        """[R, U] lines; the noise of each row is all noise that the fit is told."""
        noise = np.broadcast_to(np.asarray(noise_power, dtype=np.float64), len(snapshots))
        score = ESTIMATORS["likes"]().image(snapshots, array, u, noise)
        found = np.zeros((len(snapshots), len(u)))
        for row, (x, power) in enumerate(zip(snapshots, noise, strict=True)):
            candidates = score_peaks(score[row : row + 1], u, CANDIDATES)
            lines = fit_lines(x[None], array, float(power), candidates, -np.inf)
            angles = np.where(np.isfinite(lines.u), lines.u, 0.0)
            found[row] = draw_lines(angles, np.abs(lines.amplitude), array, u)[0]
        return found


def _cell(measured: MeasuredInput, name: str, method: str) -> Values:
    elements = measured.elements[name]
    x, line = measured.snapshot[None, elements], measured.line(elements)
    estimator = _estimator(method, measured.targets)
    spectrum = estimator.image(x, line, measured.u, told_noise(measured, elements))[0]
    return _judged(spectrum, measured.u, x, line, measured.targets)


def _network_cell(measured: MeasuredInput, network: MeasuredNetwork) -> Values:
    line = measured.line(network.elements)
    if measured.frame is None:
        rows = np.array(HANN)[:, None] * measured.snapshot
        image = _network_images(network, rows[None].astype(np.complex64), measured.noise_power, measured)[0]
        spectrum = image[HANN.index(1.0)]
    else:
        strongest = measured.frame.range_channel[:1]
        image = _network_images(network, strongest, measured.frame.noise_power, measured)[0]
        spectrum = image[measured.row]
    x = measured.snapshot[None, network.elements]
    return _judged(spectrum.astype(np.float64), network.u, x, line, measured.targets)


def _judged(
    spectrum: NDArray[np.float64],
    u: NDArray[np.float64],
    x: NDArray[np.complex128],
    line: LineArray,
    targets: int | None,
) -> Values:
    """Spectrum, its lines with their levels below its maximum [dB], and the power that lines there leave [dB]."""
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
    left = line_amplitudes(x, seen, line)[1] if seen.size else x
    left_db = power_to_db(np.sum(np.abs(left) ** 2) / np.sum(np.abs(x) ** 2))
    return {
        "u": np.asarray(u), "spectrum": spectrum.astype(np.float32), "lines": lines,
        "levels_db": np.where(np.isfinite(levels), levels, -400.0), "left_db": np.asarray(left_db),
    }  # fmt: skip


def _picture(measured: MeasuredInput, method: str) -> Values:
    """[R, U] image of the strongest Doppler peaks of a cube."""
    assert measured.frame is not None
    assert measured.radar is not None
    rows = measured.rows.astype(np.complex128)
    noise = np.asarray(row_noise(rows, measured.noise_power, measured.model_error_db))
    line = measured.line(np.arange(rows.shape[1]))
    image = _estimator(method, measured.targets).image(rows, line, measured.radar.grid.u, noise)
    return {"image": image.astype(np.float32), "u": measured.radar.grid.u}


def _network_picture(measured: MeasuredInput, network: MeasuredNetwork) -> Values:
    assert measured.frame is not None
    strongest = measured.frame.range_channel[:1]
    return {"image": _network_images(network, strongest, measured.frame.noise_power, measured)[0], "u": network.u}


def _network_images(
    network: MeasuredNetwork, range_channel: NDArray[np.complex64], noise_power: float, measured: MeasuredInput
) -> NDArray[np.float32]:
    """[B, R, U] images of range-channel matrices [B, R, C]."""
    with torch.inference_mode():
        snapshots = torch.from_numpy(np.array(range_channel))
        noise = torch.full((len(snapshots),), noise_power, dtype=torch.float64)
        return np.asarray(network.imager(snapshots, noise, measured.model_error_db).numpy(), dtype=np.float32)


def _degrees(u: NDArray[np.floating]) -> NDArray[np.float64]:
    return np.rad2deg(np.arcsin(np.clip(u, -1.0, 1.0)))


def _all_found(angles: NDArray[np.float64], reference: NDArray[np.float64]) -> bool:
    """Whether the lines, as many as the reference, are each near one."""
    if len(angles) != len(reference):
        return False
    return bool(np.all(np.abs(np.sort(angles) - reference) <= FOUND_WITHIN_DEG))
