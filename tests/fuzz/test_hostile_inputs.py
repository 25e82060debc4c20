"""What no fuzzer is sure to find: absurd numbers, too many digits, too deep documents, names that are not UTF-8."""

import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from datafactory.cli.app import main
from datafactory.frame.points import read_targets
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import read_poses
from datafactory.scenes.readers.open import open_scene
from shared.dataset.folder import MANIFEST, open_dataset
from shared.physics.errors import InputError
from shared.radar import load_radar

DEEP = "[" * 100_000
BOX = '<scene version="3.0.0"><shape type="cube"><transform name="to_world">{}</transform></shape></scene>'
HEADER = '#usda 1.0\n(\n metersPerUnit = {}\n upAxis = "Z"\n)\n'
SPHERE = 'def Sphere "s" {\n double radius = 1e300\n}\n'
FAR_TARGET = """def Xform "t" {
 double radar:rcs_dbsm = 0
 double3 xformOp:translate = (1e300, 0, 0)
 uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""


REFUSED: dict[str, tuple[str, Callable[[Path], object]]] = {
    # Finite but absurd: squares overflow.
    "scaled.xml": (BOX.format('<scale value="1e308"/>'), lambda path: open_scene(str(path))),
    "moved.xml": (BOX.format('<translate x="1e300"/>'), lambda path: open_scene(str(path))),
    "shrunk.xml": (BOX.format('<scale value="1e-300"/>'), lambda path: open_scene(str(path))),
    "sphere.usda": (HEADER.format(1) + SPHERE, lambda path: open_scene(str(path))),
    "units.usda": (HEADER.format(1e300) + SPHERE, lambda path: open_scene(str(path))),
    "target.usda": (HEADER.format(1) + FAR_TARGET, lambda path: open_scene(str(path))),
    "poses.json": ('[{"position": [1e300, 0, 0]}]', read_poses),
    "velocity.json": ('[{"position": [0, 0, 0], "velocity": [0, -1e300, 0]}]', read_poses),
    "targets.json": ('[[{"x": 1e200, "y": 0, "rcs_dbsm": 0}]]', read_targets),
    "walker.json": ('[[{"x": 9, "y": 0, "model": "pedestrian", "stature_m": 1.7, "vx": 1e4}]]', read_targets),
    "carrier.toml": ("[waveform]\ncarrier_hz = 1e300\n", lambda path: load_radar(str(path))),
    "chirp.toml": ("[waveform]\nchirp_duration_s = 1e-300\n", lambda path: load_radar(str(path))),
    "samples.toml": ("[waveform]\nsamples = 100000000000000\n", lambda path: load_radar(str(path))),
    "power.toml": ("[front_end]\ntransmit_power_dbm = 1e4\n", lambda path: load_radar(str(path))),
    # Where the radar equation diverges.
    "near.json": ('[[{"x": 0.009, "y": 0, "rcs_dbsm": 0}]]', read_targets),
    # More digits than a float has, and than Python turns into a number.
    "digits-400.json": (f'[[{{"x": 1{"0" * 400}, "y": 0, "rcs_dbsm": 0}}]]', read_targets),
    "digits-9000.json": (f'[[{{"x": 1{"0" * 9000}, "y": 0, "rcs_dbsm": 0}}]]', read_targets),
    # Deeper than a parser recurses.
    "deep-poses.json": (DEEP, read_poses),
    "deep-targets.json": (DEEP, read_targets),
    "deep-materials.toml": (f"x = {DEEP}", load_materials),
    "deep-radar.toml": (f"x = {DEEP}", lambda path: load_radar(str(path))),
    "deep-step.xml": (BOX.format("<x>" * 100_000 + "</x>" * 100_000), lambda path: open_scene(str(path))),
    MANIFEST: (DEEP, lambda path: open_dataset(path.parent)),
    "flat.obj": ("v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n", lambda path: open_scene(str(path))),
}


@pytest.mark.parametrize("name", REFUSED)
def test_an_absurd_file_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    text, read = REFUSED[name]
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(InputError):
        read(tmp_path / name)


LATIN_1 = os.fsdecode(b"caf\xe9")
"""A name in Latin-1, as file systems of UTF-8 names may hold it."""


@pytest.mark.parametrize("arguments", [["points", "--frames", "1", "--workers", "1", "--out"], ["inspect"]])
def test_a_folder_that_is_not_utf8_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, arguments: list[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["datafactory", *arguments, str(tmp_path / LATIN_1)])
    with pytest.raises(SystemExit) as left:
        main()
    assert left.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1
