"""Every approximation between a scene and a frame as a knob: its settings, its default, its converged value.

Two kinds. The settings of a *signal* knob see the same traced paths, so that cubes and images can be subtracted. A
*power* knob changes the paths themselves and with them the speckle: subtracting images would compare two
realisations. What converges there is the power in a resolution cell averaged over realisations.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

from datafactory.frames import Processing
from datafactory.paths.prune import DEFAULT_LEVEL_DB
from datafactory.paths.solver import TraceSettings

_TRACE, _PROCESSING = TraceSettings(), Processing()
UNPRUNED_DB = -200.0
"""Pruning level that keeps every path that float64 can tell from zero."""


@dataclass(frozen=True)
class Settings:
    """How one frame is made; the defaults are the pipeline's.

    :param rays, depth, specular, diffuse: see :class:`datafactory.paths.trace.TraceSettings`
    :param lattice: "fan", the pipeline's, or "sphere", the solver's own full-sphere lattice
    :param prune_db: see :func:`datafactory.paths.prune.pruned`
    :param delays: "exact", or "linear": one constant range rate a path, developed at mid-frame from the origin
    :param width: "complex64" or "complex128" sums in the cube, or "float32 geometry": coordinates rounded to float32
    :param tolerance: of the cube, relative L2
    :param input_wave: "spherical" or "plane" waves over the input array
    :param video_phase: the residual video phase that eq. (1) leaves out
    :param truth_terms: polynomial terms of the range walk
    :param truth_wave: "spherical", or "plane": range FFT and far-field steering of the virtual sensor
    :param truth_window: over the virtual sensor's elements
    """

    rays: int = _TRACE.rays
    depth: int = _TRACE.depth
    specular: bool = True
    diffuse: bool = True
    lattice: str = "fan"
    prune_db: float = DEFAULT_LEVEL_DB
    delays: str = "exact"
    width: str = "complex64"
    tolerance: float = _PROCESSING.tolerance
    input_wave: str = "spherical"
    video_phase: bool = False
    truth_terms: int = _PROCESSING.truth_terms
    truth_wave: str = "spherical"
    truth_window: str = _PROCESSING.truth_window

    def trace(self) -> TraceSettings:
        return TraceSettings(rays=self.rays, depth=self.depth, specular=self.specular, diffuse=self.diffuse)


DEFAULT = Settings()
CONVERGED = replace(DEFAULT, prune_db=UNPRUNED_DB, truth_terms=6)
"""What signal knobs are varied around: the pipeline's tracing, nothing pruned, cube at -120 dB, truth at its best."""


@dataclass(frozen=True)
class Knob:
    """One field of :class:`Settings` and the values to try.

    :param power: whether it changes the paths, see the module
    """

    name: str
    values: tuple[Any, ...]
    power: bool = False

    def __post_init__(self) -> None:
        if self.name not in {item.name for item in fields(Settings)}:
            raise ValueError(f"knob {self.name!r}; expected a field of Settings")

    def at(self, base: Settings, value: Any) -> Settings:
        """``base`` with this knob set to ``value``."""
        return replace(base, **{self.name: value})


SIGNAL_KNOBS = (
    Knob("tolerance", (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)),
    Knob("width", ("complex64", "complex128", "float32 geometry")),
    Knob("prune_db", (-20.0, -30.0, -40.0, -50.0, -60.0, UNPRUNED_DB)),
    Knob("delays", ("exact", "linear")),
    Knob("input_wave", ("spherical", "plane")),
    Knob("video_phase", (False, True)),
    Knob("truth_terms", (3, 4, 5, 6)),
    Knob("truth_wave", ("spherical", "plane")),
    Knob("truth_window", ("none", "taylor-25", "taylor-30", "hann")),
)
POWER_KNOBS = (
    Knob("rays", (25_000, 50_000, 100_000, 200_000, 400_000, 800_000), power=True),
    Knob("lattice", ("fan", "sphere"), power=True),
    Knob("depth", (1, 2, 3), power=True),
    Knob("specular", (True, False), power=True),
    Knob("diffuse", (True, False), power=True),
)
QUICK_SIGNAL_KNOBS = (
    Knob("tolerance", (1e-3, 1e-6, 1e-9)),
    Knob("width", ("complex128", "float32 geometry")),
    Knob("prune_db", (-30.0, -50.0)),
    Knob("delays", ("linear",)),
    Knob("input_wave", ("plane",)),
    Knob("video_phase", (True,)),
    Knob("truth_terms", (3, 5, 6)),
    Knob("truth_wave", ("plane",)),
    Knob("truth_window", ("hann",)),
)
QUICK_POWER_KNOBS = (
    Knob("rays", (25_000, 50_000, 100_000, 200_000), power=True),
    Knob("lattice", ("sphere",), power=True),
    Knob("depth", (1,), power=True),
    Knob("specular", (False,), power=True),
    Knob("diffuse", (False,), power=True),
)

REFERENCE_DEPTH = 3
REFERENCE_RAYS = 1_600_000
QUICK_REFERENCE_RAYS = 400_000
QUICK_RAYS = 50_000
"""Of everything but the rays' own rows in a quick sweep: a quarter of the default."""
REFERENCE_TOLERANCE = 1e-11
"""Of the reference cube, complex128: two orders below the finest setting swept."""
REFERENCE_TERMS = 8
"""Of the reference image: its range walk is then developed to -120 dB."""
