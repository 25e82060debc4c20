"""What is settled before a run: the device, what is said of its inputs, and what is refused."""

import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from factory_command import refused
from prepared_scenes import TINY

from datafactory.api import asking, making
from datafactory.api.asking import device_of, load_scene, materials_of, order_of
from datafactory.api.forecasting import forecast
from datafactory.api.options import OrderOptions
from datafactory.paths.backend import CudaDevice
from datafactory.run import pipeline, shards
from datafactory.run.memory import processes
from datafactory.run.pipeline import Report
from datafactory.run.preparation import prepare
from datafactory.run.progress import first_difference
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.scene import Scene
from datafactory.synthesis import cube
from shared.dataset.folder import read_manifest
from shared.physics.errors import InputError
from shared.processes.telling import Announce, silent
from shared.radar import Radar
from shared.radar.waveform import Waveform

SHORT = Radar(waveform=Waveform(chirps=16, samples=128, range_bins=100))


@pytest.fixture
def stand_in(monkeypatch):
    """A machine on which ``cuda`` is torch on the processor."""
    on_torch = cube.torch_kernels
    for module in (asking, shards):
        monkeypatch.setattr(module, "cuda_device", lambda: CudaDevice("a stand-in"))
    for owner in (asking, cube):
        monkeypatch.setattr(owner, "synthesis_problem", lambda: None)
    monkeypatch.setattr(cube, "torch_kernels", lambda name: on_torch("cpu"))


def points(
    out: Path, device: str, resume: bool = False, workers: int = 1, announce: Announce = silent, frames: int = 2
) -> Report:
    """Frames of point targets, which need no Mitsuba."""
    return making.render(
        None, out, frames=0, points=frames, radar=SHORT, device=device, resume=resume, workers=workers,
        announce=announce,
    )  # fmt: skip


def manifest_of(report: Report) -> dict:
    return read_manifest(report.directory)


def columns_of(report: Report, name: str) -> np.ndarray:
    assert isinstance(report.directory, Path)
    shards = sorted(report.directory.glob("train/*.parquet"))
    return np.array([row for shard in shards for row in pq.read_table(shard)[name].to_pylist()])


def test_a_run_on_another_device_has_the_same_signals_within_the_bound(tmp_path, stand_in):
    on_cpu, on_device = points(tmp_path / "cpu", "cpu"), points(tmp_path / "cuda", "cuda")
    assert manifest_of(on_cpu)["arguments"]["device"] == "cpu"
    assert "gpu" not in manifest_of(on_cpu)["made"]
    made = manifest_of(on_device)
    assert made["arguments"]["device"] == "cuda"
    assert made["made"]["gpu"] == "a stand-in"
    assert "torch" in made["made"]["versions"]
    for column in ("range_channel", "image"):
        one, other = (columns_of(report, column) for report in (on_cpu, on_device))
        # The same noise, and signals that differ by the tolerance of point targets, 1e-6.
        assert np.linalg.norm(other - one) < 1e-3 * np.linalg.norm(one), column


def test_auto_is_settled_before_the_run_and_refused_where_it_changes(tmp_path, stand_in, monkeypatch):
    said: list[str] = []
    assert manifest_of(points(tmp_path / "run", "auto", announce=said.append))["arguments"]["device"] == "cuda"
    assert "device: cuda" in said
    monkeypatch.setattr(asking, "cuda_device", lambda: NONE)
    with pytest.raises(InputError, match=r"--resume: device is 'cpu', but the run in .* had 'cuda'"):
        points(tmp_path / "run", "auto", resume=True)


def test_that_kernels_are_compiled_first_is_said_once(tmp_path, monkeypatch):
    """By the process of the command, where frames are to be made and the kernels are not kept."""
    for name, kept, resume, times in (("run", False, False, 1), ("run", False, True, 0), ("other", True, False, 0)):
        said: list[str] = []
        monkeypatch.setattr(pipeline, "is_kept", lambda kernel, kept=kept: kept)
        points(tmp_path / name, "cpu", resume=resume, announce=said.append, frames=1)
        assert sum("compiled for this machine, once" in line for line in said) == times


def test_one_worker_has_the_gpu_unless_more_are_asked_for(tmp_path, stand_in):
    assert processes(0, "cuda") == 1
    assert processes(3, "cuda") == 3
    assert processes(0, "cpu") >= 1
    said: list[str] = []
    points(tmp_path / "run", "cuda", workers=2, announce=said.append, frames=1)  # made in this process
    assert "2 workers share one GPU, and its memory" in said


def test_a_forecast_says_whose_rates_it_has(tmp_path, stand_in):
    for name, whose in (("cpu", "rates of another machine"), ("cuda", "rates of a CPU, for none of a GPU")):
        order = order_of(OrderOptions(None, frames=0, points=2, radar="avr-qdm-110", device=name))
        assert any(whose in line for line in forecast(prepare(order, load_materials()), tmp_path, 1).lines())


NONE = CudaDevice("", "there is no NVIDIA driver", "a driver")
WITHOUT_OPTIX = CudaDevice("a GPU", "the NVIDIA driver comes without OptiX", "all of the driver")
WHOLE = CudaDevice("a GPU")
NO_TORCH = "torch is built without CUDA"


@pytest.mark.parametrize("command", [["points"], ["render", "shipped:tiny"], ["trace", "shipped:tiny"]])
def test_a_device_that_is_not_there_is_refused_before_anything_is_written(tmp_path, monkeypatch, command):
    monkeypatch.setattr(asking, "cuda_device", lambda: NONE)
    line = refused(*command, "--frames", 1, "--out", tmp_path / "out", "--device", "cuda")
    assert line == "datafactory: --device: cuda: there is no NVIDIA driver; expected a driver\n"
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("found", "torch_problem", "tracing", "synthesis", "problem"),
    [
        (WHOLE, None, True, True, None),
        (NONE, NO_TORCH, False, False, "no NVIDIA driver"),
        (WITHOUT_OPTIX, None, True, True, "without OptiX"),
        # Stored paths and point targets are not traced; traced paths have no signals.
        (WITHOUT_OPTIX, None, False, True, None),
        (WHOLE, NO_TORCH, True, True, NO_TORCH),
        (WHOLE, NO_TORCH, True, False, None),
    ],
)
def test_cuda_is_taken_where_all_that_the_command_needs_is_there(
    monkeypatch, found, torch_problem, tracing, synthesis, problem
):
    monkeypatch.setattr(asking, "cuda_device", lambda: found)
    monkeypatch.setattr(asking, "synthesis_problem", lambda: torch_problem)
    assert device_of("auto", tracing, synthesis) == ("cuda" if problem is None else "cpu")
    if problem is None:
        assert device_of("cuda", tracing, synthesis) == "cuda"
        return
    with pytest.raises(InputError, match=rf"--device: cuda: .*{problem}.*; expected .*(--device cpu|driver)"):
        device_of("cuda", tracing, synthesis)


def test_the_processor_asks_for_nothing(monkeypatch):
    monkeypatch.setattr(asking, "cuda_device", lambda: pytest.fail("no driver is needed"))
    monkeypatch.setattr(asking, "synthesis_problem", lambda: pytest.fail("no torch is needed"))
    assert device_of("cpu", True, True) == "cpu"


def test_kernels_that_cannot_be_had_are_refused(monkeypatch):
    monkeypatch.setattr(cube, "synthesis_problem", lambda: NO_TORCH)
    assert cube.kernels_on("cpu") is cube.ON_CPU
    with pytest.raises(InputError, match=f"--device: cuda: {NO_TORCH}; expected torch for CUDA: pip install"):
        cube.kernels_on("cuda")


MAP = '[map]\n"bricks" = "glass"\n"brick" = "glass"\n"M_42" = "glass"\n'


def said_of(radar: Radar, materials: Path | None = None) -> list[str]:
    said = list[str]()
    prepare(order_of(OrderOptions(TINY, radar=radar, frames=1)), materials_of(materials), said.append)
    return said


@pytest.mark.parametrize(("carrier_hz", "outside"), [(77e9, ""), (24e9, "(76 to 81 GHz)"), (97e9, "(76 to 81 GHz)")])
def test_materials_beyond_the_range_of_their_source_are_named(carrier_hz: float, outside: str) -> None:
    radar = Radar()
    radar = radar.model_copy(update={"waveform": radar.waveform.model_copy(update={"carrier_hz": carrier_hz})})
    said = [line for line in said_of(radar) if "the sources of these materials do not hold" in line]
    assert len(said) == bool(outside)
    assert all(line.startswith(f"tiny: at {carrier_hz / 1e9 + 0.5:g} GHz") and outside in line for line in said)


def test_names_of_map_that_no_scene_has_are_said(tmp_path: Path) -> None:
    (tmp_path / "materials.toml").write_text(MAP, encoding="utf-8")
    line = "--materials: no material of the scenes has these names of [map]: bricks, M_42; did you mean 'brick'?"
    assert line in said_of(Radar(), tmp_path / "materials.toml")
    assert not any("[map]" in line for line in said_of(Radar()))


def test_two_scenes_of_one_name_are_refused(tmp_path: Path) -> None:
    """Frames name their scene: those of the one would be taken for those of the other."""
    here, there = tmp_path / "one" / "tiny.usda", tmp_path / "other" / "tiny.usda"
    for file in (here, there):
        file.parent.mkdir()
        shutil.copy(TINY, file)

    def names(*scenes: Path | Scene) -> list[str]:
        order = order_of(OrderOptions(list(scenes), radar=Radar(), frames=2))
        return [scene.name for scene in prepare(order, materials_of(None)).job.scenes]

    assert names(here, here, there) == ["tiny"] * 3  # of the same contents
    assert names(here, load_scene(here, populate="poles=1")) == ["tiny"] * 2
    there.write_text(there.read_text(encoding="utf-8").replace('"brick"', '"glass"'), encoding="utf-8")
    with pytest.raises(InputError, match=r"--scene: .*one/tiny.usda and .*other/tiny.usda have one name, 'tiny'"):
        names(here, there)


def test_what_differs_of_a_list_is_named_by_its_place() -> None:
    """The beginning of a long list would be alike in both."""
    before = {"poses": [{"position": [float(n), 0.0, 0.5], "time": 0.0} for n in range(40)]}
    now = {"poses": [*before["poses"][:39], {"position": [39.0, 0.1, 0.5], "time": 0.0}]}
    assert first_difference(before, now) == ("poses.39.position", "[39.0, 0.0, 0.5]", "[39.0, 0.1, 0.5]")
    assert first_difference(before, before) is None
    shorter = first_difference(before, {"poses": before["poses"][:3]})
    assert shorter is not None
    assert shorter[0] == "poses"
