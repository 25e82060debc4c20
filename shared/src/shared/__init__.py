"""Array geometry, FMCW signal model, imaging and the dataset's format: :mod:`shared.radar`, :mod:`shared.signal`,
:mod:`shared.dataset`.
"""

from shared.processes.lazy import lazy_names

__version__: str

__getattr__, __dir__ = lazy_names(__name__, {})
