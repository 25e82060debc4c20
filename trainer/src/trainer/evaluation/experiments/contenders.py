"""Who is compared: every estimator and every trained run, on every array, behind one call."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from shared.dataset.locations import Location
from shared.physics.errors import InputError
from shared.radar import Radar
from shared.signal.windows import cell_noise_power
from trainer.data.arrays import ArrayChoice
from trainer.data.pairs import Trials
from trainer.estimators.base import ESTIMATORS, Estimator, LineArray, line_array
from trainer.estimators.fitting import fit_lines, score_peaks
from trainer.evaluation.store import digest
from trainer.run.detections import CANDIDATES
from trainer.run.folder import RUN_FILE, WEIGHTS, Fingerprint, Run, load_imager, same_radar
from trainer.run.imager import Imager
from trainer.run.targets import AMPLITUDE, UNITS

NETWORKS = ("cnn", "unet")
"""Names in ``--methods`` that stand for the runs: direction-of-arrival networks, and networks of whole images."""
FITTED = ("likes",)
"""Estimators whose peaks begin a fit of lines: what a network's detection head is worth beside a plain one."""
DEFAULT_METHODS = ("das", "music", "iaa", "omp")
"""Beside the networks of all runs."""


@dataclass(frozen=True, eq=False)
class Contender:
    """One method on one array.

    :param method: name in tables and figures
    :param array: the channels that it sees
    :param channels: [C] indices of those among the radar's channels
    :param line: their places
    :param parameters: trained weights, 0 for an estimator
    :param unit: of its images
    :param row_wise: an image row depends on nothing but that row's snapshot
    :param inputs: fingerprint of what its images depend on besides the data
    :param trained_on: datasets that its weights have seen
    :param imaging: range-channel matrix [R, C] of all the radar's channels and noise power [W] to image [R, U]; to be
        pickled, for worker processes
    :param device: that it images on, "cpu" or "cuda"
    :param scoring: for a method that ranks its detections by something else than their level: the same arguments to
        (image, score), both [R, U], in one pass; to be pickled too
    :param fits: whether its peaks begin a fit of lines, see :meth:`locate`
    """

    method: str
    array: ArrayChoice
    channels: NDArray[np.intp]
    line: LineArray
    parameters: int
    unit: str
    row_wise: bool
    inputs: str
    trained_on: tuple[Fingerprint, ...]
    imaging: Callable[[NDArray[np.complex64], float], NDArray[np.floating]]
    device: str = "cpu"
    scoring: Callable[[NDArray[np.complex64], float], tuple[NDArray[np.floating], NDArray[np.floating]]] | None = None
    fits: bool = False

    @property
    def name(self) -> str:
        return f"{self.method} {self.array.name}"

    def image(self, range_channel: NDArray[np.complex64], noise_power: float) -> NDArray[np.float64]:
        """[R, U] image, see :attr:`unit`, of the range-channel matrix [R, C] of all channels [sqrt(W)]."""
        return np.asarray(self.imaging(range_channel, noise_power), dtype=np.float64)

    def image_and_score(
        self, range_channel: NDArray[np.complex64], noise_power: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """([R, U] :meth:`image`, [R, U] score by which detections are found and ranked, in any unit): the image twice
        where the method has no other."""
        if self.scoring is None:
            image = self.image(range_channel, noise_power)
            return image, image
        level, score = self.scoring(range_channel, noise_power)
        return np.asarray(level, dtype=np.float64), np.asarray(score, dtype=np.float64)

    def locate(self, trials: Trials, radar: Radar) -> NDArray[np.float64]:
        """[T, K] angles of the K strongest lines of each trial, rising, NaN where there are fewer.

        The lines are fitted to the snapshots from the peaks of the score on; nobody tells their number.
        """
        noise, count = cell_noise_power(radar), trials.u.shape[1]
        found = []
        for image in trials.snapshots:
            score = self.score_rows(image, noise, trials.rows)
            candidates = score_peaks(score, radar.grid.u, CANDIDATES)
            lines = fit_lines(image[trials.rows][:, self.channels], self.line, noise, candidates)
            found.append(np.sort(lines.u[:, :count], axis=1))
        return np.concatenate(found)

    def image_rows(
        self, range_channel: NDArray[np.complex64], noise_power: float, rows: NDArray[np.intp]
    ) -> NDArray[np.float64]:
        """[len(rows), U] rows of :meth:`image`; nothing else is computed where rows do not depend on each other."""
        if self.row_wise:
            return self.image(range_channel[rows], noise_power)
        return self.image(range_channel, noise_power)[rows]

    def score_rows(
        self, range_channel: NDArray[np.complex64], noise_power: float, rows: NDArray[np.intp]
    ) -> NDArray[np.float64]:
        """[len(rows), U] rows of the score of :meth:`image_and_score`."""
        if self.scoring is None:
            return self.image_rows(range_channel, noise_power, rows)
        return self.image_and_score(range_channel, noise_power)[1][rows]

    def score_trials(self, trials: Trials, radar: Radar) -> NDArray[np.float64]:
        """[T, U] the score's rows of all trials."""
        noise = cell_noise_power(radar)
        return np.concatenate([self.score_rows(image, noise, trials.rows) for image in trials.snapshots])

    def image_trials(self, trials: Trials, radar: Radar) -> NDArray[np.float64]:
        """[T, U] the image rows of all trials."""
        noise = cell_noise_power(radar)
        return np.concatenate([self.image_rows(image, noise, trials.rows) for image in trials.snapshots])


def check_methods(names: Sequence[str]) -> None:
    """Refuse names that stand for no method.

    :raises InputError: none, one that does not exist, one twice
    """
    known = ", ".join([*ESTIMATORS, *NETWORKS])
    if not names:
        raise InputError("--methods", "none", f"some of {known}")
    if unknown := [name for name in names if name not in (*ESTIMATORS, *NETWORKS)]:
        raise InputError("--methods", repr(unknown[0]), f"some of {known}")
    if twice := [name for index, name in enumerate(names) if name in names[:index]]:
        raise InputError("--methods", f"{twice[0]!r} twice", "every method once")


def gather(
    methods: Sequence[str] | None,
    runs: Sequence[Path],
    arrays: Sequence[ArrayChoice],
    radar: Radar,
    source: Location,
) -> tuple[Contender, ...]:
    """The contenders, estimators first, each on all arrays, each run on its own, in the order of methods and arrays.

    :param methods: names of estimators, "cnn", "unet"; by default :data:`DEFAULT_METHODS` and all runs
    :param runs: run folders
    :param source: of the radar, for messages
    :raises InputError: a method that does not exist, a run of another radar or of an array that is not evaluated, "cnn"
        or "unet" without such a run, a run that no method stands for
    """
    loaded = [(path, *load_imager(path)) for path in runs]
    for path, run, _ in loaded:
        same_radar(run.radar, str(path), radar, str(source))
    kinds = [_kind(run) for _, run, _ in loaded]
    chosen = tuple(methods) if methods is not None else (*DEFAULT_METHODS, *sorted(set(kinds)))
    check_methods(chosen)
    for name in NETWORKS:
        if name in chosen and name not in kinds:
            raise InputError("--methods", f"{name!r} without a run of that kind", f"--run RUN of a {_MODELS[name]}")
    for (path, run, _), kind in zip(loaded, kinds, strict=True):
        if kind not in chosen:
            raise InputError("--run", f"{path} is a {kind!r}, not among the methods", f"{kind!r} in --methods")
        if run.array.rx not in [array.rx for array in arrays]:
            known = ", ".join(array.name for array in arrays)
            raise InputError(
                "--run", f"{path} was trained for array {run.array.name!r}, RX {list(run.array.rx)}",
                f"one of the arrays evaluated, {known}; or that array in --arrays",
            )  # fmt: skip
    estimators = [name for name in chosen if name in ESTIMATORS]
    contenders = [estimator_contender(name, array, radar) for name in estimators for array in arrays]
    places = [(kind, run.array.rx) for (_, run, _), kind in zip(loaded, kinds, strict=True)]
    networks: list[tuple[int, str, int, Contender]] = []
    for (path, run, imager), place in zip(loaded, places, strict=True):
        # Folders tell two networks of one kind on one array apart.
        label = place[0] if places.count(place) == 1 else f"{place[0]}:{path.resolve().name}"
        array = next(array for array in arrays if array.rx == run.array.rx)
        network = _network(label, array, path, run, imager)
        networks.append((chosen.index(place[0]), label, arrays.index(array), network))
    # The arrays of one method stand beside each other, whatever the order of the runs.
    contenders += [network for *_, network in sorted(networks, key=lambda entry: entry[:3])]
    names = [contender.name for contender in contenders]
    if same := [name for index, name in enumerate(names) if name in names[:index]]:
        raise InputError("--run", f"two runs are named {same[0]!r}", "run folders of different names")
    return tuple(contenders)


_MODELS = {"cnn": "doa-cnn (trainer fit --recipe doa)", "unet": "network of whole images (trainer fit)"}


def _kind(run: Run) -> str:
    return "cnn" if run.config.model == "doa-cnn" else "unet"


def estimator_contender(name: str, array: ArrayChoice, radar: Radar) -> Contender:
    """The estimator of this name (:data:`trainer.estimators.base.ESTIMATORS`) on an array."""
    channels = array.channels(radar)
    line = line_array(radar, channels)
    inputs = digest(["estimator", name, list(array.rx)])
    return Contender(
        name, array, channels, line, 0, AMPLITUDE, True, inputs, (),
        partial(_estimate, ESTIMATORS[name](), channels, line, radar.grid.u), fits=name in FITTED,
    )  # fmt: skip


def _estimate(
    estimator: Estimator,
    channels: NDArray[np.intp],
    line: LineArray,
    u: NDArray[np.float64],
    range_channel: NDArray[np.complex64],
    noise_power: float,
) -> NDArray[np.float64]:
    return estimator.image(range_channel[:, channels], line, u, noise_power)


def _network(label: str, array: ArrayChoice, path: Path, run: Run, imager: Imager) -> Contender:
    device = "cuda" if torch.cuda.is_available() else "cpu"
    imager.to(device)
    of_angles = _kind(run) == "cnn"
    channels = array.channels(run.radar)
    parameters = sum(parameter.numel() for parameter in imager.parameters())
    content = hashlib.sha256((path / RUN_FILE).read_bytes() + (path / WEIGHTS).read_bytes()).hexdigest()
    return Contender(
        label, array, channels, line_array(run.radar, channels), parameters, UNITS[run.config.target],
        # A "cnn" images range bins one by one. It trains on its own samples and takes only the radar from its datasets.
        of_angles, digest(["run", content, device]), () if of_angles else run.trained_on,
        partial(_network_image, imager, device), device,
        partial(_network_score, imager, device) if imager.detects else None, imager.detects,
    )  # fmt: skip


def _network_score(
    imager: Imager, device: str, range_channel: NDArray[np.complex64], noise_power: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(image, image times the root of the probability of a target), both [R, U]."""
    with torch.inference_mode():
        snapshots = torch.from_numpy(np.array(range_channel)).to(device)[None]
        noise = torch.full((1,), noise_power, dtype=torch.float64, device=device)
        image, score = imager.image_and_score(snapshots, noise)
        return image[0].cpu().numpy(), score[0].cpu().numpy()


def _network_image(
    imager: Imager, device: str, range_channel: NDArray[np.complex64], noise_power: float
) -> NDArray[np.float32]:
    with torch.inference_mode():
        snapshots = torch.from_numpy(np.array(range_channel)).to(device)[None]
        noise = torch.full((1,), noise_power, dtype=torch.float64, device=device)
        return np.asarray(imager(snapshots, noise)[0].cpu().numpy(), dtype=np.float32)
