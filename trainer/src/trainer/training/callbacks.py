"""What a run leaves behind while it trains: metrics, best weights, checkpoint, pictures; and how it is ended early."""

from __future__ import annotations

import csv
import signal
import threading
import zipfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.loggers import Logger, MLFlowLogger, TensorBoardLogger, WandbLogger

from shared.dataset.writing import atomic
from shared.physics.errors import InputError
from trainer.defaults import OTHERS, TENSORBOARD
from trainer.run.folder import CHECKPOINT, LOSS, METRICS, METRICS_COLUMNS, VALIDATION_GAIN, save_weights
from trainer.run.pictures import panel
from trainer.training.task import Batch, ImagingTask

PROJECT = "sparseradar"


def check_logger(name: str) -> None:
    """:raises InputError: a package that is not installed, with the command that installs it"""
    if name in OTHERS and find_spec(name) is None:
        raise InputError("--logger", f"the package {name} is not installed", f"pip install {name}")


def make_logger(name: str, out: Path) -> Logger | bool:
    """The logger of a run, as Lightning takes it; False for none.

    :param name: one that :func:`check_logger` lets pass
    :param out: the run folder, where it keeps its files
    """
    if name == "wandb":
        return WandbLogger(save_dir=out, name=out.resolve().name, project=PROJECT)
    if name == "mlflow":
        return MLFlowLogger(PROJECT, run_name=out.resolve().name, save_dir=str(out / name))
    return TensorBoardLogger(out, name="", version=TENSORBOARD) if name == TENSORBOARD else False


RESTORED = {"state_dict", "optimizer_states", "lr_schedulers", "loops", "callbacks"}
"""Parts of a checkpoint."""


class RunKeeper(Callback):
    """Keeps the run folder up to date at every validation, each file whole or not at all.

    The first is before the first step, Lightning's sanity check: an untrained network may be an estimator, and a run
    keeps no worse one.

    The best weights are those of the least loss of the validation frames. It weighs image and detections as training
    does; the normalised error of the linear image hangs on a few flashes, and stays where detections double.

    Lightning's EarlyStopping counts after the checkpoint is written, and not what stood there before the first step: a
    resumed run would end elsewhere.

    :param patience: validations without a better loss after which the training stops; 0: it does not
    :ivar started: the first step is next
    """

    def __init__(self, directory: Path, patience: int, announce: Callable[[str], object]) -> None:
        self.directory, self.patience, self.announce = directory, patience, announce
        self.best, self.waited = float("inf"), 0
        self.started = False

    def on_train_start(self, trainer: Trainer, *_: Any) -> None:
        """What the checkpoint holds has been restored."""
        self.started = True
        trainer.should_stop = self._stops

    @property
    def _stops(self) -> bool:
        return 0 < self.patience <= self.waited

    def state_dict(self) -> dict[str, Any]:
        return {"least_loss": self.best, "waited": self.waited}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self.best, self.waited = state_dict["least_loss"], state_dict["waited"]

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        values = {name: float(value) for name, value in trainer.callback_metrics.items()}
        value = values[LOSS]
        improved = value < self.best
        self.best, self.waited = min(self.best, value), 0 if improved else self.waited + 1
        trainer.should_stop = trainer.should_stop or self._stops
        if trainer.is_global_zero:
            self._report(trainer, pl_module, values, improved)
        if trainer.sanity_checking:
            return  # there is nothing to resume yet
        # The checkpoint comes last: a run that is killed before it repeats this validation. All processes take part.
        if trainer.is_global_zero:
            with atomic(self.directory / CHECKPOINT) as partial:
                trainer.save_checkpoint(partial)
        else:
            trainer.save_checkpoint(self.directory / CHECKPOINT)  # takes part, writes nothing

    def _report(self, trainer: Trainer, pl_module: LightningModule, values: dict[str, float], improved: bool) -> None:
        row: dict[str, Any] = {"step": trainer.global_step, **values}
        first = trainer.sanity_checking  # also of a run that was killed before its first checkpoint
        earlier = [] if first else self._rows_before(trainer.global_step)
        with atomic(self.directory / METRICS) as partial, partial.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, METRICS_COLUMNS)
            writer.writeheader()
            writer.writerows([*earlier, {name: row.get(name, "") for name in METRICS_COLUMNS}])
        shown = "  ".join(f"{name} {row[name]:.4g}" for name in METRICS_COLUMNS[1:] if name in row)
        remark = "  (best)" if improved else f"  ends: the {self.waited}. without gain" if self._stops else ""
        self.announce(f"step {trainer.global_step}  {shown}{remark}")
        if improved:
            assert isinstance(pl_module, ImagingTask)
            save_weights(self.directory, pl_module.imager, values.get(VALIDATION_GAIN, 1.0))

    def _rows_before(self, step: int) -> list[dict[str, str]]:
        """A run that was killed between a row and its checkpoint has later ones, which come again."""
        if not (path := self.directory / METRICS).is_file():
            return []
        with path.open(newline="", encoding="utf-8") as file:
            return [row for row in csv.DictReader(file) if int(row["step"]) < step]


def require_checkpoint(path: Path) -> None:
    """Refuse a damaged checkpoint before anything depends on it: torch does not look at the checksums that it writes.

    :raises InputError: naming the file
    """
    try:
        with zipfile.ZipFile(path) as archive:
            if (piece := archive.testzip()) is not None:
                raise ValueError(f"{piece} is damaged")
        content = torch.load(path, map_location="cpu", weights_only=True)
        if missing := sorted(RESTORED - set(content)):  # Lightning goes on from the first step without a word
            raise ValueError(f"no {missing[0]}")
    except Exception as error:  # torch raises whatever its zip reader and its unpickler come across
        raise not_restored(path, error) from error


def not_restored(path: Path, error: Exception) -> InputError:
    """A checkpoint that cannot be read, or is of something else, in one line."""
    reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
    wanted = "the last checkpoint of this run; without that file --resume begins the run anew"
    return InputError(path, f"cannot be restored: {reason}", wanted)


class Interrupts(Callback):
    """An interrupt, or a request to end, ends the training after the batch at hand; a second one ends it at once.

    In the middle of a batch it can strike while TensorBoard's writer is handed a number, and that waits two minutes for
    the next one before it ends. A context, within which it answers SIGINT and SIGTERM.

    :param first: of the processes. Another one leaves Ctrl-C to the first, and a request to end ends it at once: if it
        ended after its batch, the first one would wait for ever for its part of the next
    """

    def __init__(self, first: bool = True) -> None:
        self.asked = False
        self._before: dict[signal.Signals, Any] = {}
        answers = (self._ask, self._ask) if first else (signal.SIG_IGN, signal.SIG_DFL)
        self._answers: dict[signal.Signals, Any] = dict(zip((signal.SIGINT, signal.SIGTERM), answers, strict=True))

    def __enter__(self) -> Interrupts:
        self._before = self._answer()
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def on_train_start(self, *_: Any) -> None:
        """Lightning's answer stands in front by now; it sends a tensor to the others, who may be sending theirs."""
        self._answer()

    def on_train_batch_end(self, *_: Any, **__: Any) -> None:
        if self.asked:
            raise KeyboardInterrupt

    def on_validation_batch_end(self, *_: Any, **__: Any) -> None:
        self.on_train_batch_end()

    def _answer(self) -> dict[signal.Signals, Any]:
        """What answered before."""
        if threading.current_thread() is not threading.main_thread():  # no other may say what answers a signal
            return {}
        return {number: signal.signal(number, answer) for number, answer in self._answers.items()}

    def _ask(self, _number: int, _frame: FrameType | None) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True


class PictureLogger(Callback):
    """DaS, estimate and truth of the first validation frame into TensorBoard at every validation."""

    def on_validation_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Batch, batch_idx: int, *_: Any
    ) -> None:
        if batch_idx or not trainer.is_global_zero or not isinstance(trainer.logger, TensorBoardLogger):
            return
        assert isinstance(pl_module, ImagingTask)
        imager = pl_module.imager
        with torch.no_grad():
            snapshot = batch["range_channel"][:1, 0]
            images = {
                "delay and sum": imager.das(snapshot)[0],
                "network": imager(snapshot, batch["noise_power"][:1])[0],
                "truth": batch["image"][0],
            }
        picture = panel({name: image.float().cpu().numpy() for name, image in images.items()})
        trainer.logger.experiment.add_image("first validation frame", picture, trainer.global_step, dataformats="HWC")
