"""``trainer fit``: datasets to a run folder."""

from __future__ import annotations

import logging
import math
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import torch
from lightning.pytorch import LightningDataModule, Trainer
from lightning.pytorch.callbacks import Callback, EarlyStopping
from lightning.pytorch.trainer.states import TrainerStatus

from shared.dataset.locations import Location
from shared.dataset.writing import PARTIAL, remove_partial
from shared.physics.errors import InputError
from trainer.data.arrays import choose_array
from trainer.errors import TrainingStopped, out_of_memory
from trainer.run.claim import output_folder
from trainer.run.configuration import FitConfig
from trainer.run.folder import CHECKPOINT, RUN_FILE, WEIGHTS, Run, Start, load_imager, read_run, versions, write_run
from trainer.run.imager import Imager
from trainer.training.callbacks import LOSS, Interrupts, PictureLogger, RunKeeper
from trainer.training.checkpoint import not_restored, require_checkpoint
from trainer.training.datamodule import ImagingData
from trainer.training.doa import DoaData, DoaTask
from trainer.training.loggers import TENSORBOARD, check_logger, make_logger
from trainer.training.processes import ended_process, follower, is_first, launched
from trainer.training.task import ImagingTask
from trainer.training.verdict import judge

NETWORK_FIELDS = (
    "model", "width", "hidden", "features", "iterations", "learned", "detection", "target", "exponent",
)  # fmt: skip
"""What the weights of a run mean depends on these."""
DEVELOPER_ADVICE = (
    ".*does not have many workers.*",
    ".*smaller than the logging interval.*",
    ".*treespec.*",
    # The loader is resumable: BatchOrder starts at the first batch that the checkpoint has not seen.
    ".*your dataloader is not resumable.*",
)
"""Warnings of Lightning that no user of this package can act on."""


def fit(
    datasets: Sequence[Location | str],
    out: Path,
    config: FitConfig,
    array: str = "sparse6",
    weights: Sequence[float] | None = None,
    resume: bool = False,
    workers: int = 0,
    check: bool = True,
    devices: int = 1,
    announce: Callable[[str], object] = print,
    start: Path | None = None,
    logger: str = TENSORBOARD,
) -> Run:
    """Train one network, keep it in ``out`` and score it on the test frames (:mod:`trainer.training.verdict`).

    :param datasets: folders of datasets of one radar, local or by URI; the "doa-cnn" takes only the radar from them
    :param array: see :func:`trainer.data.arrays.choose_array`
    :param weights: share of each dataset in the batches
    :param resume: go on with the run in ``out``, at the batch after its last checkpoint
    :param workers: reading processes
    :param check: hash every shard before training
    :param devices: processes, one a device; torchrun has started as many as it was told to
    :param start: a run of the same network whose weights training begins with
    :param logger: of the curves, see :mod:`trainer.training.loggers`
    :raises InputError: bad data, a folder that holds another run, a start that is another network
    :raises TrainingStopped: a loss that is not finite, a process that has ended
    :raises KeyboardInterrupt: Ctrl-C; what the last validation left is whole
    """
    check_logger(logger)
    devices, machines = launched(devices)
    first = is_first()
    with output_folder(out, resume, "an empty or new folder, or --resume") if first else follower():
        return _fit(
            datasets,
            out,
            config,
            array,
            weights,
            resume,
            workers,
            check,
            devices,
            machines,
            announce,
            first,
            start,
            logger,
        )


def _fit(
    datasets: Sequence[Location | str],
    out: Path,
    config: FitConfig,
    array: str,
    weights: Sequence[float] | None,
    resume: bool,
    workers: int,
    check: bool,
    devices: int,
    machines: int,
    announce: Callable[[str], object],
    first: bool,
    start: Path | None,
    logger: str,
) -> Run:
    """:func:`fit` in a folder that is held.

    :param first: of the processes; it writes
    """
    data = ImagingData(datasets, weights, config, workers, check)
    config = config.model_copy(update={"truth_window": data.truth_window})
    run = Run(
        config=config,
        radar=data.radar,
        array=choose_array(array, data.radar),
        datasets=data.fingerprints,
        weights=tuple(weights) if weights else None,
        versions=versions(),
        start=None if start is None else Start.of(start),
    )
    online = config.model == "doa-cnn"
    task = (DoaTask if online else ImagingTask)(config, run.radar, run.array)
    if start is not None:
        _begin_with(task.imager, config, start)
    if first:
        _prepare(out, run, resume)
    checkpoint = out / CHECKPOINT if resume and (out / CHECKPOINT).is_file() else None
    if checkpoint is not None:
        require_checkpoint(checkpoint, task.state_dict())
    source: LightningDataModule = DoaData(config, run.radar) if online else data
    parameters = sum(parameter.numel() for parameter in task.parameters())
    frames = ", ".join(f"{f.name}: {f.frames['train']} + {f.frames['validation']}" for f in run.datasets)
    if first:
        announce(f"{config.model}, {parameters} parameters; array {run.array.name}; train + validate frames: {frames}")
    keeper, interrupts = RunKeeper(out, announce), Interrupts(first)
    callbacks: list[Callback] = [keeper, interrupts, *([] if online else [PictureLogger()])]
    if config.patience:
        callbacks.append(EarlyStopping(LOSS, patience=config.patience))
    with _quiet():
        curves = make_logger(logger, out)
        trainer = Trainer(
            accelerator="auto",
            devices=devices,
            num_nodes=machines,
            max_epochs=1,
            max_steps=config.steps,
            accumulate_grad_batches=config.accumulate,
            gradient_clip_val=config.clip,
            val_check_interval=_validation_interval(config) * config.accumulate,
            check_val_every_n_epoch=None,
            num_sanity_val_steps=-1,  # all frames before the first step; not of a run that is resumed
            log_every_n_steps=10,
            callbacks=callbacks,
            logger=curves,
            enable_checkpointing=False,  # RunKeeper's own, written whole or not at all
            enable_model_summary=False,
            enable_progress_bar=sys.stderr.isatty(),
            deterministic=not torch.cuda.is_available(),
            benchmark=False,
            use_distributed_sampler=False,  # BatchOrder deals the batches out itself
        )
    try:
        with _quiet(), interrupts:
            trainer.fit(task, datamodule=source, ckpt_path=checkpoint, weights_only=True)
    except SystemExit:
        if trainer.state.status != TrainerStatus.INTERRUPTED:
            raise
        # Lightning turns Ctrl-C into an exit without a message.
        raise KeyboardInterrupt from None
    except InputError:
        raise
    except Exception as error:
        if ended := ended_process(trainer):
            raise KeyboardInterrupt if interrupts.asked else TrainingStopped(ended) from error
        if checkpoint is None or keeper.started or out_of_memory(error):
            raise
        raise not_restored(checkpoint, error) from error
    if first and not online and (out / WEIGHTS).is_file():
        judge(out, datasets, announce)
    return run


def _begin_with(imager: Imager, config: FitConfig, start: Path) -> None:
    """Give the imager the weights of another run.

    :raises InputError: no whole run, or another network
    """
    run, trained = load_imager(start)
    for name in NETWORK_FIELDS:
        if getattr(run.config, name) != getattr(config, name):
            raise InputError(
                "--from", f"{start} has {name} = {getattr(run.config, name)!r}", f"{getattr(config, name)!r}"
            )
    try:
        imager.network.load_state_dict(trained.network.state_dict())
    except RuntimeError as error:  # of another array or grid, where a network knows them
        raise InputError("--from", f"{start} has weights of other shapes", "a run of this array and grid") from error


def _validation_interval(config: FitConfig) -> int:
    """Steps from one validation to the next: at most ``validate_every``, in equal parts that end with the run.

    What is learned after the last validation is lost. Of a number of steps that does not divide, fewer are than there
    are validations.
    """
    return config.steps // math.ceil(config.steps / config.validate_every)


def _prepare(out: Path, run: Run, resume: bool) -> None:
    """Note the run, or check that the one in the folder is this one."""
    if not resume or _killed_at_its_note(out):
        write_run(out, run)
        return
    if not (out / RUN_FILE).is_file():
        raise InputError("--resume", f"{out} holds no run", "the folder of an earlier trainer fit")
    before = read_run(out)
    for part in ("config", "radar", "array", "weights"):
        _same(out, part, getattr(before, part), getattr(run, part))
    # An earlier release did not write the scenes, nor what the start was trained on.
    _same(out, "datasets", *(tuple(fingerprint.data for fingerprint in one.datasets) for one in (before, run)))
    _same(out, "start", *(None if one.start is None else one.start.weights for one in (before, run)))
    remove_partial(out)


def _killed_at_its_note(out: Path) -> bool:
    """Whether a run ended while it wrote the first of its files: there is nothing yet to go on with."""
    return not (out / RUN_FILE).exists() and (out / (RUN_FILE + PARTIAL)).exists()


def _same(out: Path, part: str, before: object, now: object) -> None:
    if before == now:
        return
    if isinstance(before, FitConfig) and isinstance(now, FitConfig):
        name = next(name for name in FitConfig.model_fields if getattr(before, name) != getattr(now, name))
        part, before, now = name, getattr(before, name), getattr(now, name)
    raise InputError("--resume", f"{part} is {now}, but the run in {out} had {before}", "what it was started with")


@contextmanager
def _quiet() -> Iterator[None]:
    """Hide Lightning's advice to developers; its other warnings stay."""
    logger = logging.getLogger("lightning.pytorch")
    level = logger.level
    logger.setLevel(logging.WARNING)
    with warnings.catch_warnings():
        for text in DEVELOPER_ADVICE:
            warnings.filterwarnings("ignore", text)
        try:
            yield
        finally:
            logger.setLevel(level)
