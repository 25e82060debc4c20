"""Classical estimators of angle: one snapshot, any line of virtual elements, all range bins at once.

``ESTIMATORS["iaa"]().image(snapshots, line_array(radar, channels), radar.grid.u, noise_power)`` is an image [R, U].
"""

from typing import TYPE_CHECKING

from shared.processes.lazy import lazy_names

if TYPE_CHECKING:
    from trainer.estimators.array import LineArray as LineArray
    from trainer.estimators.array import line_array as line_array
    from trainer.estimators.base import ESTIMATORS as ESTIMATORS
    from trainer.estimators.base import UNIFORM_ESTIMATORS as UNIFORM_ESTIMATORS
    from trainer.estimators.base import Estimator as Estimator

_MODULES = {
    "trainer.estimators.array": ("LineArray", "line_array"),
    "trainer.estimators.base": ("ESTIMATORS", "UNIFORM_ESTIMATORS", "Estimator"),
}
__all__ = sorted(name for names in _MODULES.values() for name in names)
__getattr__, __dir__ = lazy_names(__name__, _MODULES)
