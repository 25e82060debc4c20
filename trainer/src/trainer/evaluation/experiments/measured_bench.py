"""A bench for a measured row alone, without a dataset: its arrays, and the runs that fit it."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from shared.physics.errors import InputError
from shared.radar import Radar
from trainer.data.arrays import ArrayChoice, choose_array
from trainer.evaluation.experiments.bench import Bench, EvaluationConfig, MeasuredNetwork
from trainer.evaluation.experiments.contenders import NETWORKS
from trainer.evaluation.experiments.measured import METHODS
from trainer.evaluation.experiments.measured_input import MeasuredInput, snapshot_radar, with_arrays
from trainer.run.folder import RUN_FILE, WEIGHTS, load_imager
from trainer.run.other_radars import fitted_imager


def measured_bench(
    measured: MeasuredInput,
    runs: Sequence[Path],
    methods: Sequence[str] | None,
    array_names: Sequence[str],
    config: EvaluationConfig,
) -> tuple[Bench, list[str]]:
    """(what the experiment works on, a line for each array or run that does not fit).

    :param methods: names of :data:`trainer.evaluation.experiments.measured.METHODS`; all by default
    :param array_names: of a cube those of its radar, of a snapshot those of the default radar, by which it is thinned
    :raises InputError: an unknown method, a run that cannot be read
    """
    chosen = tuple(name for name in methods or () if name not in NETWORKS)
    if unknown := [name for name in chosen if name not in METHODS]:
        raise InputError("--methods", repr(unknown[0]), f"some of {', '.join((*METHODS, *NETWORKS))}")
    if methods is not None and not methods:
        raise InputError("--methods", "none", f"some of {', '.join(METHODS)}")
    radar = measured.radar or Radar()
    arrays, obstacles = _arrays(array_names, radar)
    networks = []
    for path in runs:
        try:
            networks.append(_network(path, measured, len(runs) > 1))
        except InputError as error:
            if not path.joinpath(RUN_FILE).is_file():
                raise
            obstacles.append(f"left out: {error}")
    row = with_arrays(measured, radar, arrays)
    empty: frozenset[str] = frozenset()
    bench = Bench(
        row.sha256, radar, (), empty, (), config, measured=row, measured_methods=chosen,
        measured_networks=tuple(networks),
    )  # fmt: skip
    return bench, obstacles


def _arrays(names: Sequence[str], radar: Radar) -> tuple[list[ArrayChoice], list[str]]:
    """(the arrays that the radar has, a line for each other one)."""
    arrays, obstacles = [], []
    for name in names:
        try:
            arrays.append(choose_array(name, radar))
        except InputError as error:
            obstacles.append(f"left out: {error}")
    return arrays, obstacles


def _network(path: Path, measured: MeasuredInput, several: bool) -> MeasuredNetwork:
    """:raises InputError: no run, or one of another array"""
    run, imager = load_imager(path)
    radar = measured.radar or snapshot_radar(measured, run.radar)
    fitted = fitted_imager(run, imager, str(path), radar, str(measured.path))
    elements = fitted.channels if measured.frame is None else measured.element[fitted.channels]
    if (elements < 0).any():
        raise InputError(measured.path, f"a channel of {run.array.name!r} is dead or off the line", "all of them alive")
    kind = "cnn" if run.config.model == "doa-cnn" else "unet"
    content = hashlib.sha256((path / RUN_FILE).read_bytes() + (path / WEIGHTS).read_bytes()).hexdigest()
    name = f"{kind}:{path.resolve().name}" if several else kind
    return MeasuredNetwork(name, run.array.name, fitted.imager, elements, run.radar.grid.u, content)
