"""A run on the cube of another radar: docs/measured.md says what may differ.

Only the elements' positions in wavelengths enter a network's input: each of the run's needs one of the cube's at its
place but for a common shift and stretch (:func:`position_tolerance`, :data:`MOST_STRETCH`). The tables are made of the
places where the cube's really stand; the learned weights have seen the run's array alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from shared.physics.errors import InputError
from shared.radar import PRESETS, Radar
from shared.radar.arrays import AntennaArray
from trainer.data.arrays import ArrayChoice
from trainer.estimators.array import line_array
from trainer.run.folder import Run
from trainer.run.imager import Imager

ORDERED = ("paper", "covariance")
"""Features that know in which order the channels come."""
MOST_STRETCH = 0.1
"""Costs next to nothing: docs/notes/measured.md."""
STRETCHES = 81
"""Tried, in steps of 1/400: half a step moves the outermost of 24 wavelengths by 0.015."""
SAME = 1e-9
"""Range steps, relative, and positions, in wavelengths, that differ by less are the same."""


def fitted_imager(
    run: Run, imager: Imager, run_source: str, radar: Radar, source: str
) -> tuple[Imager, NDArray[np.intp], list[str]]:
    """(a run's imager for cubes of ``radar``, [C] its channels that it looks at, remarks: what is not as in training).

    :param run_source, source: of run and cube, for messages
    :raises InputError: an array without the run's elements; it names what differs and the commands that train for it
    """
    wanted = run.array.line(run.radar)
    own, there = _in_wavelengths(run.radar), _in_wavelengths(radar)
    remarks = []
    step = radar.waveform.range_step_m
    if abs(step / run.radar.waveform.range_step_m - 1.0) > SAME:
        trained = run.radar.waveform.range_step_m
        remarks.append(
            f"{source} has range bins of {step:.3g} m, the run was trained with {trained:.3g} m: exact for points, "
            "whose echoes are as many bins wide"
        )
    if radar.grid != run.radar.grid:
        remarks.append(f"imaged at the run's {run.radar.grid.bins} angles")
    if own.shape == there.shape and np.abs(own - there).max() < SAME:
        return imager, wanted, remarks
    found, misfit, stretch = matching_elements(own[wanted], there)
    tolerance = position_tolerance(run)
    ordered = run.config.features not in ORDERED or bool((np.diff(found) > 0).all())
    if len(found) < len(wanted) or misfit > tolerance or not ordered:
        if len(found) < len(wanted):
            obstacle = f"are fewer than the {len(wanted)} of {run.array.name!r}"
        elif misfit > tolerance:
            missed = f"{misfit:.2g} wavelengths of {tolerance:.2g} allowed"
            obstacle = f"miss a place of {run.array.name!r} by {missed}"
        else:
            obstacle = f"come in another order than {run.array.name!r}, which {run.config.features!r} features know"
        raise InputError(source, *_refusal(run, run_source, radar, obstacle))
    stretched = "" if abs(stretch - 1.0) < 1e-3 else f", stretched by {stretch:.3f}"
    remarks.append(
        f"{len(found)} of its {radar.array.channels} channels stand as those of {run.array.name!r} in the run"
        f"{stretched}, within {misfit:.3f} wavelengths of {tolerance:.3f} allowed"
    )
    return _imager_at(run, imager, there, found), found, remarks


def matching_elements(wanted: NDArray[np.float64], there: NDArray[np.float64]) -> tuple[NDArray[np.intp], float, float]:
    """([C] which of the elements ``there`` [N, 2], each at most once, stand as those ``wanted`` [C, 2] do but for one
    common shift and stretch, the largest distance that remains, the stretch). Of fewer than C there are N."""
    stretches = np.linspace(1.0 - MOST_STRETCH, 1.0 + MOST_STRETCH, STRETCHES)
    best, least, stretched = np.zeros(len(wanted), dtype=np.intp), np.inf, 1.0
    for stretch in stretches[np.argsort(np.abs(stretches - 1.0), kind="stable")]:
        places = stretch * wanted
        # [N, C, N]: the first element stands on each of those there in turn.
        shifted = places[None] + (there - places[0])[:, None]
        distance = np.linalg.norm(there[None, None] - shifted[:, :, None], axis=-1)
        misfits = distance.min(axis=2).max(axis=1)
        first = int(np.argmin(misfits))
        # Rounded: elements that coincide keep their order.
        taking, nearest = linear_sum_assignment((distance[first] / SAME).round())
        misfit, fine = _remaining(wanted[taking], there[nearest])
        if misfit < least - SAME:
            best, least, stretched = nearest, misfit, fine
    return best, least, stretched


def _remaining(wanted: NDArray[np.float64], found: NDArray[np.float64]) -> tuple[float, float]:
    """(the largest distance [C, 2] to [C, 2] after the shift and stretch of least squares, that stretch)."""
    centred, target = wanted - wanted.mean(axis=0), found - found.mean(axis=0)
    energy = float(np.sum(centred**2))
    stretch = float(np.sum(centred * target)) / energy if energy > 0.0 else 1.0
    stretch = float(np.clip(stretch, 1.0 - MOST_STRETCH, 1.0 + MOST_STRETCH))
    return float(np.linalg.norm(target - stretch * centred, axis=1).max()), stretch


def position_tolerance(run: Run) -> float:
    """Misfit of an element's place that is allowed [wavelengths].

    Elements stretched by a share s of their distance from the middle move an echo from u to (1 + s) u. Half a cell of
    the truth at the image's edge allows s = cell / (2 u_max), and the outermost element, half the span away, moves by
    s span / 2.
    """
    array = line_array(run.radar, run.array.line(run.radar))
    sensor = run.radar.model_copy(update={"array": run.radar.virtual_sensor})
    edge = float(np.abs(run.radar.grid.u).max())
    return 0.25 * line_array(sensor).resolution_cell / edge * float(np.ptp(array.positions_m)) / array.wavelength_m


def training_commands(radar: Radar) -> str:
    """What makes a run for a radar, and what needs none."""
    known = radar.name in PRESETS and PRESETS[radar.name]().array == radar.array
    name, told = (radar.name, "") if known else ("RADAR.toml", " (the file and the board of trainer import)")
    return (
        f"a run trained for it: datafactory points --radar {name} --out build/points{told}, then trainer fit "
        "build/points --array full --out build/run; or no run: trainer predict --method likes"
    )


def _in_wavelengths(radar: Radar) -> NDArray[np.float64]:
    """[C, 2] (y, z) of the virtual elements."""
    return radar.array.virtual[:, 1:] / radar.waveform.wavelength_m


def _imager_at(run: Run, imager: Imager, there: NDArray[np.float64], found: NDArray[np.intp]) -> Imager:
    """The imager with the same weights and the tables of elements ``there`` [N, 2] in wavelengths."""
    places = there * run.radar.waveform.wavelength_m
    array = AntennaArray(tx_m=((0.0, 0.0, 0.0),), rx_m=tuple((0.0, float(y), float(z)) for y, z in places))
    choice = ArrayChoice(name=run.array.name, rx=tuple(np.sort(found).tolist()))
    made = Imager(run.config, run.radar.model_copy(update={"array": array}), choice)
    made.network.load_state_dict(imager.network.state_dict())
    made.gain = imager.gain
    return made.eval()


def _refusal(run: Run, run_source: str, radar: Radar, obstacle: str) -> tuple[str, str]:
    """(problem, what would be right) where the radar's channels meet an obstacle."""
    differing = [
        f"{part}.{name}"
        for part, names in (("array", ("tx_m", "rx_m")), ("waveform", ("carrier_hz", "bandwidth_hz")))
        for name in names
        if getattr(getattr(radar, part), name) != getattr(getattr(run.radar, part), name)
    ]
    problem = (
        f"radar {radar.name!r} differs from {run.radar.name!r} of {run_source} in {', '.join(differing)}; its "
        f"{radar.array.channels} channels {obstacle}"
    )
    return problem, training_commands(radar)
