"""``trainer fit``: datasets to a run folder."""

from __future__ import annotations

import logging
import math
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
from lightning.pytorch import LightningDataModule, LightningModule, Trainer
from lightning.pytorch.callbacks import Callback
from lightning.pytorch.loggers import Logger
from lightning.pytorch.trainer.states import TrainerStatus

from shared.dataset.writing import PARTIAL, remove_partial
from shared.physics.errors import InputError
from shared.processes.declared import taking
from trainer.data.arrays import choose_array
from trainer.errors import Stopped, out_of_memory
from trainer.run.configuration import FitConfig, first_difference
from trainer.run.folder import (
    CHECKPOINT,
    JOB,
    RUN_FILE,
    WEIGHTS,
    Run,
    Start,
    output_folder,
    read_run,
    versions,
    write_run,
)
from trainer.run.imager import precision_remark
from trainer.training.callbacks import (
    Interrupts,
    PictureLogger,
    RunKeeper,
    check_logger,
    make_logger,
    not_restored,
    require_checkpoint,
)
from trainer.training.datamodule import ImagingData
from trainer.training.doa import DoaData, DoaTask
from trainer.training.options import SHIPPED, FitRequest, start_of
from trainer.training.processes import ended_process, follower, is_first, launched
from trainer.training.start import begin_with, configuration, shipped_start
from trainer.training.task import ImagingTask
from trainer.training.verdict import judge

DEVELOPER_ADVICE = (
    ".*does not have many workers.*",
    ".*smaller than the logging interval.*",
    ".*treespec.*",
    # The loader is resumable: BatchOrder starts at the first batch that the checkpoint has not seen.
    ".*your dataloader is not resumable.*",
)
"""Warnings of Lightning that no user of this package can act on."""


ONLINE = "doa-cnn"
"""The model that is trained on targets drawn while it trains, of the datasets' radar."""
FURTHER_RATE = 2e-4
"""Learning rate of training that begins with the weights of a run, where none is stated.

On the 60 frames of ``make dataset`` the average precision of its ten test frames changes by -0.006 (-0.016 to +0.007);
with the rate of random weights, from the weights that shipped before, by -0.018 (-0.041 to +0.014): ``trainer fit
build/dataset --learning-rate 1e-3 --out build/run``.
"""


@taking(FitRequest)
def fit(request: FitRequest) -> Run:
    """Train one network, keep it in ``out`` and score it on the test frames (:mod:`trainer.training.verdict`), as
    ``trainer fit`` does.

    >>> fit("build/dataset", "build/run", steps=300, announce=print)  # doctest: +SKIP

    :returns: what was trained on what; :func:`trainer.load_imager` loads the network
    :raises InputError: bad data, a folder that holds another run, a start that is another network
    :raises Stopped: a loss that is not finite, a process that has ended
    :raises KeyboardInterrupt: Ctrl-C; what the last validation left is whole
    """
    announce = request.announce
    check_logger(request.logger)
    given = {name: value for name, value in vars(request).items() if name in FitConfig.model_fields}
    config = configuration(request.recipe, given, request.config)
    launch = launched(request.devices)
    out, first = request.out, is_first()
    with output_folder(out, request.resume, "an empty or new folder, or --resume") if first else follower():
        data = ImagingData(request.datasets, request.weights, config, request.workers, request.check)
        run, start, said = _begun(request, config, data, math.prod(launch))
        online = run.config.model == ONLINE
        task = (DoaTask if online else ImagingTask)(run.config, run.radar, run.array)
        if start is not None:
            begin_with(task.imager, run.config, start)
        if first:
            _prepare(out, run, request.resume, announce)
        checkpoint = out / CHECKPOINT if request.resume and (out / CHECKPOINT).is_file() else None
        if checkpoint is not None:
            require_checkpoint(checkpoint)
        if first:
            announce(_summary(run, task))
            if said:
                announce(said)
        keeper, interrupts = RunKeeper(out, config.patience, announce), Interrupts(first)
        callbacks: list[Callback] = [keeper, interrupts, *([] if online else [PictureLogger()])]
        with _quiet():
            trainer = _trainer(run.config, make_logger(request.logger, out), callbacks, launch)
        source: LightningDataModule = DoaData(run.config, run.radar) if online else data
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
                raise KeyboardInterrupt if interrupts.asked else Stopped(ended) from error
            if checkpoint is None or keeper.started or out_of_memory(error):
                raise
            raise not_restored(checkpoint, error) from error
        if first and not online and (out / WEIGHTS).is_file():
            judge(out, request.datasets, announce, start)
        return run


def _begun(request: FitRequest, config: FitConfig, data: ImagingData, processes: int) -> tuple[Run, Path | None, str]:
    """(the run, that whose weights it begins with, what to say of a start that was not stated)."""
    array = choose_array(request.array, data.radar)
    config = config.model_copy(update={"truth_window": data.truth_window})
    start, said = start_of(request.start), ""
    if request.start == SHIPPED:
        # One that began with random weights was asked to, or nothing shipped did fit.
        anew = request.resume and (request.out / RUN_FILE).is_file() and read_run(request.out).start is None
        start, said = (None, "") if anew else shipped_start(config, data.radar, array)
    if start is not None and "learning_rate" not in config.model_fields_set:
        config = config.model_copy(update={"learning_rate": FURTHER_RATE})
    run = Run(
        config=config,
        radar=data.radar,
        array=array,
        datasets=data.fingerprints,
        weights=tuple(request.weights) if request.weights else None,
        versions=versions(),
        start=None if start is None else Start.of(start),
        processes=processes,
    )
    return run, start, said


def _summary(run: Run, task: LightningModule) -> str:
    parameters = sum(parameter.numel() for parameter in task.parameters())
    frames = ", ".join(f"{f.name}: {f.frames['train']} + {f.frames['validation']}" for f in run.datasets)
    seen = "point targets drawn anew, no frames" if run.config.model == ONLINE else f"train + validate frames: {frames}"
    model, array = run.config.model, run.array.name
    said = f"{model}, {parameters} parameters; array {array}; {seen}"
    remarks = run.array.left_out(run.radar), precision_remark([run.config])
    return "; ".join(filter(None, (said, *remarks)))


def _trainer(config: FitConfig, curves: Logger | bool, callbacks: list[Callback], launch: tuple[int, int]) -> Trainer:
    """Lightning's trainer of a run.

    :param launch: (processes of this machine, machines)
    """
    # At most validate_every, in equal parts that end with the run: what is learned after the last one is lost. Of
    # a number of steps that does not divide, fewer are than there are validations.
    between = config.steps // math.ceil(config.steps / config.validate_every)
    return Trainer(
        accelerator="auto",
        devices=launch[0],
        num_nodes=launch[1],
        max_epochs=1,
        max_steps=config.steps,
        accumulate_grad_batches=config.accumulate,
        gradient_clip_val=config.clip,
        val_check_interval=between * config.accumulate,
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


def _prepare(out: Path, run: Run, resume: bool, announce: Callable[[str], object]) -> None:
    """Note the run, or check that the one in the folder is this one."""
    if resume and not (out / RUN_FILE).is_file():
        # One that was killed before it had noted itself left nothing, or a piece of its first file.
        if any(item.name not in (JOB, RUN_FILE + PARTIAL) for item in out.iterdir()):
            raise InputError("--resume", f"{out} holds no run", "the folder of an earlier trainer fit, or a new one")
        announce(f"nothing to resume in {out}: begins")
        resume = False
    if not resume:
        write_run(out, run)
        return
    before = read_run(out)
    _same(out, "start", *(f"{each.start or 'random weights'}" for each in (before, run)))
    for part in ("config", "radar", "array", "weights", "processes"):
        _same(out, part, getattr(before, part), getattr(run, part))
    # The same shards in a folder of another name are the same data.
    had, has = ([(one.sha256, one.frames, one.scenes) for one in each.datasets] for each in (before, run))
    if had != has:
        _same(out, "datasets", *(", ".join(map(str, each.datasets)) for each in (before, run)))
    remove_partial(out)


def _same(out: Path, part: str, before: object, now: object) -> None:
    if before == now:
        return
    if isinstance(before, FitConfig) and isinstance(now, FitConfig):
        part, before, now = first_difference(before, now, FitConfig.model_fields) or (part, before, now)
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
