"""What frames decide by themselves, said aloud and drawn: every effect, on or off, why, what leaving it out changes.

A frame leaves out what its radar would not notice (:mod:`datafactory.paths.notice`). To say so, it is traced with all
that the scene has, and then decides as it does in a run that renders stored paths, which is as if it were rendered at
once. What leaving an effect out would change is of the complete frame: added echoes are weighed by the power of their
kind in the truth's resolution cells, changes of the signal by the closed forms of :mod:`datafactory.frame.decision`.
Nothing that is said here is used by a run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from datafactory.effects.catalogue import DESCRIPTIONS, NAMES, NO_CHOICE, EffectSet
from datafactory.frame import decision
from datafactory.frame.chain import SceneSource, illuminated, narrowed
from datafactory.frame.decision import KINDS, Decided, bounces_more_than_once, path_effects
from datafactory.paths.candidates import (
    CHAIN,
    CORNER,
    EDGE,
    MIRRORED,
    PANE,
    PASSED,
    TARGET_MIRRORED,
    TARGET_SEEN,
    TWICE,
)
from datafactory.paths.cells import cell_map, cell_power
from datafactory.paths.notice import Notice
from datafactory.paths.table import PathTable
from shared.physics.units import power_to_db
from shared.physics.vectors import Mask, Real
from shared.pictures import save_figure
from shared.radar import Radar
from shared.signal.windows import cell_noise_power

FLOOR_DB = -200.0
"""Stands for "nothing" where a level is asked for."""
HALF_A_DECIBEL = 0.12
"""As a share of a cell's power."""
NOISE_MARGIN = 1e3
"""A range bin whose strongest echo is less than 30 dB above the noise shows it."""


@dataclass(frozen=True)
class Loss:
    """What a frame loses without one effect.

    :param change_db: of the power in a resolution cell over the peak's, the largest; FLOOR_DB where nothing changes
    :param power_share: of the frame's power
    :param cell_share: of the cells above the noise, those that change by more than half a decibel; of noise, the
        share of range bins that show it
    """

    change_db: float = FLOOR_DB
    power_share: float = 0.0
    cell_share: float = 0.0

    def __str__(self) -> str:
        share, cells = 100.0 * self.power_share, 100.0 * self.cell_share
        return f"{share:.3g} % of the power and {cells:.3g} % of the occupied cells"

    @staticmethod
    def worst(losses: Sequence[Loss]) -> Loss:
        """Of several frames: the largest change, mean shares."""
        return Loss(
            max(each.change_db for each in losses),
            float(np.mean([each.power_share for each in losses])),
            float(np.mean([each.cell_share for each in losses])),
        )


def losses(paths: PathTable, radar: Radar, truth_window: str) -> dict[str, Loss]:
    """Of every effect, by name.

    :param paths: of every effect, illuminated
    """
    where, waveform, kinds = cell_map(paths, radar, truth_window), radar.waveform, paths.every("kinds")
    total = where.sums()
    noise, peak = cell_noise_power(radar), float(total.max())
    occupied = total > noise / radar.array.channels
    rates = decision.range_rates_mps(paths, waveform)
    shares = {
        **{name: (kinds & kind > 0).astype(np.float64) for name, kind in KINDS.items()},
        "multi_bounce": bounces_more_than_once(paths).astype(np.float64),
        "doppler": decision.doppler_change(rates, waveform) ** 2 * (waveform.chirps > 1),
        "range_migration": decision.migration_change(rates, waveform) ** 2 * (waveform.chirps > 1),
        "intra_chirp_motion": decision.intra_chirp_change(rates, waveform) ** 2,
        "near_field": decision.plane_wave_change(paths, radar.array, waveform.wavelength_m) ** 2,
        "antenna_pattern": decision.pattern_change(paths, radar) ** 2,
    }

    def loss(share: Real) -> Loss:
        changed = where.sums(share)
        if not changed.any():
            return Loss()
        level_db = float(power_to_db(min(float(changed.max() / peak), 1.0), FLOOR_DB))
        cells = changed[occupied] > HALF_A_DECIBEL * total[occupied]
        return Loss(level_db, min(float(changed.sum() / total.sum()), 1.0), float(cells.mean()) if cells.size else 0.0)

    found = {name: loss(share) for name, share in shares.items()}
    over_peak = noise / radar.array.channels / peak if peak > 0.0 else 1.0
    weak = float(np.mean(total.max(axis=1) < NOISE_MARGIN * noise))
    found["noise"] = Loss(float(power_to_db(min(over_peak, 1.0), FLOOR_DB)), 0.0, weak)
    return {name: found[name] for name in NAMES}


FAMILIES = {
    "multi_bounce": (TWICE, MIRRORED, CHAIN, PASSED, TARGET_MIRRORED),
    "refraction": (PANE,),
    "diffraction": (EDGE,),
    "corners": (CORNER,),
    "rcs_targets": (TARGET_SEEN,),
}
"""Effects of which a frame knows candidates, and of which kinds."""
ABSENT = {
    "specular": "no mirror leads back to the radar",
    "diffuse": "no rough surface is in sight",
    "multi_bounce": "nothing bounces a second time",
    "refraction": "no material lets a wave through",
    "diffraction": "no edge has a point that sends back",
    "corners": "no two faces at a right angle look at the radar",
    "doppler": "nothing moves, neither the radar nor anything that it sees, or one chirp is sent, which tells none",
    "range_migration": "nothing moves, neither the radar nor anything that it sees, or one chirp is sent",
    "intra_chirp_motion": "nothing moves, neither the radar nor anything that it sees",
    "antenna_pattern": "the radar's elements are isotropic",
    "rcs_targets": "the scene has no target with a radar cross section",
    "noise": "receiver noise is not asked for",
}
"""Why an effect has nothing to work on."""


@dataclass(frozen=True)
class Decision:
    """One effect of a plan.

    :param on: whether any of the frames is made with it
    :param reason: why, in words; :param evidence: the figures behind it
    :param loss_db: what leaving it out changes [dB of the peak]
    """

    effect: str
    on: bool
    reason: str
    evidence: str
    loss_db: float


@dataclass(frozen=True)
class EffectPlan:
    """What is simulated in some frames of one scene, and why.

    :param scene: its name; :param budget_db: what may be left out
    :param decisions: one an effect, in the order of the chain
    :param shares: effect -> (power share, share of the occupied cells), for the picture
    """

    scene: str
    budget_db: float
    decisions: tuple[Decision, ...]
    shares: Mapping[str, tuple[float, float]]

    @property
    def effects(self) -> EffectSet:
        """Those that any of the frames is made with."""
        return EffectSet.of({item.effect for item in self.decisions if item.on})

    def to_json(self) -> dict[str, Any]:
        return {
            "scene": self.scene,
            "budget_db": self.budget_db,
            "effects": [dict(vars(item)) for item in self.decisions],
        }


@dataclass(frozen=True)
class FramePlan:
    """What one frame decides.

    :param effects: by name, whether it is made with them
    :param losses: by name, what it loses without
    :param bounds_db: the strongest candidate of an effect [dB of the peak], of those that have any
    :param followed: effects with a candidate that the radar would notice
    :param limit: which of both the frame is held against, the one that is lower
    """

    effects: Mapping[str, bool]
    losses: Mapping[str, Loss]
    bounds_db: Mapping[str, float]
    followed: frozenset[str]
    limit: str


def plan_of_frame(source: SceneSource, radar: Radar) -> FramePlan:
    """What a frame decides: traced with all that the scene has.

    :param source: with every effect and a budget
    """
    settings = source.settings
    notice, window = settings.notice(radar), settings.processing.truth_window
    if notice is None:
        raise ValueError("budget_db is None; expected a budget, by which frames decide")
    complete = replace(source, settings=replace(settings, budget_db=None)).traced(radar)
    narrow, kept = narrowed(complete, settings, radar)
    every = illuminated(complete, settings, radar)
    peak = float(cell_power(every, radar, window).max(initial=0.0))
    table = complete.table.at_wavelength(complete.wavelength_m, radar.waveform.wavelength_m)
    decided, lost = Decided.of(table, notice), losses(every, radar, window)
    if not settings.processing.noise:
        lost["noise"] = Loss()
    bounds, followed = _weighed(table, notice, decided.worth, peak)
    by_noise = notice.below_noise and decided.limit_w == cell_noise_power(radar)
    limit = "the receiver's noise" if by_noise else "the error budget"
    return FramePlan({**path_effects(kept), **narrow.signal_effects(radar)}, lost, bounds, followed, limit)


def _weighed(table: PathTable, notice: Notice, worth: Mask, peak: float) -> tuple[dict[str, float], frozenset[str]]:
    """The strongest candidate of every effect [dB of the peak], and the effects that are followed."""
    power = notice.power_w(table.candidates)
    bounds, followed = dict[str, float](), set[str]()
    for name, families in FAMILIES.items():
        own = np.isin(table.candidates.family, families) & (power > 0.0)
        if own.any():
            bounds[name] = float(power_to_db(float(power[own].max()) / peak, FLOOR_DB)) if peak > 0.0 else 0.0
        if worth[own].any():
            followed.add(name)
    return bounds, frozenset(followed)


def plan_of_scene(scene: str, frames: Sequence[FramePlan], budget_db: float) -> EffectPlan:
    """What some frames of a scene decide, together."""
    if not frames:
        nothing = tuple(Decision(name, False, NO_FRAME, "", FLOOR_DB) for name in NAMES)
        return EffectPlan(scene, budget_db, nothing, {})
    worst = {name: Loss.worst([frame.losses[name] for frame in frames]) for name in NAMES}
    decisions = tuple(
        Decision(
            name, any(frame.effects[name] for frame in frames), _reason(name, frames, worst[name]), str(worst[name]),
            round(worst[name].change_db, 1) + 0.0,
        )
        for name in NAMES
    )  # fmt: skip
    return EffectPlan(
        scene, budget_db, decisions, {name: (loss.power_share, loss.cell_share) for name, loss in worst.items()}
    )


NO_FRAME = "no frame of the run stands in this scene"


def _reason(name: str, frames: Sequence[FramePlan], worst: Loss) -> str:
    what, having = DESCRIPTIONS[name].split(";")[0], sum(frame.effects[name] for frame in frames)
    in_frames = "" if len(frames) == 1 else f", in {having} of {len(frames)} frames"
    bound_db = max((frame.bounds_db[name] for frame in frames if name in frame.bounds_db), default=FLOOR_DB)
    limit = " or ".join(dict.fromkeys(frame.limit for frame in frames if frame.effects[name] or not having))
    if having and name in NO_CHOICE:
        return f"{what}: leaving it out saves nothing{in_frames}"
    if having and worst.change_db <= FLOOR_DB:
        return f"{what}{in_frames}"
    if having:
        held = f"; the limit is {limit}" if name in {*FAMILIES, "doppler"} - {"rcs_targets"} else ""
        return f"{what}: {_told(worst.change_db)} of the peak without it{in_frames}{held}"
    if bound_db <= FLOOR_DB and worst.change_db <= FLOOR_DB:
        return ABSENT.get(name, what)
    if any(name in frame.followed for frame in frames):
        if worst.change_db <= FLOOR_DB:
            return f"{what}: looked for, nothing of it is in sight"
        return f"{what}: looked for; what is in sight is {_told(worst.change_db)} of the peak, all of it below {limit}"
    level_db = bound_db if bound_db > FLOOR_DB else worst.change_db
    return f"{what}: each at most {_told(level_db)} of the peak, all of it below {limit}"


def _told(level_db: float) -> str:
    """Without the minus that rounding leaves of nothing."""
    return f"{round(level_db, 1) + 0.0:.1f} dB"


ON, OFF = "#1b6ca8", "#b8b8b8"
LOWEST_DB = -80.0


def draw(plan: EffectPlan, cost_seconds: Mapping[str, float], path: Path) -> None:
    """Write the picture: loss without each effect, its share of power and cells, its price."""
    names = [item.effect for item in plan.decisions]
    place = np.arange(len(names))[::-1]
    colours = [ON if item.on else OFF for item in plan.decisions]
    figure = Figure(figsize=(12.0, 4.6), layout="constrained")
    loss, share, price = figure.subplots(1, 3, sharey=True, width_ratios=(2.0, 1.6, 1.0))
    levels = np.array([max(item.loss_db, LOWEST_DB) for item in plan.decisions])
    loss.barh(place, levels - LOWEST_DB, left=LOWEST_DB, color=colours)
    for at, item in zip(place, plan.decisions, strict=True):
        if item.loss_db <= FLOOR_DB:
            loss.text(LOWEST_DB + 1.0, at, item.reason, va="center", fontsize=7, color="#606060")
    loss.axvline(plan.budget_db, color="#b02020", linewidth=1.0)
    loss.text(plan.budget_db + 1.0, len(names) - 0.4, f"budget {plan.budget_db:g} dB", color="#b02020", fontsize=7)
    loss.set(xlim=(LOWEST_DB, 2.0), xlabel="change without it [dB of the peak]", yticks=place, yticklabels=names)
    power, cells = (100.0 * np.array([plan.shares.get(name, (0.0, 0.0))[which] for name in names]) for which in (0, 1))
    share.barh(place + 0.2, power, height=0.38, color=colours, label="of the power")
    share.barh(place - 0.2, cells, height=0.38, color=colours, alpha=0.45, label="of the occupied cells")
    share.set(xlim=(0.0, 100.0), xlabel="share that it changes [%]")
    share.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, 1.09), ncols=2, frameon=False)
    price.barh(place, [cost_seconds.get(name, 0.0) for name in names], color=colours)
    price.set(xlabel="cost [s of one core a frame]" if cost_seconds else "cost: not measured")
    figure.suptitle(f"{plan.scene}: effects simulated (blue) and left out (grey)", fontsize=10)
    save_figure(figure, path, 130)
