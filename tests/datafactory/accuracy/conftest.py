"""A small radar, frames of a tiny scene, and one price list that the command has made of it."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from factory_command import run
from matplotlib.figure import Figure
from prepared_scenes import TINY
from sampled_frames import MENU, POSE, order_of_two, samples_of

from datafactory.accuracy import report, study
from datafactory.accuracy.knobs import Effort, Sample
from datafactory.accuracy.study import Row
from shared.radar import Radar, load_radar

RADAR = """
name = "small"
[waveform]
samples = 512
chirps = 8
range_bins = 96
[grid]
bins = 48
"""
"""All 256 elements, because the range walk is over them, and no echo that folds; short in everything else."""
TRIED = replace(
    MENU, rays=(500, 4000), tolerance=(1e-3, 1e-6, 1e-9), effort=Effort(20_000, realisations=2), usual_rays=4000
)


@pytest.fixture(scope="session")
def radar_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("radar") / "small.toml"
    path.write_text(RADAR, encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def radar(radar_file: Path) -> Radar:
    return load_radar(str(radar_file))


@pytest.fixture(scope="session")
def samples(variant: str, radar: Radar) -> list[Sample]:
    return samples_of(replace(order_of_two(radar), poses=(POSE,)))


@dataclass(frozen=True)
class PriceList:
    """What the command printed, its folder, and the rows that it drew."""

    said: str
    folder: Path
    rows: list[Row]


@pytest.fixture(scope="session")
def prices(variant: str, radar_file: Path, tmp_path_factory: pytest.TempPathFactory) -> PriceList:
    """``datafactory accuracy --quick`` with a smaller menu."""
    folder = tmp_path_factory.mktemp("prices")
    poses, drawn, draw = folder / "poses.json", list[Row](), report.draw
    poses.write_text(json.dumps([{"position": POSE.position, "yaw_deg": 5.0, "velocity": POSE.velocity}]))

    def kept(rows: Sequence[Row], title: str) -> Figure:
        drawn.extend(rows)
        return draw(rows, title)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "QUICK", TRIED)
        patch.setattr(report, "draw", kept)
        said = run("accuracy", "--scene", TINY, "--poses", poses, "--radar", radar_file, "--quick", "--repeats", 2,
                   "--out", folder)  # fmt: skip
    return PriceList(said, folder, drawn)
