"""What it takes to say that a scene calls for an effect: the rule of each, a verdict with its figure, its reason.

First hits and single mirrors are in every frame. Other echoes are on where they exceed the frame's limit: the smaller
of the error budget below the strongest of these, and the noise of a channel's range-Doppler cell. So is Doppler, by
what it changes. Range migration and motion within the chirp come with it; near field, patterns and noise are always
there.
Nothing here is measured with the tracer: figures are the formulas of ``levels``, and None where the scene lacks
what the effect works on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from effect_scenes import levels

BUDGET_DB = -30.0

RULES = {
    "specular": "power of the paths with a mirror, where strongest in a resolution cell of the truth, over its peak",
    "diffuse": "power of the paths with a diffuse bounce, in a resolution cell likewise",
    "multi_bounce": "power of the paths of two or more bounces, in a resolution cell likewise; a pane is no bounce",
    "refraction": "power of the paths through panes, in a resolution cell likewise; off means that panes are opaque",
    "diffraction": "power of edges' echoes, and of point targets seen round an edge, in a resolution cell likewise; "
    "what a mirror's size does within the Fresnel zones around its specular point belongs to specular",
    "corners": "power of right-angled corners' echoes, of a bounce on either face, in a resolution cell likewise",
    "doppler": "change of the range-Doppler spectrum over its peak, frozen frame against moving",
    "range_migration": "change of the range-Doppler spectrum over its peak, echo kept at its mid-frame range",
    "intra_chirp_motion": "change of the range spectrum over its peak, delay frozen within the chirp at its middle",
    "near_field": "change of the input array's image over its peak, plane wave of the same angle at RX and TX, a phase "
    "common to all channels taken out; the truth always has spherical waves",
    "antenna_pattern": "change of an echo over the peak where every direction gets the gain of boresight",
    "rcs_targets": "power of the point targets over the strongest cell",
    "noise": "receiver noise in one channel's range-Doppler cell over the weakest range bin's echo there: a range bin "
    "without an echo holds nothing else",
}
"""What "change" means for each effect: what leaving it out would change."""
FIRST = ("specular", "diffuse")
"""In every frame, where the scene has them."""
ALWAYS = ("near_field", "antenna_pattern", "noise")
WITH_DOPPLER = ("doppler", "range_migration", "intra_chirp_motion")


@dataclass(frozen=True)
class Verdict:
    """One effect in one scene.

    :param change_db: predicted change [dB], see RULES; None where there is nothing that could change
    :param reason: in one line
    :param more: whether there are echoes of the kind beside, above the limit, whose level is not predicted here
    """

    change_db: float | None
    reason: str
    more: bool = False


@dataclass(frozen=True)
class Echo:
    """One echo's level, to hold a simulation against.

    :param what: which echo, and by which formula
    :param range_m: from the first pose [m]
    :param power_dbw: of one channel in one range-Doppler cell [dBW]
    """

    what: str
    range_m: float
    power_dbw: float

    def to_json(self) -> dict[str, Any]:
        return {"what": self.what, "range_m": round(self.range_m, 3), "power_dbw": round(self.power_dbw, 1)}


@dataclass(frozen=True)
class Expectation:
    """All verdicts of a scene, and its echoes, the strongest first."""

    verdicts: Mapping[str, Verdict]
    echoes: tuple[Echo, ...]

    @property
    def limit_db(self) -> float:
        """What may be left out of a cell, over the strongest echo [dB]."""
        first = [change for name in FIRST if (change := self.verdicts[name].change_db) is not None]
        return min(max(first) + BUDGET_DB, levels.noise_dbw() - self.echoes[0].power_dbw) if first else -math.inf

    def on(self, effect: str) -> bool:
        """Whether the frame is made with it."""
        if effect in ALWAYS:
            return True
        verdict = self.verdicts["doppler" if effect in WITH_DOPPLER else effect]
        if verdict.change_db is None:
            return False
        return verdict.more or effect in FIRST or verdict.change_db > self.limit_db

    def to_json(self, shows: str) -> dict[str, Any]:
        changes = {effect: self.verdicts[effect].change_db for effect in RULES}
        return {
            "shows": shows,
            "effects": [effect for effect in RULES if self.on(effect)],
            "limit_db": None if math.isinf(self.limit_db) else round(self.limit_db, 1),
            "reasons": {
                effect: {
                    "change_db": None if (change := changes[effect]) is None else round(change, 1) + 0.0,
                    "more": self.verdicts[effect].more,
                    "reason": self.verdicts[effect].reason,
                }
                for effect in RULES
            },
            "echoes": [echo.to_json() for echo in self.echoes],
        }


def nothing(reason: str) -> Verdict:
    return Verdict(None, reason)


def everything(reason: str) -> Verdict:
    """Without it the scene's strongest cell is gone."""
    return Verdict(0.0, reason)


ABSENT = {
    "specular": nothing("no face has a point whose normal leads to the radar"),
    "diffuse": nothing("there is no surface, only a point target"),
    "multi_bounce": nothing("there is no second surface within sight of the first"),
    "refraction": nothing("there is no pane: what stands here swallows the wave or is no surface"),
    "diffraction": nothing("no edge has a point in which the line of sight meets it at a right angle"),
    "corners": nothing("no two faces that meet at a right angle both look at the radar"),
    "rcs_targets": nothing("no prim has radar:rcs_dbsm"),
}


def motion(speed_mps: float) -> dict[str, Verdict]:
    """Doppler, migration and motion within the chirp at a radial speed [m/s]."""
    if speed_mps == 0.0:
        still = "nothing moves, neither the radar nor anything else"
        return {name: nothing(still) for name in ("doppler", "range_migration", "intra_chirp_motion")}
    waveform = levels.RADAR.waveform
    return {
        "doppler": Verdict(
            levels.doppler_change_db(speed_mps),
            f"{speed_mps:g} m/s are {speed_mps / waveform.velocity_step_mps:.2f} Doppler bins",
        ),
        "range_migration": Verdict(
            levels.migration_change_db(speed_mps),
            f"v T = {speed_mps:g} m/s x {1e3 * levels.FRAME_S:.1f} ms is "
            f"{speed_mps * levels.FRAME_S / waveform.range_step_m:.3f} range bins",
        ),
        "intra_chirp_motion": Verdict(
            levels.intra_chirp_change_db(speed_mps),
            f"the Doppler shift moves the echo by 2 v T_c / lambda = "
            f"{2.0 * speed_mps * waveform.chirp_duration_s / levels.WAVELENGTH_M:.3f} range bins",
        ),
    }


def near_field(range_m: float, mirror: bool = False) -> Verdict:
    kind = "mirror image" if mirror else "point"
    return Verdict(
        levels.near_field_change_db(range_m, mirror), f"the wavefront of a {kind} at {range_m:g} m, over 94 mm"
    )


def noise(peak_dbw: float) -> Verdict:
    noise = levels.noise_dbw()
    return Verdict(
        0.0, f"noise of {noise:.1f} dBW fills the range bins beside the echoes (the strongest is {peak_dbw:.1f} dBW)"
    )


def boresight(what: str = "the echo stands", azimuth_deg: float = 2.0) -> Verdict:
    return Verdict(levels.pattern_change_db(azimuth_deg, 0.0), f"{what} within {azimuth_deg:g} deg of boresight")
