"""A picture of a plan: what each effect contributes, and what it costs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from datafactory.effects.losses import FLOOR_DB
from datafactory.effects.plan import EffectPlan
from shared.dataset.writing import atomic

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
    price.barh(place, [cost_seconds[name] for name in names], color=colours)
    price.set(xlabel="cost [s of one core a frame]")
    figure.suptitle(f"{plan.scene}: effects simulated (blue) and left out (grey)", fontsize=10)
    with atomic(path) as partial:
        figure.savefig(partial, format="png", dpi=130)
