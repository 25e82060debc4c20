"""Whether a plan keeps its promise: a frame as planned beside the same frame with every effect."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.effects.catalogue import ALL, EffectSet
from datafactory.effects.evidence import FLOOR_DB, Probe
from datafactory.frame.chain import Processing
from datafactory.paths.density import cell_power
from datafactory.paths.rays import RayFan
from datafactory.paths.table import PathTable
from datafactory.paths.trace import trace
from datafactory.synthesis.cube import cube_of_paths
from datafactory.synthesis.truth import truth_moments
from datafactory.synthesis.wave_model import WaveModel
from shared.physics.units import amplitude_to_db, power_to_db
from shared.signal.imaging import delay_and_sum, near_field_images
from shared.signal.spectrum import range_doppler


@dataclass(frozen=True)
class Proof:
    """Differences between a plan's frame and the frame of every effect, over the latter's peaks [dB].

    :param power_db: of the power in the truth's resolution cells, as paths (each set traced by itself)
    :param input_db, truth_db: of the input's beamformed image and of the truth image, on the paths of every effect
    :param planned_seconds, all_seconds: of the whole frame on one core
    """

    power_db: float
    input_db: float
    truth_db: float
    planned_seconds: float
    all_seconds: float

    @property
    def worst_db(self) -> float:
        return max(self.power_db, self.input_db, self.truth_db)


def prove(probe: Probe, effects: EffectSet, pose: int = 0) -> Proof:
    """Simulate one of the probe's poses both ways, without noise: it is the same in both.

    Rows of both images lie in the Doppler cells that the frame of every effect chooses: where two peaks of a range bin
    are alike, the choice itself would hang on less than the budget.
    """
    every_path = _paths(probe, ALL, pose)
    expected, cells = _images(probe, ALL, every_path)  # compiles what is to be compiled
    started = time.perf_counter()
    planned_paths = _paths(probe, effects, pose)
    _images(probe, effects, planned_paths)
    middle = time.perf_counter()
    _images(probe, ALL, _paths(probe, ALL, pose))
    finished = time.perf_counter()
    got, _ = _images(probe, effects, _illuminated(probe, effects, _traced(probe, ALL, pose)), cells)
    power, reference = (cell_power(paths, probe.radar) for paths in (planned_paths, every_path))
    ratio = float(np.abs(power - reference).max() / max(reference.max(), 1e-300))
    return Proof(
        power_db=float(power_to_db(ratio, FLOOR_DB)),
        input_db=_difference_db(got[0], expected[0]),
        truth_db=_difference_db(got[1], expected[1]),
        planned_seconds=middle - started,
        all_seconds=finished - middle,
    )


def _traced(probe: Probe, effects: EffectSet, pose: int) -> PathTable:
    settings = effects.trace(probe.settings)
    fan = RayFan(settings.rays)
    frequency_hz = probe.radar.waveform.mid_sweep_hz
    return trace(probe.stage, probe.materials, probe.poses[pose], frequency_hz, settings, fan, probe.seed)


def _illuminated(probe: Probe, effects: EffectSet, table: PathTable) -> PathTable:
    return table.within(probe.radar).illuminated(effects.front_end(probe.radar.front_end))


def _paths(probe: Probe, effects: EffectSet, pose: int) -> PathTable:
    return _illuminated(probe, effects, _traced(probe, effects, pose))


def _images(
    probe: Probe, effects: EffectSet, paths: PathTable, cells: NDArray[np.int64] | None = None
) -> tuple[tuple[NDArray, NDArray], NDArray[np.int64]]:
    """[R, U] magnitudes of the input beamformed and of the truth, both in sqrt(W), and their Doppler cells [R].

    :param cells: those to use; the strongest of every range bin otherwise
    """
    radar, processing = probe.radar, effects.processing(Processing())
    if not processing.doppler:
        paths = paths.at_rest(radar.waveform.mid_frame_s)
    model = WaveModel(processing.range_migration, processing.intra_chirp_motion, processing.near_field)
    cube = cube_of_paths(paths, radar, processing.tolerance, model=model).astype(np.complex64, copy=False)
    spectra = range_doppler(cube, radar)
    if cells is None:
        cells = np.abs(spectra).mean(axis=-1).argmax(axis=1)
    measured = delay_and_sum(spectra[np.arange(len(cells)), cells], radar)
    moments = truth_moments(paths, radar, cells, processing.truth_terms, model)
    (truth,) = near_field_images(moments[None], radar, radar.virtual_sensor)
    return (np.abs(measured), np.abs(truth)), cells


def _difference_db(got: NDArray, expected: NDArray) -> float:
    peak = float(expected.max(initial=0.0))
    return float(amplitude_to_db(np.abs(got - expected).max() / peak, FLOOR_DB)) if peak > 0.0 else FLOOR_DB
