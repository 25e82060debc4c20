"""The networks that come with the package: there, small, and worth what their card says."""

import numpy as np
import pytest
import torch

from shared.radar import load_radar
from shared.signal.windows import cell_noise_power
from trainer.data.simulation import TrialCondition, simulate
from trainer.estimators.array import line_array
from trainer.estimators.fitting import fit_lines, score_peaks
from trainer.metrics.peaks import resolved
from trainer.run.folder import load_imager
from trainer.run.pretrained import pretrained_names, pretrained_run

MOST_BYTES = 8_000_000
"""A wheel that carries them is still fetched in a second."""
NAMES = ("sparse4", "sparse6")


def test_they_are_there_with_their_card_and_small():
    assert pretrained_names() == NAMES
    folder = pretrained_run("sparse6").parent
    assert (folder / "README.md").is_file()
    assert sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) < MOST_BYTES


@pytest.mark.parametrize("name", NAMES)
def test_it_is_of_the_default_radar_and_its_array(name):
    run, imager = load_imager(pretrained_run(name))
    assert run.radar == load_radar("avr-qdm-110")
    assert run.array.name == name
    assert imager.detects


@pytest.mark.parametrize("name", NAMES)
def test_one_target_reads_its_level_at_its_place_and_is_certain(name):
    run, imager = load_imager(pretrained_run(name))
    radar, noise = run.radar, cell_noise_power(run.radar)
    trials = simulate(radar, TrialCondition(0.0, 25.0), 20, [4])
    with torch.inference_mode():
        image, probability = imager.detect(torch.from_numpy(trials.snapshots[:1]), torch.tensor([noise]))
    assert probability is not None
    rows = np.arange(len(trials.rows))
    place = np.rint((trials.u[rows, 0] - radar.grid.u[0]) / radar.grid.step).astype(int)
    seen = image[0, trials.rows].numpy()
    assert np.median(np.abs(seen.argmax(axis=1) - place)) <= 1
    level_db = 20.0 * np.log10(seen.max(axis=1) / np.sqrt(noise)) - 25.0
    assert abs(np.median(level_db)) < 1.0
    certain = probability[0, trials.rows].numpy()
    near = np.stack([certain[row, max(p - 2, 0) : p + 3].max() for row, p in zip(rows, place, strict=True)])
    assert np.median(near) > 0.5


@pytest.mark.parametrize("name", NAMES)
def test_its_lines_resolve_pairs_half_a_cell_apart(name):
    """At 20 dB maximum likelihood that is told there are two resolves 0.96 and more of them."""
    run, imager = load_imager(pretrained_run(name))
    radar, noise = run.radar, cell_noise_power(run.radar)
    channels = run.array.channels(radar)
    trials = simulate(radar, TrialCondition(0.5, 20.0), 46, [5])
    found = []
    for snapshots in trials.snapshots:
        with torch.inference_mode():
            image, probability = imager.detect(torch.from_numpy(snapshots)[None], torch.tensor([noise]))
        assert probability is not None
        score = (image * probability.sqrt())[0, trials.rows].numpy()
        line = line_array(radar, channels)
        lines = fit_lines(snapshots[trials.rows][:, channels], line, noise, score_peaks(score, radar.grid.u, 6))
        found.append(np.sort(lines.u[:, :2], axis=1))
    assert resolved(np.concatenate(found), trials.u).mean() > 0.9
