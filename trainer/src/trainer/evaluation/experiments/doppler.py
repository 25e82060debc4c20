"""Something that moves, seen in up to three Doppler peaks of a range bin (the paper's Fig. 12: an approaching truck).

The strongest Doppler cell of a range bin is often the street's. What approaches there stands in the second or third
peak, and is imaged if those are imaged too; the images are merged by their maximum.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from shared.dataset import Frame, Target
from shared.dataset.reading import read_frame
from shared.physics.errors import figure_text
from shared.pictures import COLOUR_MAP, SPAN_DB, hold_peaks, level_db, range_weighted, range_weighted_db
from shared.radar import Radar
from shared.signal.ego_motion import folded
from trainer.data.measurements import known_world
from trainer.evaluation.experiments.bench import Bench, FrameRef, Results
from trainer.evaluation.experiments.contenders import Contender
from trainer.evaluation.experiments.frames import FrameByFrame, load_frame, true_magnitude
from trainer.evaluation.report.figures import PANEL_PIXELS, colour_bar, draw_image, panels
from trainer.evaluation.report.page import doppler_map
from trainer.evaluation.report.tables import Numbers
from trainer.evaluation.store import Values
from trainer.metrics.detection import find_image_peaks
from trainer.run.imager import PROBABILITY

MOST_FRAMES = 8
"""Each is three images."""
REACH_BINS, REACH_ROWS, REACH_CELLS = 4, 1, 1.5
"""How far from a target a peak may be: angle bins, range bins, Doppler cells."""
LEVEL = 0.1
"""Height and prominence of a peak that counts, of its range bin's maximum: a truck beside a wall."""
PLACES = ("in the strongest Doppler peak", "in a weaker Doppler peak")


class Doppler(FrameByFrame):
    """Is what moves found behind what stands?"""

    name = "doppler"
    title = "What moves, in up to three Doppler peaks (paper, Fig. 12)"
    caption = (
        "From left: the range-Doppler map where the dataset stores it, else the Doppler peaks of every range bin "
        "with their level; the images of the strongest, second and third peak, the latter where a range bin has "
        "them; their maximum; the truth of the strongest peaks, and circles where targets have the velocity of a "
        "weaker one. The table has the share of targets found within 4 angle bins in an image of their own Doppler "
        "cell, by the strongest peak alone and by all."
    )

    def obstacle(self, bench: Bench) -> str | None:
        return None if bench.radar.waveform.chirps > 1 else "the radar sends one chirp a frame"

    def frames(self, bench: Bench) -> Sequence[FrameRef]:
        return moving_frames(bench)

    def inputs(self, bench: Bench) -> object:
        return [bench.data_sha256, moving_frames(bench)[0].frame_id, *shown_contender(bench).key]

    def score(self, bench: Bench, contender: Contender, place: int, scene: Frame) -> Values:
        return score_peaks(bench.radar, contender, scene, place == 0 and contender is shown_contender(bench))

    def count(self, bench: Bench, results: Results, found: Numbers) -> None:
        frames = moving_frames(bench)
        for contender in bench.contenders:
            counts = np.stack([results[*contender.key, ref.condition]["found"] for ref in frames])
            for index, place in enumerate(PLACES):
                total, condition = counts[:, index, 0], {"target": place}
                for column, peaks in ((1, "the strongest Doppler peak alone"), (2, "all Doppler peaks")):
                    found.ratio(contender.key, f"targets found by {peaks}", condition, counts[:, index, column], total)
        rows = [float(np.any(f.velocity[1:] != f.velocity[0], axis=0).sum()) for f in map(load_frame, frames)]
        # The number is a property of the data, the same for all contenders; the first one's row holds it.
        found.mean(bench.contenders[0].key, "range bins with a second peak", {}, rows)

    def figures(self, bench: Bench, results: Results, found: Numbers) -> dict[str, Figure]:
        contender, ref = shown_contender(bench), moving_frames(bench)[0]
        cell = results[*contender.key, ref.condition]
        images = cell["images"].astype(np.float64)
        frame, radar = read_frame(ref.path, ref.row), bench.radar
        shown = (
            images if contender.answer.unit == PROBABILITY else np.stack([range_weighted(image) for image in images])
        )
        # Where a range bin has fewer peaks, the dataset repeats the strongest; the figure shows it once.
        shown[1:][frame.velocity[1:] == frame.velocity[0]] = 0.0
        reference = float(shown.max())
        title = f"{self.title}: {figure_text(ref.scene)}, frame {ref.frame_id}, {figure_text(contender.name)}"
        targets, by_strongest, by_all = cell["found"][1]
        if targets:
            title += f": of {targets:.0f} targets in a weaker peak "
            title += f"{by_strongest:.0f} found by the strongest alone, {by_all:.0f} by all"
        ratios = [1.4, *[1.0] * (len(images) + 2)]
        figure, axes = panels(1, len(ratios), (2.2 * len(ratios) + 1.5, 4.4), title, width_ratios=ratios)
        _draw_range_doppler(axes[0, 0], frame, radar)
        names = ["strongest peak", "second peak", "third peak", *(f"peak {n}" for n in range(4, len(images) + 1))]
        pictures = [*zip(names, (level_db(image, reference) for image in shown), strict=False)]
        pictures.append(("maximum of all", level_db(shown.max(axis=0), reference)))
        truth = range_weighted(true_magnitude(load_frame(ref)))
        pictures.append(("truth of the strongest", level_db(truth, float(truth.max()))))
        moving = _moving(frame, radar)
        for axis, (name, levels) in zip(axes[0, 1:], pictures, strict=True):
            draw_image(axis, levels, radar, name)
            axis.set(xlabel="u = sin(azimuth)", yticklabels=[])
        axes[0, -1].plot([t.u for t in moving], [t.range_m for t in moving], "o", mfc="none", mec="cyan", ms=5, mew=0.7)
        axes[0, 0].set_ylim(axes[0, 1].get_ylim())
        colour_bar(figure, axes[0])
        return {self.name: figure}


@lru_cache(maxsize=1)
def moving_frames(bench: Bench) -> tuple[FrameRef, ...]:
    """Up to :data:`MOST_FRAMES`, those with most targets outside the strongest Doppler peak first."""
    return tuple(sorted(bench.frames, key=lambda ref: -len(_moving(load_frame(ref), bench.radar)))[:MOST_FRAMES])


def shown_contender(bench: Bench) -> Contender:
    """The first network of whole images; the first contender where there is none."""
    networks = [contender for contender in bench.contenders if contender.parameters and not contender.answer.row_wise]
    return networks[0] if networks else bench.contenders[0]


def _moving(frame: Frame, radar: Radar) -> list[Target]:
    """The targets outside the strongest Doppler peak."""
    return [target for target in frame.targets if _place(target, frame, radar) == 1]


def _place(target: Target, frame: Frame, radar: Radar) -> int | None:
    """0: in the strongest Doppler peak of its range bin, 1: in a weaker one, None: in none, or out of the image."""
    row = round(target.range_m / radar.waveform.range_step_m)
    if not (0 <= row < radar.waveform.range_bins and radar.grid.u_start <= target.u < radar.grid.u_stop):
        return None
    near = _same_velocity(frame.velocity[:, row], target.velocity_mps, radar)
    return 0 if near[0] else 1 if near.any() else None


def _same_velocity(velocities: NDArray[np.floating], velocity_mps: float, radar: Radar) -> NDArray[np.bool_]:
    """Whether Doppler cells hold a velocity, which folds at the ends of the axis."""
    difference = folded(np.asarray(velocities, dtype=np.float64) - velocity_mps, radar.waveform.velocity_span_mps)
    return np.abs(difference) <= REACH_CELLS * radar.waveform.velocity_step_mps


def score_peaks(radar: Radar, contender: Contender, frame: Frame, keep: bool) -> Values:
    """found [2 places, 3]: targets, found by the strongest peak's image, found by any; images [D, R, U] if kept."""
    answer, world = contender.answer, known_world(vars(frame), radar)
    images = [
        answer.image_and_score(snapshot, frame.noise_power, world[peak])[0]
        for peak, snapshot in enumerate(frame.range_channel)
    ]
    counts = np.zeros((len(PLACES), 3))
    for target in frame.targets:
        if (place := _place(target, frame, radar)) is not None:
            peaks = zip(images, frame.velocity, strict=True)
            hits = [_found(image, velocity, target, radar) for image, velocity in peaks]
            counts[place] += [1, hits[0], any(hits)]
    return {"found": counts, **({"images": np.array(images, dtype=np.float32)} if keep else {})}


def _found(image: NDArray[np.floating], velocity: NDArray[np.floating], target: Target, radar: Radar) -> bool:
    """Is there a peak near the target in one of its range bins that holds its velocity?"""
    row = round(target.range_m / radar.waveform.range_step_m)
    column = (target.u - radar.grid.u_start) / radar.grid.step
    for near in range(max(row - REACH_ROWS, 0), min(row + REACH_ROWS + 1, len(image))):
        if _same_velocity(velocity[near : near + 1], target.velocity_mps, radar)[0]:
            peaks = find_image_peaks(image[near : near + 1], LEVEL).above(LEVEL).bins
            if np.any(np.abs(peaks - column) <= REACH_BINS):
                return True
    return False


def _draw_range_doppler(axis: Axes, frame: Frame, radar: Radar) -> None:
    waveform = radar.waveform
    title, magnitude = doppler_map(frame, radar)
    levels, rows, _ = hold_peaks(range_weighted_db(magnitude), (PANEL_PIXELS[0], waveform.chirps))
    velocities, step = waveform.velocities_mps, waveform.velocity_step_mps
    far = (rows * len(levels) - 0.5) * waveform.range_step_m
    extent = (velocities[0] - 0.5 * step, velocities[-1] + 0.5 * step, -0.5 * waveform.range_step_m, far)
    axis.imshow(
        levels, origin="lower", aspect="auto", cmap=COLOUR_MAP, extent=extent, vmin=-SPAN_DB, vmax=0.0,
        interpolation="nearest",
    )  # fmt: skip
    axis.set(title=title, xlabel="velocity [m/s], receding", ylabel="range [m]", ylim=(0.0, waveform.ranges_m[-1]))
