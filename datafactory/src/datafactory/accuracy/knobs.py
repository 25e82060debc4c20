"""Every approximation between a scene and a frame as a knob: its settings, its default, its converged value.

Two kinds. The settings of a *signal* knob see the same traced paths, so that cubes and images can be subtracted. A
*power* knob changes the paths themselves and with them the speckle: subtracting images would compare two
realisations. What converges there is the power in a resolution cell (:mod:`datafactory.accuracy.power`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from datafactory.accuracy.variants import FAN
from datafactory.effects.catalogue import ALL, NAMES, EffectSet
from datafactory.frame.chain import ChainSettings
from datafactory.frame.measurement import Processing
from datafactory.paths.prune import UNPRUNED_DB
from datafactory.paths.solver import TraceSettings
from datafactory.synthesis.sorting import FLOAT32_TOLERANCE

_CHAIN = ChainSettings()
_TRACE, _PROCESSING = _CHAIN.trace, _CHAIN.processing


@dataclass(frozen=True)
class KnobSettings:
    """How one frame is made; the defaults are the pipeline's with every effect.

    :param effects: what may be simulated
    :param budget_db: what each frame may leave out of it, see :class:`datafactory.frame.chain.ChainSettings`
    :param rays, depth, finite_mirrors, surface_phase: see :class:`datafactory.paths.solver.TraceSettings`
    :param lattice: "fan", the pipeline's; "sphere", the solver's own lattice, of which the front half is used, as the
        fan does; "all around", all of it
    :param prune_db: see :func:`datafactory.paths.prune.pruned`
    :param delays: "exact", or "linear": one constant range rate a path, developed at mid-frame from the origin
    :param width: "complex64" or "complex128" sums in the cube, or "float32 geometry": coordinates rounded to float32
    :param tolerance: of the cube, relative L2
    :param video_phase: the residual video phase that eq. (1) leaves out
    :param truth_terms: polynomial terms of the range walk
    :param truth_wave: "spherical", or "plane": range FFT and far-field steering of the virtual sensor
    :param truth_window: over the virtual sensor's elements
    :param device: of the run, see :class:`datafactory.frame.chain.ChainSettings`
    """

    effects: EffectSet = ALL
    budget_db: float | None = None
    rays: int = _TRACE.rays
    depth: int = _TRACE.depth
    finite_mirrors: bool = True
    surface_phase: bool = True
    lattice: str = FAN
    prune_db: float = _CHAIN.prune_db
    delays: str = "exact"
    width: str = "complex64"
    tolerance: float = _PROCESSING.tolerance
    video_phase: bool = False
    truth_terms: int = _PROCESSING.truth_terms
    truth_wave: str = "spherical"
    truth_window: str = _PROCESSING.truth_window
    device: str = _CHAIN.device

    def chain(self) -> ChainSettings:
        """Settings of the chain with these effects, without noise; the polarisation is the radar's."""
        tolerance = self.tolerance
        if self.width == "complex128":
            tolerance = min(tolerance, 0.99 * FLOAT32_TOLERANCE)
        chosen = self.effects.settings(
            ChainSettings(
                trace=TraceSettings(
                    rays=self.rays,
                    depth=self.depth,
                    finite_mirrors=self.finite_mirrors,
                    surface_phase=self.surface_phase,
                ),
                processing=Processing(
                    noise=False,
                    tolerance=tolerance,
                    truth_terms=self.truth_terms,
                    truth_window=self.truth_window,
                ),
                prune_db=self.prune_db,
                device=self.device,
            )
        )
        return replace(chosen, budget_db=self.budget_db)

    def tracing(self) -> KnobSettings:
        """These settings as far as they change the power in a cell; all others as they are by default."""
        own = {name: getattr(self.effects, name) for name in POWER_EFFECTS}
        names = ("budget_db", "rays", "depth", "finite_mirrors", "surface_phase", "lattice", "truth_window", "device")
        return KnobSettings(effects=replace(ALL, **own), **{name: getattr(self, name) for name in names})

    def of_geometry(self) -> tuple[Any, ...]:
        """What decides delays and amplitudes of the same traced paths."""
        return (self.prune_db, self.delays, self.width == "float32 geometry", self.effects)

    def of_signal(self) -> tuple[Any, ...]:
        """What decides the cube of the same traced paths."""
        return (*self.of_geometry(), self.width, self.tolerance, self.video_phase)

    def of_truth(self) -> tuple[Any, ...]:
        """What decides the truth's moments of the same traced paths."""
        return (*self.of_geometry(), self.truth_terms)

    def of_image(self) -> tuple[Any, ...]:
        """What decides the truth image of the same traced paths."""
        return (*self.of_truth(), self.truth_wave, self.truth_window)


POWER_EFFECTS = (
    "specular", "diffuse", "multi_bounce", "refraction", "diffraction", "corners", "antenna_pattern", "rcs_targets",
)  # fmt: skip
"""Effects that add paths or change their power. What is left is motion, and the noise, which no frame here has."""
DEFAULT = KnobSettings()


def converged(settings: KnobSettings) -> KnobSettings:
    """What signal knobs are varied around: these settings with nothing pruned, the cube at -120 dB, the truth at its
    best."""
    return replace(settings, prune_db=UNPRUNED_DB, tolerance=1e-6, truth_terms=6)


@dataclass(frozen=True)
class Knob:
    """One field of :class:`KnobSettings`, or one effect of its set, and the values to try.

    :param power: whether it changes the paths, see the module
    :param paired: held against the default with the same rays, whose sampling is then common to both; otherwise against
        the densest fan
    :param beside: field and value of another setting that all values share, as (name, value)
    :param label: what it is called; its name by default
    """

    name: str
    values: tuple[Any, ...]
    power: bool = False
    paired: bool = True
    beside: tuple[str, Any] | None = None
    label: str = ""

    def __post_init__(self) -> None:
        if self.name not in {item.name for item in fields(KnobSettings)} | set(NAMES):
            raise ValueError(f"knob {self.name!r}; expected a field of KnobSettings or an effect")
        if not self.label:
            object.__setattr__(self, "label", self.name)

    def at(self, base: KnobSettings, value: Any) -> KnobSettings:
        """``base`` with this knob set to ``value``."""
        if self.beside is not None:
            base = replace(base, **dict([self.beside]))
        if self.name in NAMES:
            return replace(base, effects=replace(base.effects, **{self.name: value}))
        return replace(base, **{self.name: value})


def effect_knobs(effects: Collection[str]) -> tuple[Knob, ...]:
    """A knob that leaves out one effect, for each of these; multiple bounces are the knob ``depth``."""
    return tuple(
        Knob(name, (False,), power=name in POWER_EFFECTS)
        for name in ("doppler", *POWER_EFFECTS)
        if name in effects and name != "multi_bounce"
    )


def _rays(fan: tuple[int, ...], sphere: tuple[int, ...]) -> tuple[Knob, ...]:
    return (
        Knob("rays", fan, power=True, paired=False),
        Knob("rays", sphere, power=True, paired=False, beside=("lattice", "sphere"), label=SPHERE_RAYS),
    )


FAN_RAYS = (3_125, 6_250, 12_500, 25_000, 50_000, 100_000, 200_000, 400_000, 800_000)
"""What a full sweep tries, and what an error budget chooses from. Fewer save nothing: a pass of rays has a price
whatever their number (:data:`datafactory.accuracy.work.RAY_PASS`).
"""
SPHERE_RAYS = "sphere rays"
"""Label of the rows with rays of the solver's own lattice."""
SIGNAL_KNOBS = (
    Knob("tolerance", (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-9)),
    Knob("width", ("complex64", "complex128", "float32 geometry")),
    Knob("prune_db", (-20.0, -30.0, -40.0, -50.0, -60.0, UNPRUNED_DB)),
    Knob("delays", ("linear",)),
    Knob("video_phase", (False, True)),
    Knob("truth_terms", (3, 4, 5, 6)),
    Knob("truth_wave", ("plane",)),
    Knob("truth_window", ("none", "taylor-25", "taylor-30", "hann")),
)
POWER_KNOBS = (
    *_rays(FAN_RAYS, (200_000, 400_000, 800_000, 1_600_000)),
    Knob("lattice", ("all around",), power=True, paired=False),
    Knob("depth", (1, 2, 3), power=True),
    Knob("finite_mirrors", (False,), power=True),
    Knob("surface_phase", (False,), power=True),
)
QUICK_SIGNAL_KNOBS = (
    Knob("tolerance", (1e-2, 1e-3, 1e-4, 1e-6)),
    Knob("width", ("float32 geometry",)),
    Knob("prune_db", (-20.0, -30.0, -40.0, -50.0, -60.0)),
    Knob("delays", ("linear",)),
    Knob("video_phase", (True,)),
    Knob("truth_terms", (3, 4, 5, 6)),
    Knob("truth_wave", ("plane",)),
    Knob("truth_window", ("hann",)),
)
QUICK_POWER_KNOBS = (
    *_rays(tuple(rays for rays in FAN_RAYS if rays <= DEFAULT.rays), (100_000, 200_000)),
    Knob("depth", (1, 2, 3), power=True),
    Knob("finite_mirrors", (False,), power=True),
    Knob("surface_phase", (False,), power=True),
)


def most_rays(knobs: Sequence[Knob]) -> int:
    """The most rays of the fan that are tried."""
    return max(value for knob in knobs if knob.label == "rays" for value in knob.values)


def with_more_rays(knobs: Sequence[Knob], most: int) -> tuple[Knob, ...]:
    """The knobs, that of the fan's rays going on in doublings to ``most``, which is the last."""

    def doubled(values: tuple[Any, ...]) -> tuple[Any, ...]:
        more = list(values)
        while 2 * more[-1] < most:
            more.append(2 * more[-1])
        return (*more, most) if most > more[-1] else tuple(more)

    return tuple(replace(knob, values=doubled(knob.values)) if knob.label == "rays" else knob for knob in knobs)


REFERENCE_DEPTH = 3
REFERENCE_RAYS = 1_600_000
BUDGET_REFERENCE_RAYS = 800_000
"""Of a budget's reference: as many as the menu's most in each realisation, whose mean over four errs half as much; what
is left of it is subtracted.
"""
QUICK_REFERENCE_RAYS = 400_000
QUICK_RAYS = 50_000
"""Of everything but the rays' own rows in a quick sweep: a quarter of the default."""
REFERENCE_TOLERANCE = 1e-11
"""Of the reference cube, complex128: two orders below the finest setting swept."""
REFERENCE_TERMS = 8
"""Of the reference image: its range walk is then developed to -120 dB."""
