"""The evidence for a plan: a few frames traced with every effect, and what each effect contributes to each of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from datafactory.effects.catalogue import NAMES
from datafactory.frame import changes
from datafactory.frame.chain import ChainSettings, SceneSource, illuminated
from datafactory.frame.deal import DealtFrame
from datafactory.frame.needs import Cells, cells_of, curved_share, noisy_share
from datafactory.frame.prepared import PreparedScene, Sample
from datafactory.paths.corner_edges import corners_of
from datafactory.paths.edges import edges_of
from datafactory.paths.merged_scene import slabs_of
from datafactory.paths.slabs import lets_through
from datafactory.paths.table import CORNER, DIFFRACTED, DIFFUSE, REFRACTED, SPECULAR, TARGET, PathTable
from shared.physics.units import power_to_db
from shared.radar import Radar

EVIDENCE_RAYS = 400_000
"""With half of them a surface at 80 m has one to four in a resolution cell, and the plan of one scene of
``scenes/effects`` hung on the seed (2 of 8 said otherwise; now none)."""
EVIDENCE_PATHS_A_CELL = 3
"""Of the default's rays, which is six of the evidence's. Evidence is shares of the power, and thinning keeps a cell's
power exactly: what more paths would bring is work."""
EVIDENCE_DEPTH = 3
FLOOR_DB = -200.0
"""Stands for "nothing" where a level is asked for."""

NO_FRAME = "no frame of the run stands in this scene"

Real = NDArray[np.float64]


@dataclass(frozen=True)
class Evidence:
    """What one effect contributes to a frame, or to several.

    :param change_db: of the response in a resolution cell over the frame's peak, the largest over the frames; FLOOR_DB
        where the scene or the radar lacks what the effect works on
    :param text: where the figure comes from, in words
    :param power_share: of all power in the frames that the effect changes, mean over the frames
    :param cell_share: of the occupied cells that it changes by more than half a decibel, mean over the frames
    """

    change_db: float
    text: str
    power_share: float = 0.0
    cell_share: float = 0.0


class Gathered(BaseModel):
    """Evidence for every effect, by name, of every frame that was looked at: what is kept in the user's cache.

    :param absent: effects that scene or radar have nothing for, wherever the radar stands, and why
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    absent: dict[str, str]
    frames: tuple[dict[str, Evidence], ...]

    @property
    def evidence(self) -> dict[str, Evidence]:
        """Of all frames together."""
        if not self.frames:
            return dict.fromkeys(NAMES, Evidence(FLOOR_DB, NO_FRAME))
        found = {name: _together([frame[name] for frame in self.frames]) for name in NAMES}
        return {**found, "noise": _noise(found["noise"].cell_share)}


def gather(
    sample: Sample, radar: Radar, settings: ChainSettings, advance: Callable[[], None] = lambda: None
) -> Gathered:
    """Evidence for every effect; deterministic.

    :param sample: frames of the run, one trace each
    :param settings: of the run; number and depth of the rays are the evidence's own
    :param advance: called after each frame
    """
    panes = _has_panes(sample.scene, radar)
    absent = _absent(sample.scene, radar, panes)
    frames = []
    for frame in sample.frames:
        table = _lit_paths(sample.scene, frame, radar, settings, panes)
        frames.append(_of_frame(table, radar, settings.processing.truth_window, absent))
        advance()
    return Gathered(absent=absent, frames=tuple(frames))


def _of_frame(table: PathTable, radar: Radar, truth_window: str, absent: Mapping[str, str]) -> dict[str, Evidence]:
    """Evidence of one frame's illuminated paths."""
    waveform, kinds = radar.waveform, _kinds(table)
    cells, rates = cells_of(table, radar, truth_window), changes.range_rates_mps(table, waveform)

    def of_kind(kind: int) -> Callable[[], Real]:
        return lambda: (kinds & kind > 0).astype(np.float64)

    shares: dict[str, Callable[[], Real]] = {
        "specular": of_kind(SPECULAR),
        "diffuse": of_kind(DIFFUSE),
        "multi_bounce": lambda: _bounces_more_than_once(table).astype(np.float64),
        "refraction": of_kind(REFRACTED),
        "diffraction": of_kind(DIFFRACTED),
        "corners": of_kind(CORNER),
        "doppler": lambda: changes.doppler_change(rates, waveform) ** 2,
        "range_migration": lambda: changes.migration_change(rates, waveform) ** 2,
        "intra_chirp_motion": lambda: changes.intra_chirp_change(rates, waveform) ** 2,
        "near_field": lambda: curved_share(table, cells, radar),
        "antenna_pattern": lambda: changes.pattern_change(table, radar) ** 2,
        "rcs_targets": of_kind(TARGET),
    }
    nothing = dict(absent)
    if not table.moves():
        still = "nothing moves, neither the radar nor anything that it sees"
        nothing = {"doppler": still, "range_migration": still, "intra_chirp_motion": still, **nothing}
    evidence = {
        name: Evidence(FLOOR_DB, nothing[name]) if name in nothing else _measured(cells, cells.where.sums(share()))
        for name, share in shares.items()
    }
    return {**evidence, "noise": _noise(noisy_share(cells, radar))}


def _lit_paths(
    scene: PreparedScene, frame: DealtFrame, radar: Radar, settings: ChainSettings, panes: bool
) -> PathTable:
    """Illuminated paths of one frame with every effect that the scene has something for."""
    everything = replace(
        settings.trace, rays=EVIDENCE_RAYS, paths_a_cell=EVIDENCE_PATHS_A_CELL, depth=EVIDENCE_DEPTH, specular=True,
        diffuse=True, refraction=panes, diffraction=True, corners=True, point_targets=True,
    )  # fmt: skip
    settings = replace(settings, trace=everything, antenna_pattern=True)
    return illuminated(SceneSource(frame, scene, settings).traced(radar), settings, radar)


def _absent(scene: PreparedScene, radar: Radar, panes: bool) -> dict[str, str]:
    """Effects that need no measuring, and why: the scene or the radar lacks what they work on."""
    found: dict[str, str] = {}
    if not scene.merged.meshes:
        found |= dict.fromkeys(("specular", "diffuse", "multi_bounce"), "there is no surface")
    if not panes:
        found["refraction"] = "no material lets a wave through"
    if not scene.merged.meshes or not len(edges_of(scene.merged)):
        found["diffraction"] = "there is no edge"
    if not scene.merged.meshes or not len(corners_of(scene.merged)):
        found["corners"] = "no two faces meet at a right angle"
    if radar.waveform.chirps == 1:
        found |= dict.fromkeys(("doppler", "range_migration"), "the frame has one chirp")
    if not scene.merged.targets:
        found["rcs_targets"] = "the scene has no target with a radar cross section"
    front_end = radar.front_end
    if front_end.tx_pattern.kind == front_end.rx_pattern.kind == "isotropic":
        found["antenna_pattern"] = "the radar's elements are isotropic"
    return found


def _has_panes(scene: PreparedScene, radar: Radar) -> bool:
    """Whether any surface lets more through, out and back, than counts as nothing."""
    frequency_hz = radar.waveform.mid_sweep_hz
    return any(lets_through(slab, frequency_hz) for slab in set(slabs_of(scene.merged, scene.materials)))


def _measured(cells: Cells, changed: Real) -> Evidence:
    """Of one frame.

    :param changed: [R, U'] power of the change in every cell [W]
    """
    if cells.peak <= 0.0:
        return Evidence(FLOOR_DB, _in_words(0.0, 0.0))
    level_db = float(power_to_db(min(float(changed.max()) / cells.peak, 1.0), FLOOR_DB))
    power, cell = min(float(changed.sum() / cells.total.sum()), 1.0), cells.changed_share(changed)
    return Evidence(level_db, _in_words(power, cell), power, cell)


def _in_words(power_share: float, cell_share: float) -> str:
    return f"changes {100.0 * power_share:.3g} % of the power and {100.0 * cell_share:.3g} % of the occupied cells"


def _noise(share: float) -> Evidence:
    """Noise over the weakest range bin's echo: a bin without one holds nothing else.

    :param share: of the range bins without an echo 30 dB above the noise
    """
    text = f"{100.0 * share:.0f} % of the range bins have no echo 30 dB above it"
    return Evidence(0.0 if share > 0.0 else -30.0, text, cell_share=share)


def _together(frames: Sequence[Evidence]) -> Evidence:
    """Of several frames: the largest change, mean shares."""
    level_db = max(each.change_db for each in frames)
    power, cell = (float(np.mean([getattr(each, name) for each in frames])) for name in ("power_share", "cell_share"))
    texts = {each.text for each in frames}
    if len(texts) == 1:
        return Evidence(level_db, texts.pop(), power, cell)
    return Evidence(level_db, _in_words(power, cell), power, cell)


def _kinds(table: PathTable) -> NDArray[np.uint8]:
    return np.concatenate([table.scattered.kinds, table.specular.kinds])


def _bounces_more_than_once(table: PathTable) -> NDArray[np.bool_]:
    """[K] whether a path has two or more bounces; diffraction at an edge does not count as one, and the bounces in a
    right-angled corner are an effect of their own.
    """
    depth = np.concatenate([table.scattered.depth, table.specular.depth])
    return (depth > 1) & (_kinds(table) & (DIFFRACTED | CORNER) == 0)
