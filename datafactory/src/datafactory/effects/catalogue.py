"""The effects that a frame may need, by name, and what switching one off means."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

from datafactory.frame.chain import ChainSettings
from shared.physics.errors import InputError, meant

AUTO = "auto"
DESCRIPTIONS = {
    "specular": "mirrors",
    "diffuse": "rough surfaces",
    "multi_bounce": "more than one bounce, and targets over mirrors; off: single bounces alone",
    "refraction": "waves through panes; off: panes are opaque",
    "diffraction": "echoes of edges, and targets seen round them",
    "corners": "right-angled corners, seen by a bounce on either face",
    "doppler": "motion; off: the scene stands still as it is at mid-frame, and one chirp is simulated",
    "range_migration": "echoes that cross range bins within the frame; comes with Doppler",
    "intra_chirp_motion": "motion within a chirp; comes with Doppler",
    "near_field": "spherical waves over the input array; always there",
    "antenna_pattern": "gain by direction; off: the gain of boresight everywhere",
    "rcs_targets": "targets given by a radar cross section",
    "noise": "receiver noise",
}
"""What each effect stands for, in words, in the order of the chain."""
SIGNAL_EFFECTS = ("doppler", "range_migration", "intra_chirp_motion", "near_field", "antenna_pattern", "noise")
"""Those that work on the paths that there are."""
PATH_EFFECTS = tuple(name for name in DESCRIPTIONS if name not in SIGNAL_EFFECTS)
"""Those that decide which paths there are."""
NO_CHOICE = ("range_migration", "intra_chirp_motion", "near_field")
"""Simulated always, the first two wherever there is Doppler: leaving them out was measured to save nothing."""


@dataclass(frozen=True)
class EffectSet:
    """Which effects are simulated.

    :param names: some of ``DESCRIPTIONS``, in their order
    """

    names: tuple[str, ...] = tuple(DESCRIPTIONS)

    @staticmethod
    def of(names: Collection[str]) -> EffectSet:
        return EffectSet(tuple(name for name in DESCRIPTIONS if name in names))

    def without(self, name: str) -> EffectSet:
        return EffectSet.of({*self.names} - {name})

    def settings(self, settings: ChainSettings) -> ChainSettings:
        """Settings of the chain that simulate no more than these effects."""
        trace, on = settings.trace, {name: name in self.names for name in DESCRIPTIONS}
        # Close-target frames stay with eq. (1): motion within the chirp is a scene's.
        processing = replace(
            settings.processing,
            doppler=on["doppler"],
            intra_chirp_motion=True,
            noise=settings.processing.noise and on["noise"],
        )
        return replace(
            settings,
            trace=replace(
                trace,
                depth=trace.depth if on["multi_bounce"] else 1,
                specular=trace.specular and on["specular"],
                diffuse=trace.diffuse and on["diffuse"],
                refraction=on["refraction"],
                diffraction=on["diffraction"],
                corners=on["corners"],
                point_targets=on["rcs_targets"],
            ),
            processing=processing,
            antenna_pattern=settings.antenna_pattern and on["antenna_pattern"],
        )


ALL = EffectSet()
NAMES = ALL.names


def parse_effects(text: str) -> EffectSet | None:
    """``--effects``: None for ``auto``, everything for ``all``, else a list of names separated by commas.

    :raises InputError: a name that does not exist, ``auto`` or ``all`` beside others
    """
    names = [name.strip() for name in text.split(",") if name.strip()]
    if names in ([AUTO], ["all"]):
        return None if names == [AUTO] else ALL
    for name in names:
        if name in (AUTO, "all"):
            raise InputError("--effects", f"{name!r} beside other names", f"{name} alone, or names without it")
        if name not in NAMES:
            expected = f"auto, all, or some of {','.join(NAMES)}{meant(name, (AUTO, 'all', *NAMES))}"
            raise InputError("--effects", repr(name), expected)
    if not names:
        raise InputError("--effects", repr(text), f"auto, all, or some of {','.join(NAMES)}")
    return EffectSet.of(names)
