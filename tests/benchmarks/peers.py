"""Another simulator on the same paths: Sionna's channel frequency response."""

from __future__ import annotations

from typing import Any

import numpy as np
from record import RELATIVE_L2, Record, relative_l2, timed
from workloads import EGO_SPEED_MPS, Workload

from datafactory.paths.backend import select_variant, set_threads
from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.cube import cube_of_paths
from shared.radar.arrays import AntennaArray

SINGLE = AntennaArray(tx_m=((0.0, 0.0, 0.0),), rx_m=((0.0, 0.0, 0.0),))


def _sionna_paths(work: Workload) -> Any:
    """Single bounces off the built-in street canyon, traced by Sionna at mid-sweep from a radar in the street."""
    select_variant()
    set_threads(1)
    from sionna import rt

    scene = rt.load_scene(rt.scene.simple_street_canyon)
    for material in scene.radio_materials.values():
        material.frequency_update_callback = None
        material.relative_permittivity, material.conductivity, material.scattering_coefficient = 5.24, 1.38, 0.4
    scene.frequency = work.radar.waveform.mid_sweep_hz
    scene.tx_array = scene.rx_array = rt.PlanarArray(
        num_rows=1, num_cols=1, vertical_spacing=0.5, horizontal_spacing=0.5, pattern="iso", polarization="V"
    )
    scene.add(rt.Transmitter("tx", position=[0.0, 0.0, 1.5]))
    scene.add(rt.Receiver("rx", position=[0.0, 0.0, 1.5]))
    return rt.PathSolver(deterministic=True)(
        scene, max_depth=1, samples_per_src=work.size.peer_rays, max_num_paths_per_src=work.size.peer_rays + 1000,
        los=False, specular_reflection=True, diffuse_reflection=True, refraction=False, seed=1,
    )  # fmt: skip


def _table(paths: Any, speed_mps: float) -> PathTable:
    """The solver's single bounces as a path table; amplitudes conjugated, because the IF signal has +j f_c tau."""
    valid = paths.valid.numpy().reshape(-1)
    vertices = paths.vertices.numpy().reshape(-1, 3)[valid].astype(np.float64) - [0.0, 0.0, 1.5]
    real, imaginary = (part.numpy().reshape(-1)[valid].astype(np.float64) for part in paths.a)
    velocity = np.tile([-speed_mps, 0.0, 0.0], (len(vertices), 1))
    return PathTable(ScatteredPaths.of_points(vertices, velocity, real - 1j * imaginary))


def cube_vs_sionna_cfr(work: Workload) -> Record:
    """A moving cube against ``Paths.cfr`` of the same traced paths."""
    paths, waveform = _sionna_paths(work), work.radar.waveform
    still, moving = _table(paths, 0.0), _table(paths, EGO_SPEED_MPS)
    # Relative to mid-sweep, where the paths were traced.
    offsets = waveform.bandwidth_hz * (np.arange(waveform.samples) / waveform.samples - 0.5)

    def response():
        return paths.cfr(offsets.astype(np.float32), normalize_delays=False, out_type="numpy").reshape(-1)

    response()
    cfr_time, cfr = timed(response, 3)
    cube_of_paths(moving, work.radar)
    elapsed, _ = timed(lambda: cube_of_paths(moving, work.radar), work.size.repeats)
    one_chirp = work.radar.model_copy(update={"waveform": waveform.model_copy(update={"chirps": 1})})
    single = cube_of_paths(still, one_chirp, 1e-9, array=SINGLE)[0, :, 0]
    return Record(
        name="cube_vs_sionna_cfr",
        ours=f"cube_of_paths, {len(moving)} traced paths x {work.radar.array.channels} channels x "
        f"{waveform.chirps} chirps, tolerance 1e-6, 1 thread",
        ours_time=elapsed,
        reference=f"Sionna Paths.cfr, float32, 1 channel x {waveform.samples} frequencies, "
        f"scaled to {work.channel_chirps} channel-chirps; 1 thread",
        reference_time=cfr_time.scaled(work.channel_chirps),
        error=relative_l2(single, cfr.conj()),
        error_unit=f"{RELATIVE_L2}, one channel and chirp; Sionna's phases are float32",
        details={"measured_reference_seconds": cfr_time.seconds, "paths": len(moving)},
    )
