"""What every test may use: the oracles, a small radar, the ray tracer's variant."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import settings
from jaxtyping import install_import_hook
from threadpoolctl import threadpool_limits

if TYPE_CHECKING:
    from s3_server import Server

    from shared.radar import Radar

# Numba's threads and PyTorch's are of one OpenMP, and its idle threads spin: where another process held the other core,
# a step of training took ten times as long. It reads these where it is loaded, here and in commands that tests start.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Behind everything else on the path: the folder tests/shared must not come before the package of that name.
sys.path.append(str(Path(__file__).resolve().parent))

CHECKED = (
    "shared.physics",
    "shared.pictures",
    "shared.radar",
    "shared.signal",
    "datafactory.synthesis",
    "trainer.networks",
)
"""Packages whose annotations, array shapes among them, are checked at every call under test."""
# Before they are imported, so that this file imports none of them at its top.
install_import_hook(CHECKED, "array_shapes.checked")

# The same examples in every run; compilation makes the first example slow, so that a deadline would only add noise.
settings.register_profile("repeatable", derandomize=True, deadline=None, database=None)
settings.load_profile("repeatable")

LONG = (
    "benchmarks/test_bench.py",
    "datafactory/accuracy/test_choice.py::test_the_front_buys_accuracy_with_work",
    "datafactory/accuracy/test_looking.py::test_a_budget_on_two_scenes",
    "datafactory/paths/test_curved_mirrors.py::test_a_rounded_box_has_flat_faces_cylindrical_edges_and_spherical_corners[40",
    "datafactory/paths/test_trace_on_device.py",
    "datafactory/run/test_portions.py::test_a_deadly_portion_is_named_and_only_its_shard_is_owed[True",
    "datafactory/synthesis/test_kept_machine_code.py",
    "datafactory/synthesis/test_truth.py::test_an_echo_that_crosses_many_range_bins_is_where_it_was[14",
    "datafactory/synthesis/test_truth.py::test_an_echo_that_crosses_many_range_bins_is_where_it_was[7",
    "datafactory/synthesis/test_truth.py::test_what_passes_by_near_is_as_bright_as_it_is[0.5",
    "datafactory/synthesis/test_truth.py::test_what_passes_by_near_is_as_bright_as_it_is[0.8",
    "examples/",
    "fuzz/",
    "hardcases/test_hardcases.py::test_hard_case[estimators-",
    "hardcases/test_hardcases.py::test_hard_case[kernels-",
    "hardcases/test_hardcases.py::test_hard_case[signals-2^15",
    "hardcases/test_hardcases.py::test_hard_case[signals-crossing",
    "hardcases/test_hardcases.py::test_hard_case[signals-one",
    "integration/test_elsewhere.py",
    "integration/test_flipped_bits.py",
    "integration/test_frames_decide.py::test_a_frame",
    "integration/test_frames_decide.py::test_frames_that_look",
    "integration/test_same_bytes.py::test_rendered",
    "integration/test_same_bytes.py::test_traced_now_and_rendered_later_is_rendered_at_once[5",
    "integration/test_shipped_ground.py::test_a_populated_scene_has_the_same_bits_on_processors_with_and_without_avx_512[sce",
    "shared/dataset/test_locations.py::test_a_store_that_is_not_there_is_one_line[s3://b/set?endpoint_override=127",
    "shared/physics/test_compiled.py::test_a_read_only",
    "shared/signal/test_imaging.py::test_a_frame_has_the_same_bytes_in_every_batch_by_the_kernels_of_other_processors",
    "trainer/estimators/test_ml.py::test_three_and_four_targets_end_no_worse_than_a_refinement_from_the_truth[sparse4",
    "trainer/estimators/test_ml.py::test_three_and_four_targets_end_no_worse_than_a_refinement_from_the_truth[sparse6-3",
    "trainer/estimators/test_velocities.py::test_the_stated_deviation_is_that_of_the_errors[all",
    "trainer/run/test_imager.py::test_fit_predict_and_evaluate_say_so_once[capabilities1",
    "trainer/run/test_imager.py::test_the_package_s_networks_round_as_torch_does",
)
"""How the names begin of tests that are all marked slow: what they hold takes long, and seldom breaks."""

RadarMaker = Callable[..., "Radar"]


def _small_radar(**waveform: object) -> Radar:
    """The default radar with a short frame: 64 samples, 8 chirps, all range bins; fields of the waveform by name."""
    from shared.radar import Radar
    from shared.radar.waveform import Waveform

    fields: dict[str, object] = {"samples": 64, "chirps": 8, **waveform}
    fields.setdefault("range_bins", fields["samples"])
    # Not validated: eq. (1) and (2) hold for turns that overlap, too.
    return Radar.model_construct(name="small", waveform=Waveform.model_validate(fields))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """How many inputs the fuzzers have tried; reports carry it, so that xdist's processes are all counted."""
    from fuzzing import TRIED

    reports = [report for name in ("passed", "failed") for report in terminalreporter.stats.get(name, ())]
    tried = [value for report in reports for name, value in report.user_properties if name == TRIED]
    if tried:
        terminalreporter.write_line(f"{TRIED}: {sum(tried)} in {len(tried)} fuzzers, {min(tried)} at least")


@pytest.fixture(scope="session", autouse=True)
def one_blas_thread() -> Iterator[None]:
    """Small products gain nothing from threads, and lose a hundredfold where other processes hold the cores."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield


@pytest.fixture(autouse=True)
def one_torch_thread() -> None:
    """Numba's first parallel kernel gives PyTorch as many threads as there are cores; every test begins with one."""
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


@pytest.fixture(scope="session")
def small_radar() -> RadarMaker:
    return _small_radar


@pytest.fixture(scope="session")
def radar_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small radar's, for commands."""
    from small_radar import write_small_radar

    return write_small_radar(tmp_path_factory.mktemp("radar"))


@pytest.fixture(scope="session")
def s3() -> Iterator[Server]:
    """A server for this process; what a test made fail is mended after it by :func:`server`."""
    from s3_server import s3_server

    with s3_server() as running:
        yield running


@pytest.fixture
def server(s3: Server, monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    """The store of a test, with its credentials in the environment."""
    from s3_server import set_credentials

    set_credentials(monkeypatch)
    yield s3
    s3.mend()


@pytest.fixture(scope="session")
def variant() -> str:
    """Mitsuba's variant, set once before anything imports Sionna."""
    from datafactory.paths.backend import select_variant

    return select_variant()


@pytest.fixture
def generator() -> np.random.Generator:
    return np.random.default_rng(20_240)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what :data:`LONG` names."""
    for item in items:
        if item.nodeid.removeprefix("tests/").startswith(LONG):
            item.add_marker(pytest.mark.slow)
