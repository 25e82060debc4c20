"""Other people's simulators on the same paths: Sionna's channel frequency response, mmWrt's point targets."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from record import RELATIVE_L2, NotInstalledError, Record, relative_l2, timed
from workloads import EGO_SPEED_MPS, SEED, Workload

from datafactory.paths.backend import select_variant, set_threads
from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.cube import cube_of_paths
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.radar.waveform import Waveform

SINGLE = AntennaArray(tx_m=((0.0, 0.0, 0.0),), rx_m=((0.0, 0.0, 0.0),))
MMWRT_SAMPLES = 512
"""mmWrt refuses 1024."""


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


def points_vs_mmwrt(work: Workload) -> Record:
    """Point targets against mmWrt: one chirp, one TX, 16 RX, residual video phase, the same speed of light.

    :raises NotInstalledError: mmWrt is no dependency of this project
    """
    try:
        Raytracing, Scene = (importlib.import_module(f"mmWrt.{name}") for name in ("Raytracing", "Scene"))
    except ImportError as error:
        raise NotInstalledError(f"mmWrt cannot be imported ({error}): pip install mmwrt") from None
    waveform = Waveform(samples=MMWRT_SAMPLES, range_bins=MMWRT_SAMPLES, chirps=1, residual_video_phase=True)
    full = Radar().array
    array = AntennaArray(tx_m=full.tx_m[:1], rx_m=full.rx_m)
    generator = np.random.default_rng(SEED)
    count = work.size.peer_targets
    range_m, u = generator.uniform(3.0, 60.0, count), generator.uniform(-0.8, 0.8, count)
    points = range_m[:, None] * np.stack([np.sqrt(1.0 - u**2), u, np.zeros(count)], axis=1)
    rx_antennas = tuple(Scene.Antenna(x=x, y=y, z=z) for x, y, z in array.rx_m)
    tx_antennas = [Scene.Antenna(x=x, y=y, z=z) for x, y, z in array.tx_m]
    receiver = Scene.Receiver(
        adc_sample_rate=waveform.sample_rate_hz, antennas=rx_antennas, adc_sample_count=MMWRT_SAMPLES
    )
    transmitter = Scene.Transmitter(
        chirp_start_freq=waveform.carrier_hz, chirp_slope=waveform.slope_hz_per_s, antennas=tx_antennas,
        chirp_end_time=1.001 * waveform.chirp_duration_s, chirp_period=1.001 * waveform.chirp_duration_s,
    )  # fmt: skip
    peer = Scene.Radar(transmitter, receiver, medium=Scene.Medium(v=SPEED_OF_LIGHT, name="exact"))
    scatterers = [Scene.Scatterer(x=x, y=y, z=z) for x, y, z in points.tolist()]

    def trace():
        return Raytracing.rt_points([peer], scatterers, peer, datatype=np.complex128)["adc_cube"]

    trace()
    peer_time, peer_cube = timed(trace, 3)
    radar = Radar(waveform=waveform, array=array)
    table = PathTable(ScatteredPaths.of_points(points, np.zeros((count, 3)), np.ones(count, dtype=np.complex128)))
    cube_of_paths(table, radar)
    elapsed, cube = timed(lambda: cube_of_paths(table, radar), max(work.size.repeats, 3))
    # mmWrt has no echo before the wave is back: leave those samples out.
    first = int(np.ceil(2.0 * 60.5 / SPEED_OF_LIGHT * waveform.sample_rate_hz))
    return Record(
        name="points_vs_mmwrt",
        ours=f"cube_of_paths, {count} targets x {array.channels} channels x {MMWRT_SAMPLES} samples, 1 thread",
        ours_time=elapsed,
        reference="mmWrt rt_points, complex128, the same targets and channels; NumPy",
        reference_time=peer_time,
        error=relative_l2(cube[0, first:], peer_cube.reshape(-1, MMWRT_SAMPLES).T[first:]),
        error_unit=RELATIVE_L2,
    )
