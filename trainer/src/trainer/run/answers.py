"""What images a frame: a trained network, or a classical estimator, which needs no training."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from shared.physics.errors import InputError, meant
from shared.radar import Radar
from shared.signal.model_error import row_noise
from shared.signal.tdm import averaged
from trainer.data.arrays import ArrayChoice
from trainer.data.measurements import Measurement
from trainer.estimators.base import ESTIMATORS, Estimator, LineArray, line_array
from trainer.estimators.das import DelayAndSum
from trainer.run.detections import new_peaks
from trainer.run.folder import Run
from trainer.run.imager import Imager
from trainer.run.targets import AMPLITUDE, UNITS


@dataclass(frozen=True, eq=False)
class Answer(ABC):
    """Images of measurements of one radar.

    :param name: of network or estimator
    :param array: the channels that it looks at, as output files name them
    :param channels: [C] those among the measurement's
    :param line: their places
    :param radar: of the measurements, its grid that of the images
    :param unit: of the images
    """

    name: str
    array: ArrayChoice
    channels: NDArray[np.intp]
    line: LineArray
    radar: Radar
    unit: str

    @abstractmethod
    def peaks(self, measurement: Measurement) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """([D, R, U] image, [D, R, U] probability of a target or None) of each Doppler peak."""

    @abstractmethod
    def baseline(self, measurement: Measurement) -> NDArray[np.floating]:
        """[R, U] delay-and-sum image of the same channels, the maximum over the peaks [sqrt(W)]."""


@dataclass(frozen=True, eq=False)
class NetworkAnswer(Answer):
    """A run's network."""

    imager: Imager

    def peaks(self, measurement: Measurement) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        return answer_peaks(self.imager, measurement)

    def baseline(self, measurement: Measurement) -> NDArray[np.floating]:
        with torch.inference_mode():
            snapshots = torch.from_numpy(np.array(measurement.range_channel)).to(self.imager.weights.device)
            return np.asarray(self.imager.das(snapshots).amax(dim=0).cpu().numpy())


@dataclass(frozen=True, eq=False)
class EstimatorAnswer(Answer):
    """A classical estimator."""

    estimator: Estimator

    def peaks(self, measurement: Measurement) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """A peak that repeats an earlier one of its range bin is zero; the maximum over the peaks is the same."""
        return self._images(self.estimator, measurement).astype(np.float32), None

    def baseline(self, measurement: Measurement) -> NDArray[np.floating]:
        return np.asarray(self._images(DelayAndSum(), measurement).max(axis=0))

    def _images(self, estimator: Estimator, measurement: Measurement) -> NDArray[np.float64]:
        new = new_peaks(measurement.velocity)
        rows, line = self._elements(np.asarray(measurement.range_channel)[new])
        noise: float | NDArray[np.float64] = measurement.noise_power
        if measurement.measured:
            noise = np.asarray(row_noise(rows, measurement.noise_power, measurement.model_error_db))
        images = np.zeros((*new.shape, self.radar.grid.bins))
        images[new] = estimator.image(rows, line, self.radar.grid.u, noise)
        return images

    def _elements(self, rows: NDArray[np.complexfloating]) -> tuple[NDArray[np.complexfloating], LineArray]:
        """(rows [n, E] of the channels in use, their places); where elements coincide, one mean for each place.

        The channels of a frame are compensated for motion between TX. A mean has less noise than the others; estimators
        are told that of one channel.
        """
        array, wavelength_m = self.radar.array, self.line.wavelength_m
        _, element = array.unique_elements(wavelength_m)
        if len(np.unique(element[self.channels])) == len(self.channels):
            return rows[:, self.channels], self.line
        others = np.setdiff1d(np.arange(array.channels), self.channels)
        means, places = averaged(rows, self.radar, others)
        return means, LineArray(places[:, 1], wavelength_m)


def network_answer(run: Run, imager: Imager, channels: NDArray[np.intp], radar: Radar) -> NetworkAnswer:
    """The imager of a run for measurements of ``radar``, of which it looks at ``channels``."""
    shown = radar.model_copy(update={"grid": run.radar.grid})
    line, unit = line_array(radar, channels), UNITS[run.config.target]
    return NetworkAnswer(run.config.model, run.array, channels, line, shown, unit, imager)


def estimator_answer(name: str, radar: Radar, dead_channels: tuple[int, ...] = ()) -> EstimatorAnswer:
    """The estimator of this name (:data:`trainer.estimators.base.ESTIMATORS`), on the line of channels along azimuth.

    :param dead_channels: left out
    :raises InputError: an unknown name, no channel left
    """
    check_method(name)
    channels = np.setdiff1d(radar.array.azimuth_channels, np.array(dead_channels, dtype=np.intp))
    if not len(channels):
        raise InputError("channels", f"all {radar.array.channels} are dead", "a channel with an echo")
    # Output files name RX: those of which any channel is in use.
    rx = np.unique(radar.array.channel_rx[channels])
    array = ArrayChoice(name="full", rx=tuple(rx.tolist()))
    return EstimatorAnswer(name, array, channels, line_array(radar, channels), radar, AMPLITUDE, ESTIMATORS[name]())


def check_method(name: str) -> None:
    """:raises InputError: no estimator of this name"""
    if name not in ESTIMATORS:
        raise InputError("--method", repr(name), f"one of {', '.join(ESTIMATORS)}{meant(name, ESTIMATORS)}")


def answer_peaks(imager: Imager, measurement: Measurement) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    """([D, R, U] image, [D, R, U] probability or None) of each Doppler peak of a frame (paper, section II-E).

    The network images the strongest peaks of all range bins, then the second strongest and so on, the strongest again
    where there is none.
    """
    device = imager.weights.device
    with torch.inference_mode():
        snapshots = torch.from_numpy(np.array(measurement.range_channel)).to(device)
        noise = torch.full((len(snapshots),), measurement.noise_power, dtype=torch.float64, device=device)
        images, probability = imager.detect(snapshots, noise, measurement.model_error_db)
        return images.cpu().numpy(), None if probability is None else probability.float().cpu().numpy()
