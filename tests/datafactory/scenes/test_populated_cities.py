"""A procedural city has room for what ``--populate`` puts in, whatever its style."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from datafactory.api.asking import load_scene
from datafactory.cli.app import app
from datafactory.scenes.city.rules import Style

ASKED = "cars=20,trucks=2,pedestrians=10,cyclists=4,poles=30,signs=10,parked=0.6"


@pytest.mark.parametrize("style", list(Style))
def test_a_city_is_populated(tmp_path: Path, style: Style) -> None:
    path = tmp_path / "city.usda"
    done = CliRunner().invoke(app, ["city", "--seed", "1", "--style", style.value, "--out", str(path)])
    assert done.exit_code == 0, done.output
    population = load_scene(str(path), populate=ASKED, seed=1).population
    assert population is not None
    placed = population.to_json()["placed"]
    assert placed["cars"] + placed["trucks"] >= 2
    assert (placed["poles"], placed["pedestrians"], placed["cyclists"]) == (30, 10, 4)
