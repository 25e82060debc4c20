"""What a radar would not notice: the limit of a frame, and the candidates that stay below it (docs/notes/planning.md).

What is left out of a resolution cell of the truth has, all of it together, at most the power

    P_limit = min(b P_peak, N):

b is the error budget, P_peak the power in the frame's own strongest cell of first hits and single mirrors, as far as
the truth's image shows it, and N the receiver's noise in a range-Doppler cell of a channel, the dataset's
``noise_power``. Without noise the budget counts alone. Powers are summed without phase (:mod:`.cells`). In every cell
candidates are left out from the weakest on, as long as the sum of their bounds stays below the limit. A group
(:data:`.candidates.GROUPS`) goes only where every part of it may. Point targets in plain sight are not left out: they
are listed.

The decision is a function of the frame's paths and candidates, the radar and the budget: the same before anything is
tested for visibility and afterwards, from stored paths.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datafactory.paths.candidates import GROUPS, Candidates
from datafactory.paths.cells import cell_numbers, cell_power, share_on_grid
from datafactory.paths.table import DIFFUSE, SPECULAR, PathTable, ScatteredPaths, SpecularPaths, amplitude_gain
from shared.physics.compiled import compiled
from shared.physics.units import db_to_power
from shared.physics.vectors import Mask, Real
from shared.processes.defaults import TRUTH_WINDOW
from shared.radar import FrontEnd, Radar
from shared.signal.windows import cell_noise_power

FEW = 1000
"""So many of the strongest first echoes, and as many spread over all, are looked at before cells are summed."""


@dataclass(frozen=True)
class Notice:
    """What decides over a frame beside its paths.

    :param budget_db: what leaving effects out may change [dB of the strongest cell's power]
    :param below_noise: whether what is left out has to be below the receiver's noise as well; without noise it has not
    :param antenna_pattern: whether the elements' gain depends on direction
    :param truth_window: over the virtual sensor's elements, which sets the width of a cell
    """

    radar: Radar
    budget_db: float
    below_noise: bool = True
    antenna_pattern: bool = True
    truth_window: str = TRUTH_WINDOW

    @property
    def front_end(self) -> FrontEnd:
        """As it lights the scene."""
        front_end = self.radar.front_end
        return front_end if self.antenna_pattern else front_end.with_boresight_gain()

    def limit_w(self, table: PathTable) -> float:
        """P_limit of the module [W].

        A cell has at least the power of its strongest path. Where one path is enough for the noise to be the smaller of
        both, no cell is summed.

        :param table: as traced at the radar's wavelength, of which the :func:`first_echoes` count
        """
        budget, noise = float(db_to_power(self.budget_db)), cell_noise_power(self.radar)
        if self.below_noise:
            few = strongest(table).within(self.radar).illuminated(self.front_end)
            power = self._shown(few) * np.abs(few.every("amplitude")) ** 2
            if budget * float(np.max(power, initial=0.0)) >= noise:
                return noise
        lit = first_echoes(table).within(self.radar).illuminated(self.front_end)
        of_budget = budget * float(cell_power(lit, self.radar, self.truth_window, self._shown(lit)).max(initial=0.0))
        return min(of_budget, noise) if self.below_noise else of_budget

    def _shown(self, paths: PathTable) -> Real:
        """[K] share of a path's power that the truth's image shows, scattered paths first.

        Of what arrives beside its grid it shows what reaches in (:func:`.cells.share_on_grid`). It is focused on
        points. A mirror at R shows the TX at 2 R: over an aperture D its phase is off by up to pi D^2 / (8 lambda R), a
        quarter of a turn at R = D^2 / (4 lambda). The echoes of nearer mirrors, the ground below the sensor among them,
        spread over as many cells as they are nearer.
        """
        aperture_m = float(np.ptp(self.radar.virtual_sensor.rx[:, 1]))
        near_m = aperture_m**2 / (4.0 * self.radar.waveform.wavelength_m)
        mirrors = np.minimum(paths.specular.range_m() / near_m, 1.0) if near_m > 0.0 else np.ones(len(paths.specular))
        focus = np.concatenate([np.ones(len(paths.scattered)), mirrors])
        return focus * share_on_grid(paths.arrival(), self.radar, self.truth_window)

    def power_w(self, candidates: Candidates) -> Real:
        """[N] the candidates' bounds as the radar lights them [W]; 0 beyond its unambiguous range."""
        departure, arrival = candidates.departure.astype(np.float64), candidates.arrival.astype(np.float64)
        gain = amplitude_gain(self.front_end, departure, arrival) ** 2
        heard = candidates.range_m < self.radar.waveform.unambiguous_range_m
        return np.where(heard, candidates.power * gain, 0.0)

    def worth(self, candidates: Candidates, limit_w: float) -> Mask:
        """[N] whether each is followed."""
        if not len(candidates):
            return np.zeros(0, dtype=bool)
        power = self.power_w(candidates)
        row, column, columns = cell_numbers(
            candidates.range_m.astype(np.float64), candidates.arrival.astype(np.float64), self.radar, self.truth_window
        )
        cell = row * columns + column
        worth = _exceeds(cell, power, np.lexsort((power, cell)), limit_w)
        for group in GROUPS:
            members = candidates.family == group
            worth[members] = worth[members].any()
        return worth


@compiled()
def _exceeds(cell, power, order, limit_w):
    """[N] whether a candidate and the weaker ones of its cell hold more than the limit together.

    A cell's sum begins anew: beside a candidate of 1 mW, a sum over all cells would round by as much as the noise.

    :param order: [N] of the candidates by cell, and in each by power
    """
    worth = np.zeros(len(cell), dtype=np.bool_)
    total, before = 0.0, -1
    for index in order:
        total = power[index] + (total if cell[index] == before else 0.0)
        before = cell[index]
        worth[index] = power[index] > 0.0 and total > limit_w
    return worth


def first_echoes(table: PathTable) -> PathTable:
    """First hits and single mirrors among a table's paths: they are in every frame, and no decision."""
    return PathTable(table.scattered.take(_is_first(table.scattered)), table.specular.take(_is_first(table.specular)))


def _is_first(paths: ScatteredPaths | SpecularPaths) -> Mask:
    return (paths.depth == 1) & ((paths.kinds == DIFFUSE) | (paths.kinds == SPECULAR))


def strongest(table: PathTable) -> PathTable:
    """Of either kind the ``FEW`` first echoes that are strongest on isotropic antennas, and as many spread over all.

    Those near the sensor are the strongest; where its antennas or its image leave them out, the others say more.
    """
    chosen = []
    for paths in (table.scattered, table.specular):
        index = np.flatnonzero(_is_first(paths))
        if len(index) > FEW:
            power = np.abs(paths.amplitude[index]) ** 2
            spread = np.arange(0, len(index), len(index) // FEW)
            index = index[np.union1d(np.argpartition(-power, FEW)[:FEW], spread)]
        chosen.append(index)
    return PathTable(table.scattered.take(chosen[0]), table.specular.take(chosen[1]))
