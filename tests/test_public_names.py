"""What the three packages name at their tops, used as a stranger would: in a fresh interpreter, warnings are errors.

Values that a user handles say what they are in one to five lines, the same in a notebook.
"""

import json
from collections.abc import Callable
from html import unescape
from pathlib import Path

import pytest
from command_line import ended
from factory_command import run, shards
from prepared_scenes import STREET, TINY
from processes import python
from small_dataset import make_dataset, make_frame

import datafactory
import shared
import trainer
from datafactory import load_scene
from datafactory.api.planning import ScenePlan
from datafactory.effects.plan import Decision, EffectPlan
from shared.physics.errors import Told
from shared.radar import Radar
from trainer import RadarDataset, load_imager, pretrained_run
from trainer.data.dataset import Example

PACKAGES = (shared, datafactory, trainer)
WAVEFORM = """
[waveform]
samples = 128
chirps = 16
range_bins = 64
"""
"""The paper's array and angles, a short frame of the nearest ten metres."""

STRANGER = """
import sys

import numpy as np
import pyarrow.parquet as pq
import torch
from torch.utils.data import DataLoader

from datafactory import Pose, load_radar, load_scene, render
from trainer import RadarDataset, estimators, load_imager, predict, pretrained_run

scene_file, radar_file, out = sys.argv[1:]

import datafactory.run.portions

datafactory.run.portions.WorkerPool = None  # one worker works in this process: no pool is called

steps, lines = [], []
scene = load_scene(scene_file)
report = render(
    scene, out, radar=load_radar(radar_file), poses=[Pose((0.0, 0.0, 0.5)), Pose((0.5, 0.0, 0.5), yaw_deg=5.0)],
    split="1:1:0", rays=4000, announce=lines.append, progress=lambda *step: steps.append(step),
)
assert report.frames == 2 and report.shards_made == 2, report
assert [step for step in steps if step[0] == "frames"][-1] == ("frames", 2, 2), steps
assert any("materials" in line for line in lines), lines

data = RadarDataset(out, "train", array="sparse6")
whole = RadarDataset(out, "validation")
assert len(data) == len(whole) == 1
example = data[0]
assert example.input.shape == (3, 64, 18) and example.input.dtype == torch.complex64
assert example.image.shape == (64, 450) and float(example.image.max()) == 1.0
assert example.metadata["scene"] == scene.name and example.metadata["frame_id"] == 0
assert data.range_m.shape == (64,) and data.u.shape == (450,)
batch = next(iter(DataLoader(data, batch_size=1)))
assert batch.input.shape == (1, 3, 64, 18) and batch.metadata["scene"] == [scene.name]
assert batch.metadata["sensor_position"].shape == (1, 3)

run, imager = load_imager(pretrained_run("sparse6"))
measured = whole[0]
noise = torch.tensor(measured.metadata["noise_power"]).expand(3)
with torch.inference_mode():
    image = imager(measured.input, noise).amax(dim=0)
assert image.shape == measured.image.shape and bool(torch.isfinite(image).all()) and float(image.max()) > 0.0

iaa = estimators.ESTIMATORS["iaa"]()
spectrum = iaa.image(
    example.input[0].numpy(), estimators.line_array(data.radar, data.channels), data.u, example.metadata["noise_power"]
)
assert spectrum.shape == (64, 450) and np.isfinite(spectrum).all() and spectrum.max() > 0.0

images = out + "-images"
assert predict(out, images, method="iaa", split="train", pictures=False, announce=lines.append) == 1
assert pq.read_schema(images + "/images.parquet").names == ["frame_id", "image", "velocity"]
assert lines[-1].startswith(f"1 frames of {out}"), lines
print("seen")
"""


@pytest.fixture(scope="module")
def radar_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("radar") / "short.toml"
    path.write_text(WAVEFORM, encoding="utf-8")
    return path


def test_a_stranger_renders_reads_and_images(radar_file: Path, tmp_path: Path) -> None:
    script = tmp_path / "stranger.py"
    script.write_text(STRANGER, encoding="utf-8")
    # A plan that is kept in the user's cache would not be made again.
    cache = str(tmp_path / "cache")
    assert python("-W", "error", script, TINY, radar_file, tmp_path / "data", XDG_CACHE_HOME=cache) == "seen\n"


def test_the_command_makes_the_bytes_that_the_function_makes(radar_file: Path, tmp_path: Path) -> None:
    datafactory.render(TINY, tmp_path / "by-call", radar=radar_file, frames=1, points=1, rays=4000, effects="all")
    arguments = ["render", "--scene", TINY, "--out", tmp_path / "by-command", "--radar", radar_file, "--frames", 1]
    arguments += ["--points", 1, "--rays", 4000, "--effects", "all", "--workers", 1]
    run(*arguments)
    by_call = shards(tmp_path / "by-call")
    assert by_call == shards(tmp_path / "by-command")
    assert len(by_call) == 1


def test_a_plan_says_what_the_command_says(radar_file: Path) -> None:
    (planned,) = datafactory.plan([str(TINY)], radar=str(radar_file), frames=1, rays=4000)
    arguments = ["plan", "--scene", TINY, "--radar", radar_file, "--frames", 1, "--rays", 4000, "--no-times", "--json"]
    code, told, said = ended("datafactory", *arguments)
    assert code == 0, said
    assert json.loads(told) == json.loads(json.dumps(planned.to_json()))
    assert planned.frames == 1


def test_a_bad_argument_is_refused_in_one_line(tmp_path: Path) -> None:
    """Of all others the command says the same (``tests/datafactory/cli/test_command_line.py``)."""
    for rays in (0, True):
        with pytest.raises(datafactory.InputError, match=rf"^--rays: {rays}; expected (a whole.*, )?1 to 20000000$"):
            datafactory.render(TINY, tmp_path / "out", rays=rays)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("package", [datafactory, trainer, trainer.estimators], ids=lambda package: package.__name__)
def test_every_public_name_is_there_and_documented(package: object) -> None:
    names = package.__all__  # type: ignore[attr-defined]
    assert len(names) == len(set(names))
    for name in names:
        assert getattr(package, name).__doc__, name
    assert set(names) < set(dir(package))
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = package.nothing  # type: ignore[attr-defined]


def test_a_rendering_process_starts_without_what_few_frames_need() -> None:
    """Every worker starts so; together these take more than a second."""
    dear = "'scipy.signal', 'scipy.stats', 'scipy.interpolate', 'trimesh', 'networkx', 'matplotlib'"
    script = f"import sys, datafactory.api.making; print(*{{{dear}}} & sys.modules.keys())"
    assert python("-W", "error", "-c", script).split() == []


@pytest.mark.parametrize("program", ["datafactory", "trainer"])
def test_a_package_is_a_program(program: str) -> None:
    assert f"Usage: python -m {program}" in python("-W", "error", "-m", program, "--help")


DECISIONS = (Decision("specular", True, "", "", -3.0), Decision("refraction", False, "", "", -90.0))


VALUES: dict[str, tuple[Callable[[], Told], list[str]]] = {
    "Radar": (Radar, ["77 GHz", "128 chirps of 1024", "3 TX x 16 RX, 48", "630 x 450", "0.15 m", "94 mm wide"]),
    "Array": (lambda: Radar().array, ["3 TX x 16 RX, 48 virtual channels, 94 mm wide, 0 mm high"]),
    "Scene": (lambda: load_scene(STREET),
              ["scene street", "310 objects", "13 point targets", "40 of them move", "warned: 13"]),
    "Plan": (lambda: ScenePlan(EffectPlan("street", -30.0, DECISIONS, {}), 8, {"specular": 0.25}, None),
             ["on: specular", "off: refraction", "8 frames", "-30 dB", "processor seconds a frame: specular 0.25"]),
    "Run": (lambda: load_imager(pretrained_run("sparse6"))[0],
            ["unrolled", "sparse6", "RX 0, 1, 6, 10, 13, 15", "681 train"]),
    "Frame": (lambda: make_frame(2),
              ["frame 2: points", "(1.0, -2.0, 0.1) m", "10.0 m/s", "2 targets, 2 boxes", "image [6, 20]"]),
}  # fmt: skip


@pytest.mark.parametrize("name", VALUES)
def test_a_value_says_what_it_is_in_five_lines(name: str) -> None:
    make, facts = VALUES[name]
    value = make()
    told = str(value)
    assert 1 <= len(told.splitlines()) <= 5
    assert max(map(len, told.splitlines())) <= 200
    assert [fact for fact in facts if fact not in told] == []
    shown = value._repr_html_()
    assert unescape(shown.removeprefix("<pre>").removesuffix("</pre>")) == told
    assert repr(value) != told


def test_an_example_says_its_shapes(tmp_path: Path) -> None:
    example = RadarDataset(make_dataset(tmp_path / "data"), "train")[1]
    assert isinstance(example, Example)
    assert str(example).splitlines() == [
        "frame 1: scene, street é",
        "input [3, 6, 8] (peak, range, channel), image [6, 20] (range, u)",
    ]
    assert example._repr_html_() == f"<pre>{example}</pre>"


def test_what_a_scene_is_called_is_no_markup() -> None:
    """A name from a file stands in a notebook's page as it is."""
    shown = ScenePlan(EffectPlan("<b>x", -30.0, DECISIONS, {}), 1, {}, None)._repr_html_()
    assert "&lt;b&gt;x" in shown
    assert "<b>" not in shown
