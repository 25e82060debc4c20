"""Radars, materials, poses and targets on damaged and odd files: read with finite values, or one line.

JSON and TOML also get documents of the right syntax and the wrong content.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fuzzing import EDITS, JSON, SPLICES, Edit, Splice, altered, damaged, edited, fuzz, reads_or_says_one_line
from hypothesis import strategies as st

from datafactory.frame.points import read_targets
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import read_poses
from shared.radar import Radar, load_radar

RADAR = b"""name = "fuzz"
[waveform]
carrier_hz = 76.5e9
bandwidth_hz = 4e8
chirp_interval_s = 0.2e-3
chirps = 16
samples = 64
range_bins = 60
multiplexing = "tdm"
[array]
tx_m = [[0.0, 0.0, 0.0], [0.0, 0.01, 0.0]]
rx_m = [[0.0, 0.0, 0.0], [0.0, 0.002, 0.0]]
[front_end]
noise_figure_db = 10
tx_pattern = { kind = "isotropic", gain_dbi = 3.0 }
[grid]
bins = 20
u_start = -0.5
"""

MATERIALS = b"""default = "metal"
[map]
"wall 1" = "snow"
[material.snow]
relative_permittivity = 1.5
conductivity = 0.01
sigma0_db = -20.0
grazing_deg = 10.0
pattern = "backscattering"
valid_ghz = [70.0, 80.0]
aliases = ["ice", "drift"]
"""

POSES = b"""[{"position": [1, 2.5, 0.5], "yaw_deg": 30, "pitch_deg": -2e0, "velocity": [3, 0, 0], "time": 0.5},
 {"position": [0, 0, 1]}]"""

TARGETS = b"""[[{"x": 10, "y": -2.5, "z": 0.1, "vx": 3, "rcs_dbsm": 5.0, "phase": 1e-3}], [],
 [{"x": 4, "y": 0, "rcs_dbsm": -10}],
 [{"x": 9, "y": 1, "z": -0.5, "vx": -1.4, "model": "pedestrian", "stature_m": 1.75, "gait_phase": 0.5},
  {"x": 20, "y": 3, "vx": 9, "model": "car", "wheel_radius_m": 0.3, "heading_deg": 2e1}]]"""


PATTERN = b"""azimuth_deg,elevation_deg,gain_dbi
-180,-90,0
-180,90,1.5
180,-90,-3
180,90,2e0
"""


def finite_radar(path: Path) -> None:
    radar = load_radar(str(path))
    json.dumps(radar.metadata(), allow_nan=False)


def finite_poses(path: Path) -> None:
    for pose in read_poses(path):
        assert np.isfinite([*pose.position, *pose.velocity, *pose.quaternion(), pose.time_s]).all()


def finite_targets(path: Path) -> None:
    for frame in read_targets(path):
        placed = frame.echo_points(Radar(), 1)
        for values in (placed.position, placed.velocity, placed.rcs_dbsm, placed.phase_rad):
            assert np.isfinite(values).all()


def finite_materials(path: Path) -> None:
    table = load_materials(path)
    json.dumps(table.map_materials(["wall 1", "", "\x00"]).to_json(), allow_nan=False)


def finite_pattern(path: Path) -> None:
    radar = path.with_name("with-pattern.toml")
    radar.write_text(f'[front_end]\nrx_pattern = {{ kind = "table", file = "{path.name}" }}\n')
    finite_radar(radar)


TEXTS: dict[str, tuple[bytes, Callable[[Path], object]]] = {
    "radar.toml": (RADAR, finite_radar),
    "materials.toml": (MATERIALS, finite_materials),
    "poses.json": (POSES, finite_poses),
    "targets.json": (TARGETS, finite_targets),
    "pattern.csv": (PATTERN, finite_pattern),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@pytest.mark.parametrize("name", TEXTS)
def test_the_undamaged_text_is_read(folder: Path, name: str) -> None:
    good, read = TEXTS[name]
    (folder / name).write_bytes(good)
    read(folder / name)


@pytest.mark.parametrize("name", TEXTS)
@fuzz(120, splices=SPLICES)
def test_damaged_text(folder: Path, name: str, splices: list[Splice]) -> None:
    good, read = TEXTS[name]
    (folder / name).write_bytes(damaged(good, splices))
    reads_or_says_one_line(lambda: read(folder / name))


@pytest.mark.parametrize("name", TEXTS)
@fuzz(120, edits=EDITS)
def test_edited_text(folder: Path, name: str, edits: list[Edit]) -> None:
    good, read = TEXTS[name]
    (folder / name).write_bytes(edited(good, edits))
    reads_or_says_one_line(lambda: read(folder / name))


@pytest.mark.parametrize("name", ["poses.json", "targets.json"])
@fuzz(80, edits=st.lists(st.tuples(st.floats(0.0, 1.0), JSON), min_size=1, max_size=3))
def test_altered_documents(folder: Path, name: str, edits: list[tuple[float, object]]) -> None:
    good, read = TEXTS[name]
    (folder / name).write_text(json.dumps(altered(json.loads(good), edits)), encoding="utf-8")
    reads_or_says_one_line(lambda: read(folder / name))


@pytest.mark.parametrize("name", ["poses.json", "targets.json"])
@fuzz(
    80,
    field=st.sampled_from(
        ["position", "velocity", "yaw_deg", "time", "x", "vy", "rcs_dbsm", "phase", "model", "stature_m", "heading_deg"]
    ),
    value=JSON,
)
def test_json_of_the_wrong_content(folder: Path, name: str, field: str, value: object) -> None:
    entry = {"position": [0, 0, 0]} if name == "poses.json" else {"x": 1, "y": 2, "rcs_dbsm": 0}
    entries = [{**entry, field: value}]
    read = TEXTS[name][1]
    for document in (entries if name == "poses.json" else [entries], value):
        (folder / name).write_text(json.dumps(document), encoding="utf-8")
        reads_or_says_one_line(lambda: read(folder / name))


@pytest.mark.parametrize("name", ["radar.toml", "materials.toml"])
@fuzz(
    80,
    field=st.sampled_from(
        [
            *("waveform.samples", "waveform.carrier_hz", "waveform", "array.tx_m", "grid.bins", "front_end.rx_pattern"),
            *("material.snow.pattern", "material.snow.valid_ghz", "material.snow.conductivity", "map.x", "default"),
        ]
    ),
    value=st.one_of(
        *(st.floats(), st.integers(-(2**70), 2**70), st.booleans(), st.lists(st.floats(), max_size=3)),
        st.sampled_from(["metal", "", "isotropic"]),
    ),
)
def test_toml_of_the_wrong_content(folder: Path, name: str, field: str, value: object) -> None:
    text = "nan" if value != value else str(value).lower() if isinstance(value, bool) else repr(value)
    (folder / name).write_text(f"{field} = {text}\n", encoding="utf-8")
    reads_or_says_one_line(lambda: TEXTS[name][1](folder / name))
