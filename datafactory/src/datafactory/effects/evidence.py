"""The evidence for a plan: a few frames traced with every effect, and what each effect contributes to them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from datafactory.effects import changes
from datafactory.effects.catalogue import NAMES
from datafactory.frame.chain import ChainSettings, SceneSource, illuminated
from datafactory.frame.deal import DealtFrame
from datafactory.frame.prepared import PreparedScene, Sample
from datafactory.paths.density import cell_power
from datafactory.paths.edges import edges_of
from datafactory.paths.merged_scene import slabs_of
from datafactory.paths.panes import slab_transmission
from datafactory.paths.table import DIFFRACTED, DIFFUSE, REFRACTED, SPECULAR, TARGET, PathTable
from shared.physics.units import amplitude_to_db, power_to_db
from shared.radar import Radar
from shared.signal.windows import cell_noise_power

EVIDENCE_RAYS = 400_000
"""With half of them a surface at 80 m has one to four in a resolution cell, and the plan of one scene of
``scenes/effects`` hung on the seed (2 of 8 said otherwise; now none)."""
EVIDENCE_DEPTH = 3
PANE_DB = -60.0
"""Two-way transmission below which a surface counts as opaque: 30 dB under the default error budget."""
FLOOR_DB = -200.0
"""Stands for "nothing" where a level is asked for."""
PATH_BLOCK = 20_000
"""Paths whose plane-wave errors are held in memory at a time."""

Real = NDArray[np.float64]


@dataclass(frozen=True)
class Evidence:
    """What one effect contributes.

    :param change_db: largest over the poses: of the response in a resolution cell over the frame's peak; FLOOR_DB where
        the scene or the radar lacks what the effect works on
    :param text: where the figure comes from, in words
    :param power_share: of all power in the frames that the effect changes, mean over the poses
    :param cell_share: of the occupied cells that it changes by more than half a decibel, mean over the poses
    """

    change_db: float
    text: str
    power_share: float = 0.0
    cell_share: float = 0.0


class Gathered(BaseModel):
    """Evidence for every effect, by name: what is kept in the user's cache."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    evidence: dict[str, Evidence]


def gather(sample: Sample, radar: Radar, settings: ChainSettings) -> Gathered:
    """Evidence for every effect; deterministic.

    :param sample: frames of the run, one trace each
    :param settings: of the run; number and depth of the rays are the evidence's own
    """
    if not sample.frames:
        return Gathered(evidence=dict.fromkeys(NAMES, Evidence(FLOOR_DB, "no frame of the run stands in this scene")))
    panes = _has_panes(sample.scene, radar)
    tables = [_lit_paths(sample.scene, frame, radar, settings, panes) for frame in sample.frames]
    structural = _structural(sample.scene, tables, radar, panes)
    rates = [changes.radial_mps(table) for table in tables]
    waveform = radar.waveform

    def of_kind(kind: int) -> Callable[[int, PathTable], Real]:
        return lambda index, table: (_kinds(table) & kind > 0).astype(np.float64)

    measures: dict[str, Callable[[int, PathTable], Real]] = {
        "specular": of_kind(SPECULAR),
        "diffuse": of_kind(DIFFUSE),
        "multi_bounce": lambda index, table: _bounces_more_than_once(table).astype(np.float64),
        "refraction": of_kind(REFRACTED),
        "diffraction": of_kind(DIFFRACTED),
        "doppler": lambda index, table: changes.doppler_change(rates[index], waveform) ** 2,
        "range_migration": lambda index, table: changes.migration_change(rates[index], waveform) ** 2,
        "intra_chirp_motion": lambda index, table: changes.intra_chirp_change(rates[index], waveform) ** 2,
        "near_field": lambda index, table: _plane_wave_change(table, radar) ** 2,
        "antenna_pattern": lambda index, table: changes.pattern_change(table, radar) ** 2,
        "rcs_targets": of_kind(TARGET),
    }
    window = settings.processing.truth_window
    evidence = {
        name: structural.get(name) or _measured(tables, measure, radar, window) for name, measure in measures.items()
    }
    return Gathered(evidence={**evidence, "noise": _noise(tables, radar, window)})


def _lit_paths(
    scene: PreparedScene, frame: DealtFrame, radar: Radar, settings: ChainSettings, panes: bool
) -> PathTable:
    """Illuminated paths of one frame with every effect that the scene has something for."""
    everything = replace(
        settings.trace, rays=EVIDENCE_RAYS, depth=EVIDENCE_DEPTH, specular=True, diffuse=True, refraction=panes,
        diffraction=True, point_targets=True,
    )  # fmt: skip
    settings = replace(settings, trace=everything, antenna_pattern=True)
    return illuminated(SceneSource(frame, scene, settings).traced(radar), settings, radar)


def _structural(scene: PreparedScene, tables: Sequence[PathTable], radar: Radar, panes: bool) -> dict[str, Evidence]:
    """Effects that need no measuring: the scene or the radar lacks what they work on."""
    found = {}
    if not scene.merged.meshes:
        for name in ("specular", "diffuse", "multi_bounce"):
            found[name] = Evidence(FLOOR_DB, "there is no surface")
    if not panes:
        found["refraction"] = Evidence(FLOOR_DB, "no material lets a wave through")
    if not scene.merged.meshes or not len(edges_of(scene.merged)):
        found["diffraction"] = Evidence(FLOOR_DB, "there is no edge")
    if not any(table.moves() for table in tables):
        for name in ("doppler", "range_migration", "intra_chirp_motion"):
            found[name] = Evidence(FLOOR_DB, "nothing moves, neither the radar nor anything that it sees")
    if radar.waveform.chirps == 1:
        for name in ("doppler", "range_migration"):
            found[name] = Evidence(FLOOR_DB, "the frame has one chirp")
    if not scene.merged.targets:
        found["rcs_targets"] = Evidence(FLOOR_DB, "the scene has no target with a radar cross section")
    front_end = radar.front_end
    if front_end.tx_pattern.kind == front_end.rx_pattern.kind == "isotropic":
        found["antenna_pattern"] = Evidence(FLOOR_DB, "the radar's elements are isotropic")
    return found


def _has_panes(scene: PreparedScene, radar: Radar) -> bool:
    """Whether any surface lets more through, out and back, than counts as nothing."""
    frequency_hz = radar.waveform.mid_sweep_hz
    for slab in set(slabs_of(scene.merged, scene.materials)):
        te, _ = slab_transmission(
            slab.relative_permittivity, slab.conductivity_s_per_m, slab.thickness_m, frequency_hz, np.ones(1)
        )
        if amplitude_to_db(te[0] ** 2) > PANE_DB:
            return True
    return False


def _measured(
    tables: Sequence[PathTable], measure: Callable[[int, PathTable], Real], radar: Radar, truth_window: str
) -> Evidence:
    """From each path's share of its own power that the effect changes."""
    floor = cell_noise_power(radar) / radar.array.channels
    worst, powers, cells = 0.0, [], []
    for index, table in enumerate(tables):
        total = cell_power(table, radar, truth_window)
        changed = cell_power(table, radar, truth_window, measure(index, table))
        peak = float(total.max(initial=0.0))
        if peak <= 0.0:
            continue
        worst = max(worst, float(changed.max()) / peak)
        occupied = total > floor
        powers.append(min(float(changed.sum() / total.sum()), 1.0))
        cells.append(float(np.mean(changed[occupied] > 0.12 * total[occupied])) if occupied.any() else 0.0)
    power, cell = (float(np.mean(values)) if values else 0.0 for values in (powers, cells))
    text = f"changes {100.0 * power:.3g} % of the power and {100.0 * cell:.3g} % of the occupied cells"
    return Evidence(float(power_to_db(min(worst, 1.0), FLOOR_DB)), text, power, cell)


def _noise(tables: Sequence[PathTable], radar: Radar, truth_window: str) -> Evidence:
    """Noise over the weakest range bin's echo: a bin without one holds nothing else."""
    noise = cell_noise_power(radar)
    shares = [float(np.mean(cell_power(table, radar, truth_window).max(axis=1) < 1e3 * noise)) for table in tables]
    share = float(np.mean(shares))
    text = f"{100.0 * share:.0f} % of the range bins have no echo 30 dB above it"
    return Evidence(0.0 if share > 0.0 else -30.0, text, cell_share=share)


def _plane_wave_change(table: PathTable, radar: Radar) -> Real:
    wavelength = radar.waveform.wavelength_m
    everyone, nobody = np.arange(len(table.scattered)), np.zeros(0, dtype=np.int64)
    parts = []
    for first in range(0, len(everyone), PATH_BLOCK):
        block = table.scattered.take(everyone[first : first + PATH_BLOCK])
        part = replace(table, scattered=block, specular=table.specular.take(nobody))
        parts.append(changes.plane_wave_change(part, radar.array, wavelength))
    mirrors = replace(table, scattered=table.scattered.take(nobody))
    return np.concatenate([*parts, changes.plane_wave_change(mirrors, radar.array, wavelength)])


def _kinds(table: PathTable) -> NDArray[np.uint8]:
    return np.concatenate([table.scattered.kinds, table.specular.kinds])


def _bounces_more_than_once(table: PathTable) -> NDArray[np.bool_]:
    """[K] whether a path has two or more bounces; diffraction at an edge does not count as one."""
    depth = np.concatenate([table.scattered.depth, table.specular.depth])
    return (depth > 1) & (_kinds(table) & DIFFRACTED == 0)
