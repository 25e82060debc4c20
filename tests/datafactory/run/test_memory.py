"""What a run takes of the memory: the prediction held against processes, what is refused or announced, what is kept."""

import json
import platform
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from factory_command import run
from prepared_scenes import TINY
from processes import python
from small_radar import SMALL_RADAR

from datafactory import load_radar, render
from datafactory.api.asking import order_of
from datafactory.api.forecasting import forecast
from datafactory.api.options import OrderOptions
from datafactory.frame.chain import ChainSettings
from datafactory.frame.draws import split_of
from datafactory.frame.measurement import Processing
from datafactory.paths.solver import TraceSettings
from datafactory.run import memory
from datafactory.run.memory import Load, most_workers, workers_for
from datafactory.run.preparation import prepare
from datafactory.run.shards import ArrayJob, plan_shards
from datafactory.scenes.materials.table import load_materials
from shared.physics.errors import InputError
from shared.radar import Radar
from shared.radar.waveform import Waveform

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks"))

from worker_memory import CASES, measured

GB = 1e9


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="peak memory of a child is read as Linux counts it")
@pytest.mark.parametrize(
    "name", ["points, default radar", "tiny, small radar, 20 000 rays", "street, default radar, 20 000 rays"]
)
def test_a_process_takes_no_more_than_was_said_and_no_less_than_a_third(name: str, tmp_path: Path) -> None:
    (case,) = (case for case in CASES if case.name == name)
    peak, predicted = measured(replace(case, rays=5_000), tmp_path)
    assert predicted / 3.0 <= peak <= predicted


def load(rays: int = 200_000, store: str = "range-channel", **fields: object) -> Load:
    """A traced scene of a thousand triangles, by fields of :class:`Load`."""
    settings = ChainSettings(trace=TraceSettings(rays=rays), processing=Processing(store=store))
    given: dict[str, object] = {"radar": Radar(), "settings": settings, "triangles": 1000, "traced": True, **fields}
    return Load(**given)  # type: ignore[arg-type]


def test_everything_that_makes_a_run_larger_is_counted() -> None:
    usual = load()
    big = Radar(waveform=Waveform(chirps=256, samples=2048))
    deeper = replace(usual, settings=replace(usual.settings, trace=TraceSettings(depth=3)))
    for larger in (load(rays=400_000), load(store="cube"), load(radar=big), load(triangles=1_000_000), deeper):
        assert larger.worker_bytes > 1.05 * usual.worker_bytes
    assert load(traced=False, triangles=0).worker_bytes < usual.worker_bytes
    assert load(rendered=False).worker_bytes < usual.worker_bytes
    assert load(traced=False, triangles=0, stored=True).worker_bytes > load(traced=False, triangles=0).worker_bytes
    assert usual.total_bytes(4) == 4 * usual.worker_bytes + usual.parent_bytes


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Eight cores and ten gigabytes."""
    monkeypatch.setattr(memory, "usable_memory", lambda: int(10 * GB))
    monkeypatch.setattr(memory, "usable_cores", lambda: 8)
    return monkeypatch


def test_workers_by_themselves_count_memory_as_well_as_cores(machine: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    small, large = load(rays=1000, traced=False), load(rays=1_000_000)
    assert workers_for(small, 0) == 8
    assert workers_for(load(), 1, said.append) == 1
    assert said == []
    assert workers_for(load(), 4, said.append) == 4
    assert said[0].startswith("about ")  # of more than half of the memory
    assert "in 4 processes" in said.pop()
    workers = workers_for(large, 0, said.append)
    assert 1 < workers < 8
    assert large.total_bytes(workers) <= 10 * GB < large.total_bytes(workers + 1)
    assert said[0].startswith(f"{workers} processes, as there is memory for no more: about ")
    assert said[0].endswith("; 10.0 GB may be used here")


def test_what_was_asked_for_and_does_not_fit_is_refused_with_what_would(machine: pytest.MonkeyPatch) -> None:
    large = load(rays=1_000_000)
    fits = most_workers(large, 10 * GB)
    with pytest.raises(InputError, match=rf"--workers: 8 take about \d+\.\d GB .* expected at most {fits}$"):
        workers_for(large, 8)
    assert workers_for(large, fits) == fits
    with pytest.raises(InputError, match=r"--rays: 20000000 take about \d+\.\d GB of memory in 1 process") as caught:
        workers_for(load(rays=20_000_000), 0)
    rays = int(str(caught.value).rpartition("at most ")[2])
    assert load(rays=rays).total_bytes(1) <= 10 * GB < load(rays=rays + 1000).total_bytes(1)
    with pytest.raises(InputError, match=r"memory: one frame takes .* a smaller scene, or a larger machine"):
        workers_for(load(rays=1, triangles=20_000_000), 0)


def test_a_dry_run_says_it_of_the_scene_and_the_workers_that_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    order = order_of(OrderOptions(str(TINY), radar="avr-qdm-110", frames=80, rays=4000))
    recipe = prepare(order, load_materials())
    found = forecast(recipe, tmp_path, 3)
    expected = memory.statement(load(settings=order.settings, triangles=104), 3, memory.usable_memory())
    assert found.memory == expected
    assert expected in found.lines()
    assert forecast(recipe, tmp_path, 0).workers >= 1
    monkeypatch.setattr(memory, "usable_memory", lambda: 0.5 * GB)
    with pytest.raises(InputError, match="memory: one frame takes"):
        forecast(recipe, tmp_path, 0)


ONE_CHANNEL = "[array]\ntx_m = [[0, 0, 0]]\nrx_m = [[0, 0, 0]]\n"
CONVERTER = "[front_end.converter]\nbits = 12\nfull_scale_dbm = 0\n"
Lists = list[list[dict[str, float]]]
NOTHING: Lists = [[]] * 8
ONE_STANDING: Lists = [[{"x": 1.0, "y": 0.0, "rcs_dbsm": 60.0}]] * 8


@pytest.mark.parametrize(
    ("toml", "targets", "noise"),
    [
        (SMALL_RADAR, NOTHING, True),
        (SMALL_RADAR, NOTHING, False),
        (SMALL_RADAR + ONE_CHANNEL, ONE_STANDING, True),
        (SMALL_RADAR.replace("chirps = 8", "chirps = 1"), NOTHING, True),
        (SMALL_RADAR + CONVERTER, NOTHING, True),
    ],
    ids=["noise alone", "nothing", "one target", "one chirp", "noise below a converter's step"],
)
def test_frames_take_the_least_that_a_run_is_refused_for(
    toml: str, targets: Lists, noise: bool, tmp_path: Path
) -> None:
    (tmp_path / "radar.toml").write_text(toml)
    (tmp_path / "targets.json").write_text(json.dumps(targets))
    for store in ("range-doppler", "cube"):
        out, radar = tmp_path / store, load_radar(str(tmp_path / "radar.toml"))
        render(None, out, radar=radar, frames=0, targets=tmp_path / "targets.json", split="1:0:0", store=store,
               noise=noise, workers=1)  # fmt: skip
        (shard,) = out.glob("train/*.parquet")
        least = 8 * memory.least_bytes(radar, Processing(noise=noise, store=store))
        assert least <= shard.stat().st_size


def test_a_run_is_refused_where_even_its_noise_does_not_fit(
    radar_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By --dry-run too, which says where the forecast does not fit; what a killed run left there is room for it."""
    scene, out = str(TINY), tmp_path / "out"
    asked = ("render", scene, "--radar", radar_file, "--rays", 200, "--frames", 640, "--out", out)
    monkeypatch.setattr(memory, "free_bytes", lambda directory: 10_000_000)
    said = r"number of frames: 640 frames need at least \d+ MB; .*out has 10 MB free; expected at most \d+, or another"
    for more in (("--dry-run",), ("--workers", 1)):
        with pytest.raises(InputError, match=said):
            run(*asked, *more)
        assert not out.exists()
    (out / ".progress").mkdir(parents=True)
    (out / ".progress" / "rows").write_bytes(bytes(40_000_000))
    assert "free: the disk will probably be full before the run is done" in run(*asked, "--dry-run")
    monkeypatch.setattr(memory, "free_bytes", lambda directory: 10_000_000_000)
    assert "probably" not in run(*asked, "--dry-run")
    job = ArrayJob(3, 16)
    plans = job.own(plan_shards([split_of(index) for index in range(640)]))
    assert 0 < job.least_frames(640) <= sum(len(plan.frame_ids) for plan in plans)


FAULTS_OF_THE_LAST_ARRAYS = """
import resource
import numpy as np
from shared.processes.machine import keep_freed_memory

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

keep_freed_memory()
for _ in range(3):
    before = faults()
    len([np.full(15 * 2**20, 1, dtype=np.uint8) for _ in range(6)])
print(faults() - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only the GNU C library has these limits")
def test_memory_that_was_freed_is_not_asked_for_again():
    """Ninety megabytes for the third time. Without the limits that is 30 to 20 000 page faults, by the page's size."""
    assert int(python("-c", FAULTS_OF_THE_LAST_ARRAYS)) <= 2
