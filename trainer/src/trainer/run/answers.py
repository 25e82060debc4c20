"""Network or estimator: range-channel matrices to images, and to scores of them. Predictions, evaluations, measured
rows and the verdict of a fit all ask here."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray

from shared.physics.errors import InputError
from shared.physics.units import db_to_power
from shared.radar import Radar
from shared.signal.adaptive import scanned_angles
from shared.signal.ego_motion import EgoMotion, StaticWorld, estimated_motion, folded, velocity_period_mps
from shared.signal.model_error import NO_MODEL_ERROR_DB, row_noise
from shared.signal.tdm import averaged
from trainer.data.arrays import ArrayChoice
from trainer.data.measurements import Measurement
from trainer.estimators.adaptive import VirtualView
from trainer.estimators.array import POINTS_PER_CELL, LineArray, line_array, uniform_axis
from trainer.estimators.base import ESTIMATORS, Estimator
from trainer.estimators.baselines import DelayAndSum
from trainer.metrics.cells import CellScores, score_cells
from trainer.run.folder import Run
from trainer.run.imager import AMPLITUDE, UNITS, Imager, best_device

CLEAR_DB = 20.0
"""Of a cell's strongest angle over the noise there: its angle is then right to a tenth of a resolution cell."""
MOST_DETECTIONS = 400
"""The strongest, relative to the noise, that are asked for the velocity."""
NEAR_BINS, NEAR_CELLS = 2, 2.5
"""Range bins and Doppler cells that an echo's response reaches, with Hann windows over both."""

Images = tuple[NDArray[np.floating], NDArray[np.float32] | None]
"""([B, R, U] images, [B, R, U] probability of a target or None)."""


@dataclass(frozen=True, eq=False)
class Circumstances:
    """What a method is told beside the channels.

    :param noise_power: of a channel and cell [W]
    :param model_error_db: power of a row that no plane wave explains, of the row's [dB]
    :param world: what the sensor's motion says of these rows, [B, R] of them, for methods that use it
    """

    noise_power: float
    model_error_db: float = NO_MODEL_ERROR_DB
    world: StaticWorld | None = None

    def __getitem__(self, rows: int | NDArray[np.bool_] | None) -> Circumstances:
        """Of some of the rows."""
        return self if self.world is None else replace(self, world=self.world[rows])


@dataclass(frozen=True, eq=False)
class Answer(ABC):
    """A method that images range-channel matrices of one radar.

    :param array: the channels that it looks at, as output files name them
    :param channels: [C] those among the radar's
    :param radar: of the data, its grid that of the images
    """

    name: str
    array: ArrayChoice
    channels: NDArray[np.intp]
    radar: Radar

    @cached_property
    def line(self) -> LineArray:
        """The places of its channels."""
        return line_array(self.radar, self.channels)

    @abstractmethod
    def images(self, range_channel: NDArray[np.complexfloating], told: Circumstances) -> Images:
        """Of matrices [B, R, C] of all the radar's channels [sqrt(W)]."""

    @abstractmethod
    def peaks(self, measurement: Measurement) -> Images:
        """:meth:`images` of each Doppler peak of a frame (paper, section II-E).

        The strongest peaks of all range bins first, then the second strongest and so on. A peak that repeats an earlier
        one of its range bin is computed once.
        """

    def baseline(self, measurement: Measurement) -> NDArray[np.floating]:
        """[R, U] delay-and-sum image of the same channels, the maximum over the peaks [sqrt(W)]."""
        seen_by = self.array, self.channels, self.radar
        plain = EstimatorAnswer("das", *seen_by, DelayAndSum())
        return np.asarray(plain.peaks(measurement)[0].max(axis=0))

    @property
    def unit(self) -> str:
        """Of its images."""
        return AMPLITUDE

    @property
    def row_wise(self) -> bool:
        """Whether an image row depends on nothing but that row's snapshot."""
        return True

    @property
    def detects(self) -> bool:
        """Whether it ranks its detections by more than their level."""
        return False

    @property
    def uses_motion(self) -> bool:
        """Whether its images depend on the sensor's motion."""
        return False

    def _circumstances(self, measurement: Measurement) -> Circumstances:
        """What is known of the frame's rows [D, R]."""
        motion = measurement.motion
        world = None if motion is None else StaticWorld(motion, measurement.cells.velocity, self.radar)
        return Circumstances(measurement.noise_power, measurement.model_error_db, world)

    def seen_motion(self, measurement: Measurement) -> EgoMotion | None:
        """The sensor's motion as these channels see it in the frame, which seeds what is drawn: the velocity that its
        cells agree on, see :func:`shared.signal.ego_motion.estimated_motion`.

        Each echo stands for one detection, at the strongest angle of delay-and-sum, in the strongest of its cells.
        """
        seen, line, noise_power = measurement.cells, self.line, measurement.noise_power
        new = seen.new
        cells = np.asarray(seen.range_channel[new][:, self.channels], dtype=np.complex128)
        axis = uniform_axis(line, POINTS_PER_CELL)
        magnitude = np.abs(cells @ line.manifold(axis).conj()) / line.channels
        level = magnitude.max(axis=1)
        clear = np.flatnonzero(level > np.sqrt(db_to_power(CLEAR_DB) * noise_power / line.channels))
        strongest = clear[np.argsort(-level[clear], kind="stable")[:MOST_DETECTIONS]]
        velocity_mps = np.asarray(seen.velocity[new], dtype=np.float64)[strongest]
        u, range_bin = axis[magnitude[strongest].argmax(axis=1)], np.nonzero(new)[1][strongest]
        # An echo shows in several bins and cells alike, which are no more evidence than one.
        away_mps = folded(velocity_mps[:, None] - velocity_mps, velocity_period_mps(self.radar))
        alike = (
            (np.abs(range_bin[:, None] - range_bin) <= NEAR_BINS)
            & (np.abs(away_mps) <= NEAR_CELLS * self.radar.waveform.velocity_step_mps)
            & (np.abs(u[:, None] - u) <= line.resolution_cell)
        )
        echo = ~np.tril(alike, -1).any(axis=1)  # nothing like it is stronger
        return estimated_motion(u[echo], velocity_mps[echo], self.radar, measurement.frame_id)

    def image(self, range_channel: NDArray[np.complexfloating], noise_power: float) -> NDArray[np.float64]:
        """[R, U] of one matrix [R, C]."""
        return self.image_and_score(range_channel, noise_power)[0]

    def image_and_score(
        self, range_channel: NDArray[np.complexfloating], noise_power: float, world: StaticWorld | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """([R, U] :meth:`image`, [R, U] score by which detections are found and ranked, in any unit), in one pass.

        Where a network says where targets are it is image times the root of that probability, elsewhere the image.
        """
        told = Circumstances(noise_power, world=None if world is None else world[None])
        images, probability = self.images(range_channel[None], told)
        score = images * np.sqrt(probability) if self.detects and probability is not None else images
        return np.asarray(images[0], dtype=np.float64), np.asarray(score[0], dtype=np.float64)

    def of_rows(
        self, range_channel: NDArray[np.complexfloating], noise_power: float, rows: NDArray[np.intp]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """[len(rows), U] rows of :meth:`image_and_score`; where rows do not depend on each other nothing else is
        computed."""
        if self.row_wise:
            return self.image_and_score(range_channel[rows], noise_power)
        image, score = self.image_and_score(range_channel, noise_power)
        return image[rows], score[rows]

    def scored(
        self,
        truth: NDArray[np.floating],
        range_channel: NDArray[np.complexfloating],
        noise_power: float,
        world: StaticWorld | None,
        channels: int | None = None,
    ) -> tuple[NDArray[np.float64], CellScores]:
        """([R, U] image of a frame's matrix, what became of its detections).

        :param truth: [R, U] magnitude [sqrt(W)]
        :param range_channel: [R, C] of all channels
        :param channels: how many should find the truth's cells; its own by default
        """
        image, score = self.image_and_score(range_channel, noise_power, world)
        level: NDArray[np.floating] = image
        if self.unit != AMPLITUDE:
            # It says where something is. The data say how strong it is, by delay and sum there.
            u = self.radar.grid.u
            level = DelayAndSum().image(range_channel[:, self.channels], self.line, u, noise_power)
        step = self.radar.waveform.range_step_m
        return image, score_cells(truth, level, noise_power, channels or len(self.channels), step, score)


@dataclass(frozen=True, eq=False)
class NetworkAnswer(Answer):
    """A run's network."""

    imager: Imager

    @property
    def unit(self) -> str:
        return UNITS[self.imager.config.target]

    @property
    def row_wise(self) -> bool:
        return self.imager.config.model == "doa-cnn"

    @property
    def detects(self) -> bool:
        return self.imager.detects

    @property
    def uses_motion(self) -> bool:
        return self.imager.config.told > 0

    def images(
        self, range_channel: NDArray[np.complexfloating], told: Circumstances, place: NDArray[np.intp] | None = None
    ) -> Images:
        """See :meth:`Answer.images`.

        :param place: which rows stand where, see :func:`trainer.networks.unrolled.laid_out`
        """
        with torch.inference_mode():
            snapshots = torch.from_numpy(np.array(range_channel)).to(self.imager.weights.device)
            device = snapshots.device
            noise = torch.full((len(snapshots),), told.noise_power, dtype=torch.float64, device=device)
            prior = None
            if told.world is not None and self.uses_motion:
                weights = told.world.prior(scanned_angles(self.radar)).astype(np.float32)
                prior = torch.from_numpy(weights).to(device)
            stands = None if place is None else torch.from_numpy(place).to(device)
            images, probability = self.imager.detect(snapshots, noise, told.model_error_db, prior, stands)
            return images.cpu().numpy(), None if probability is None else probability.float().cpu().numpy()

    def peaks(self, measurement: Measurement) -> Images:
        """A repeated peak has the strongest's row."""
        new, told = measurement.cells.new, self._circumstances(measurement)
        rows = measurement.cells.range_channel[new]
        place = np.where(new, np.cumsum(new).reshape(new.shape) - 1, np.arange(new.shape[1]))
        if self.imager.config.features == "paper":  # normalised over each whole image
            return self.images(rows[place], told)
        return self.images(rows[None], told[new][None], place)


@dataclass(frozen=True, eq=False)
class EstimatorAnswer(Answer):
    """A classical estimator."""

    estimator: Estimator

    @property
    def uses_motion(self) -> bool:
        return isinstance(self.estimator, VirtualView) and self.estimator.told

    def images(self, range_channel: NDArray[np.complexfloating], told: Circumstances) -> Images:
        matrices, line = self._elements(range_channel)
        return np.stack([self._rows(rows, line, told[index]) for index, rows in enumerate(matrices)]), None

    def _rows(self, rows: NDArray[np.complexfloating], line: LineArray, told: Circumstances) -> NDArray[np.float64]:
        """[n, U] of rows [n, C]."""
        error_db, estimator, u = told.model_error_db, self.estimator, self.radar.grid.u
        noise = row_noise(rows, told.noise_power, error_db) if error_db > NO_MODEL_ERROR_DB else told.noise_power
        if told.world is not None and isinstance(estimator, VirtualView):
            return estimator.image(rows, line, u, noise, told.world.prior)
        return estimator.image(rows, line, u, noise)

    def peaks(self, measurement: Measurement) -> Images:
        """A repeated peak is zero; the maximum over the peaks is the same."""
        new = measurement.cells.new
        rows, line = self._elements(np.asarray(measurement.cells.range_channel)[new])
        images = np.zeros((*new.shape, self.radar.grid.bins), dtype=np.float32)
        images[new] = self._rows(rows, line, self._circumstances(measurement)[new])
        return images, None

    def _elements(self, rows: NDArray[np.complexfloating]) -> tuple[NDArray[np.complexfloating], LineArray]:
        """(rows [..., E] of the channels in use, their places); where elements coincide, one mean for each place.

        The channels of a frame are compensated for motion between TX. A mean has less noise than the others; estimators
        are told that of one channel.
        """
        array, wavelength_m = self.radar.array, self.line.wavelength_m
        _, element = array.unique_elements(wavelength_m)
        if len(np.unique(element[self.channels])) == len(self.channels):
            return rows[..., self.channels], self.line
        others = np.setdiff1d(np.arange(array.channels), self.channels)
        means, places = averaged(rows, self.radar, others)
        return means, LineArray(places[:, 1], wavelength_m)


def network_answer(
    run: Run, imager: Imager, channels: NDArray[np.intp] | None = None, radar: Radar | None = None
) -> NetworkAnswer:
    """The imager of a run, moved to the best device.

    :param radar: of the measurements, by default the run's
    :param channels: of them that it looks at, by default its own
    """
    radar = radar or run.radar
    channels = run.array.line(run.radar) if channels is None else channels
    shown = radar.model_copy(update={"grid": run.radar.grid})
    return NetworkAnswer(run.config.model, run.array, channels, shown, imager.to(best_device()))


def array_answer(name: str, array: ArrayChoice, radar: Radar) -> EstimatorAnswer:
    """The estimator of this name (:data:`trainer.estimators.base.ESTIMATORS`) on the channels of an array."""
    return EstimatorAnswer(name, array, array.line(radar), radar, ESTIMATORS[name]())


def estimator_answer(name: str, radar: Radar, dead_channels: tuple[int, ...] = ()) -> EstimatorAnswer:
    """The estimator of this name on the line of channels along azimuth.

    :param dead_channels: left out
    :raises InputError: no channel left
    """
    channels = np.setdiff1d(radar.array.azimuth_channels, np.array(dead_channels, dtype=np.intp))
    if not len(channels):
        raise InputError("channels", f"all {radar.array.channels} are dead", "a channel with an echo")
    # Output files name RX: those of which any channel is in use.
    array = ArrayChoice(name="full", rx=tuple(np.unique(radar.array.channel_rx[channels]).tolist()))
    return replace(array_answer(name, array, radar), channels=channels)
