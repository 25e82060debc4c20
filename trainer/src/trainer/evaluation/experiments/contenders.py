"""Who is compared: every estimator and every trained run, on every array, behind one call."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shared.dataset.documents import digest
from shared.dataset.locations import Location
from shared.physics.errors import InputError
from shared.radar import Radar
from shared.signal.windows import cell_noise_power
from trainer.data.arrays import ArrayChoice
from trainer.data.simulation import Trials
from trainer.defaults import DEFAULT_METHODS, NETWORKS
from trainer.estimators.base import ESTIMATORS
from trainer.estimators.fitting import fit_lines, score_peaks
from trainer.run.answers import Answer, array_answer, network_answer
from trainer.run.detections import CANDIDATES
from trainer.run.folder import RUN_FILE, WEIGHTS, Fingerprint, Run, load_imager, same_radar
from trainer.run.imager import Imager, best_device

FITTED = ("likes",)
"""Estimators whose peaks begin a fit of lines: what a network's detection head is worth beside a plain one."""


@dataclass(frozen=True, eq=False)
class Contender:
    """One method on one array.

    :param method: name in tables and figures
    :param answer: what images; to be pickled, for worker processes
    :param inputs: fingerprint of what its images depend on besides the data
    :param parameters: trained weights, 0 for an estimator
    :param trained_on: datasets that its weights have seen
    :param device: that it images on, "cpu" or "cuda"
    :param fits: whether its peaks begin a fit of lines, see :meth:`locate`
    """

    method: str
    answer: Answer
    inputs: str
    parameters: int = 0
    trained_on: tuple[Fingerprint, ...] = ()
    device: str = "cpu"
    fits: bool = False

    @property
    def array(self) -> ArrayChoice:
        """The channels that it sees."""
        return self.answer.array

    @property
    def key(self) -> tuple[str, str]:
        """(method, array), which tells it apart."""
        return self.method, self.array.name

    @property
    def name(self) -> str:
        return " ".join(self.key)

    def of_trials(self, trials: Trials) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """([T, U] the image rows of all trials, [T, U] those of their scores)."""
        noise = cell_noise_power(self.answer.radar)
        found = [self.answer.of_rows(matrix, noise, trials.rows) for matrix in trials.snapshots]
        images, scores = (np.concatenate(part) for part in zip(*found, strict=True))
        return images, scores

    def locate(self, trials: Trials) -> NDArray[np.float64]:
        """[T, K] angles of the K strongest lines of each trial, rising, NaN where there are fewer.

        The lines are fitted to the snapshots from the peaks of the score on; nobody tells their number.
        """
        answer, count = self.answer, trials.u.shape[1]
        candidates = score_peaks(self.of_trials(trials)[1], answer.radar.grid.u, CANDIDATES)
        x = np.concatenate(trials.snapshots[:, trials.rows])[:, answer.channels]
        lines = fit_lines(x, answer.line, cell_noise_power(answer.radar), candidates)
        return np.sort(lines.u[:, :count], axis=1)


def check_methods(names: Sequence[str], known: Sequence[str] = (*ESTIMATORS, *NETWORKS)) -> None:
    """Refuse names that stand for no method.

    :raises InputError: none, one that does not exist, one twice
    """
    if unknown := [repr(name) for name in names if name not in known] if names else ["none"]:
        raise InputError("--methods", unknown[0], f"some of {', '.join(known)}")
    if twice := [name for index, name in enumerate(names) if name in names[:index]]:
        raise InputError("--methods", f"{twice[0]!r} twice", "every method once")


def check_networks(methods: Sequence[str], kinds: Iterable[str]) -> None:
    """Refuse networks that no run stands for.

    :param methods: that are wanted
    :param kinds: of the runs
    :raises InputError: the first of them
    """
    if missing := [name for name in NETWORKS if name in methods and name not in kinds]:
        expected = f"--run RUN of a {_MODELS[missing[0]]}"
        raise InputError("--methods", f"{missing[0]!r} without a run of that kind", expected)


def gather(
    methods: Sequence[str] | None,
    runs: Sequence[Path],
    arrays: Sequence[ArrayChoice],
    radar: Radar,
    source: Location,
) -> tuple[Contender, ...]:
    """The contenders, estimators first, each on all arrays, each run on its own, in the order of methods and arrays.

    :param methods: names of estimators, "cnn", "unet"; by default :data:`trainer.defaults.DEFAULT_METHODS` and all runs
    :param source: of the radar, for messages
    :raises InputError: a method that does not exist, a run of another radar or of an array that is not evaluated, "cnn"
        or "unet" without such a run, a run that no method stands for
    """
    loaded = [(path, *load_imager(path)) for path in runs]
    for path, run, _ in loaded:
        same_radar(run.radar, str(path), radar, str(source))
    places = [(kind_of(run), run.array.rx) for _, run, _ in loaded]
    kinds = [kind for kind, _ in places]
    chosen = tuple(methods) if methods is not None else (*DEFAULT_METHODS, *sorted(set(kinds)))
    check_methods(chosen)
    check_networks(chosen, kinds)
    networks = []
    for (path, run, imager), (kind, rx) in zip(loaded, places, strict=True):
        if kind not in chosen:
            raise InputError("--run", f"{path} is a {kind!r}, not among the methods", f"{kind!r} in --methods")
        place = next((place for place, array in enumerate(arrays) if array.rx == rx), None)
        if place is None:
            known = ", ".join(array.name for array in arrays)
            raise InputError(
                "--run", f"{path} was trained for array {run.array.name!r}, RX {list(rx)}",
                f"one of the arrays evaluated, {known}; or that array in --arrays",
            )  # fmt: skip
        # Folders tell two networks of one kind on one array apart.
        label = kind if places.count((kind, rx)) == 1 else f"{kind}:{path.resolve().name}"
        network = _network(label, arrays[place], path, (run, imager), radar)
        networks.append(((chosen.index(kind), label, place), network))
    contenders = [estimator_contender(name, array, radar) for name in chosen if name in ESTIMATORS for array in arrays]
    # The arrays of one method stand beside each other, whatever the order of the runs.
    contenders += [network for _, network in sorted(networks, key=lambda entry: entry[0])]
    names = [contender.name for contender in contenders]
    if same := [name for index, name in enumerate(names) if name in names[:index]]:
        raise InputError("--run", f"two runs are named {same[0]!r}", "run folders of different names")
    return tuple(contenders)


_MODELS = {"cnn": "doa-cnn (trainer fit --recipe doa)", "unet": "network of whole images (trainer fit)"}


def kind_of(run: Run) -> str:
    return "cnn" if run.config.model == "doa-cnn" else "unet"


def estimator_contender(name: str, array: ArrayChoice, radar: Radar) -> Contender:
    """The estimator of this name (:data:`trainer.estimators.base.ESTIMATORS`) on an array."""
    inputs = digest(["estimator", name, list(array.rx)])
    return Contender(name, array_answer(name, array, radar), inputs, fits=name in FITTED)


def _network(label: str, array: ArrayChoice, path: Path, trained: tuple[Run, Imager], radar: Radar) -> Contender:
    run, imager = trained
    answer, device = replace(network_answer(run, imager, radar=radar), array=array), best_device()
    content = hashlib.sha256((path / RUN_FILE).read_bytes() + (path / WEIGHTS).read_bytes()).hexdigest()
    parameters = sum(parameter.numel() for parameter in imager.parameters())
    # A "cnn" images range bins one by one. It trains on its own samples and takes only the radar from its datasets.
    seen = () if kind_of(run) == "cnn" else run.trained_on
    return Contender(label, answer, digest(["run", content, device]), parameters, seen, device, imager.detects)
