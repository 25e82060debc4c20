"""``trainer predict`` of a frame of many echoes, images alone or with points, beside OMP-CFAR of the same cells."""

import numpy as np
import torch
from numpy.typing import NDArray
from record import Record, timed
from workloads import EGO_SPEED_MPS, SEED, Workload, street

from datafactory.synthesis.cube import cube_of_paths
from shared.radar import Radar
from trainer.data.arrays import choose_array
from trainer.data.simulation import amplitude_of
from trainer.run.answers import array_answer
from trainer.run.options import PointsRequest
from trainer.run.predict import Motions, Predictor

NETWORK, ECHOES = "sparse6", 1000
SNR_DB, AT_M = 10.0, 85.0
"""In a channel's range-Doppler cell, of an echo at the far end of the street; a near one has up to 58 dB more."""


def one_frame(work: Workload, points: bool) -> Record:
    """From the samples; OMP-CFAR's image is its list."""
    torch.set_num_threads(1)
    radar = Radar(waveform=work.size.waveform)
    cube = _noisy_street(radar)
    network = Predictor.load(NETWORK, radar, PointsRequest() if points else None)
    omp = Predictor(array_answer("omp-cfar", choose_array(NETWORK, radar), radar), Motions(None, 0.0, False))
    first = network.cube(cube)  # compiled
    ours, _ = timed(lambda: network.cube(cube), work.size.repeats)
    reference, listed = timed(lambda: omp.cube(cube), work.size.repeats)
    what = "images and points" if points else "images"
    return Record(
        name=f"{what.replace(' ', '_')}_of_a_frame_vs_omp_cfar",
        ours_time=ours,
        reference="omp-cfar, the same cells and channels, 1 thread",
        reference_time=reference,
        error=0.0,
        error_unit="not compared",
        ours=f"Predictor of {NETWORK}, {what}, 1 thread",
        details={
            "points": 0 if first.points is None else len(first.points),
            "points of omp-cfar": int(np.count_nonzero(listed.image)),
            "frames a second": 1.0 / ours.seconds,
            "frames a second of omp-cfar": 1.0 / reference.seconds,
        },
    )


def _noisy_street(radar: Radar) -> NDArray[np.complexfloating]:
    """[chirp, sample, channel]"""
    cube = amplitude_of(SNR_DB, radar) * AT_M**2 * cube_of_paths(street(ECHOES, EGO_SPEED_MPS), radar, 1e-3)
    noise = np.random.default_rng(SEED).standard_normal((*cube.shape, 2), dtype=np.float32).view(np.complex64)[..., 0]
    return np.asarray(cube + np.sqrt(0.5 * radar.sample_noise_power_w) * noise)
