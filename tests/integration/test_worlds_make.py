"""The steps of ``make worlds``: each once, as many frames for every network, no unseen scene among those seen."""

from __future__ import annotations

import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="there is no make on this machine")
Command = dict[str, list[str]]
"""Arguments by option; what stands before the first option has the name ""."""


def steps(worlds: Path, **variables: str) -> list[Command]:
    """What make would do, command by command, of the project's own programs."""
    # Newer than all that the set-up depends on, so that nothing is set up; the folder is the test's own.
    installed = worlds.parent / "installed"
    installed.touch()
    given = {"WORLDS": str(worlds), "BIN": "bin", "INSTALLED": str(installed), **variables}
    settings = [f"{name}={value}" for name, value in given.items()]
    done = subprocess.run(["make", "-n", "worlds", *settings], cwd=ROOT, capture_output=True, text=True, check=True)
    lines = done.stdout.replace("\\\n", " ").splitlines()
    return [_command(shlex.split(line)) for line in lines if line.startswith("bin/")]


def _command(words: list[str]) -> Command:
    found: Command = {"": []}
    name = ""
    for word in words:
        if word.startswith("--"):
            name = word
            found.setdefault(name, [])
        else:
            found[name].append(word)
    return found


def of(kind: str, commands: list[Command]) -> list[Command]:
    return [command for command in commands if command[""][:2] == [f"bin/{kind.split()[0]}", kind.split()[1]]]


def test_each_step_stands_once_and_every_network_has_as_many_frames(tmp_path):
    commands = steps(tmp_path / "worlds")
    written = [command["--out"][0] for command in commands]
    assert len(set(written)) == len(written)
    assert len(of("datafactory city", commands)) == 8 + 3
    renders = {Path(command["--out"][0]).name: command for command in of("datafactory render", commands)}
    assert set(renders) == {f"{kind}-{city}" for kind in ("bare", "populated") for city in range(1, 9)} | {
        "bare", "populated",
    }  # fmt: skip
    fits = of("trainer fit", commands)
    assert {len(fit[""]) - 2 for fit in fits} == {1, 2, 4, 8}
    assert len(fits) == 8
    for fit in fits:
        datasets, frames = [Path(name).name for name in fit[""][2:]], int(fit["--frames"][0])
        assert len(datasets) * frames == 64
        assert [name.partition("-")[2] for name in datasets] == [str(city + 1) for city in range(len(datasets))]
        assert {name.partition("-")[0] for name in datasets} == {Path(fit["--out"][0]).name.partition("-")[0]}
        assert all(int(renders[name]["--frames"][0]) >= frames for name in datasets)
        # One frame of eight validates, in any of them.
        assert all(renders[name]["--split"] == ["7:1:0"] for name in datasets)
        assert frames % 8 == 0
    assert len({(fit["--steps"][0], fit["--seed"][0]) for fit in fits}) == 1


def test_no_city_has_more_frames_than_a_network_looks_at(tmp_path):
    commands = steps(tmp_path / "worlds")
    looked_at: dict[str, int] = {}
    for fit in of("trainer fit", commands):
        for dataset in fit[""][2:]:
            looked_at[dataset] = max(looked_at.get(dataset, 0), int(fit["--frames"][0]))
    rendered = {command["--out"][0]: int(command["--frames"][0]) for command in of("datafactory render", commands)}
    assert looked_at == {out: frames for out, frames in rendered.items() if out in looked_at}


def test_what_is_tested_was_not_trained_on_and_both_kinds_meet_the_same_networks(tmp_path):
    commands = steps(tmp_path / "worlds")
    tested = [command for command in of("datafactory render", commands) if command["--split"] == ["0:0:1"]]
    trained = [command for command in of("datafactory render", commands) if command["--split"] != ["0:0:1"]]
    assert [("--populate" in command) for command in tested] == [False, True]
    scenes = [set(command["--scene"]) for command in tested]
    assert scenes[0] == scenes[1]
    assert "sionna:munich" in scenes[0]
    assert not scenes[0] & {scene for command in trained for scene in command["--scene"]}
    bare, populated = of("trainer evaluate", commands)
    assert bare["--run"] == populated["--run"]
    assert bare["--run"] == [fit["--out"][0] for fit in of("trainer fit", commands)]
    drawn = commands[-1]
    assert drawn[""] == [
        "bin/python",
        "-m",
        "trainer.evaluation.report.worlds",
        bare["--out"][0],
        populated["--out"][0],
    ]


def test_what_is_finished_is_not_made_again_and_what_is_begun_goes_on(tmp_path):
    worlds = tmp_path / "worlds"
    (worlds / "bare-1").mkdir(parents=True)
    (worlds / "city-1.usda").touch()
    (worlds / "bare-1" / "manifest.json").touch()
    (worlds / "runs" / "bare-2-seed0").mkdir(parents=True)
    (worlds / "runs" / "bare-2-seed0" / "run.json").touch()
    (worlds / "runs" / "bare-1-seed0.done").touch()
    commands = steps(worlds)
    written = {Path(command["--out"][0]).name: command for command in commands}
    assert not {"city-1.usda", "bare-1", "bare-1-seed0"} & set(written)
    assert "--resume" in written["bare-2-seed0"]
    assert "--resume" not in written["bare-4-seed0"]
    assert {"bare-2", "populated-1"} <= set(written)


def test_a_miniature_is_a_matter_of_variables(tmp_path):
    commands = steps(
        tmp_path / "worlds", WORLDS_COUNTS="1 2", WORLDS_FRAMES="4", WORLDS_SPLIT="1:1:0", WORLDS_STEPS="2",
        WORLDS_SEEDS="0 1", WORLDS_RAYS="2000", WORLDS_CITIES="1:motorway 2:suburb 3:suburb",
    )  # fmt: skip
    fits = of("trainer fit", commands)
    assert [(Path(fit["--out"][0]).name, fit["--frames"][0]) for fit in fits if "bare" in fit["--out"][0]] == [
        ("bare-1-seed0", "4"), ("bare-1-seed1", "4"), ("bare-2-seed0", "2"), ("bare-2-seed1", "2"),
    ]  # fmt: skip
    trained = [command for command in of("datafactory render", commands) if command["--split"] == ["1:1:0"]]
    assert sorted(Path(command["--out"][0]).name for command in trained) == [
        "bare-1", "bare-2", "populated-1", "populated-2",
    ]  # fmt: skip
