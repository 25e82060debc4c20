"""Radar datasets to networks that image sharper than the array.

The functions ``fit``, ``predict``, ``evaluate``, ``export``, ``import_capture`` and ``calibrate`` are those behind the
commands of the same names. All names are imported when they are first used, so that ``import trainer`` loads neither
PyTorch nor Lightning. What this module names is stable; other modules may change.
"""

from typing import TYPE_CHECKING

from shared.processes.lazy import lazy_names

if TYPE_CHECKING:
    from shared.physics.errors import InputError as InputError
    from trainer import estimators as estimators
    from trainer.captures.calibrating import calibrate as calibrate
    from trainer.captures.importing import import_capture as import_capture
    from trainer.data.arrays import choose_array as choose_array
    from trainer.data.dataset import Example as Example
    from trainer.data.dataset import RadarDataset as RadarDataset
    from trainer.evaluation.evaluate import evaluate as evaluate
    from trainer.run.export import export as export
    from trainer.run.folder import Run as Run
    from trainer.run.folder import load_imager as load_imager
    from trainer.run.imager import Imager as Imager
    from trainer.run.predict import Predictor as Predictor
    from trainer.run.predict import predict as predict
    from trainer.run.pretrained import pretrained_names as pretrained_names
    from trainer.run.pretrained import pretrained_run as pretrained_run
    from trainer.training.fit import fit as fit

__version__: str
_MODULES = {
    "shared.physics.errors": ("InputError",),
    "trainer.captures.calibrating": ("calibrate",),
    "trainer.captures.importing": ("import_capture",),
    "trainer.data.arrays": ("choose_array",),
    "trainer.data.dataset": ("Example", "RadarDataset"),
    "trainer.estimators": ("estimators",),
    "trainer.evaluation.evaluate": ("evaluate",),
    "trainer.run.export": ("export",),
    "trainer.run.folder": ("Run", "load_imager"),
    "trainer.run.imager": ("Imager",),
    "trainer.run.predict": ("Predictor", "predict"),
    "trainer.run.pretrained": ("pretrained_names", "pretrained_run"),
    "trainer.training.fit": ("fit",),
}
__all__ = sorted(name for names in _MODULES.values() for name in names)
__getattr__, __dir__ = lazy_names(__name__, _MODULES)
