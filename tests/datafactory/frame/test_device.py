"""Which device a command takes, with devices that are made up, and what is refused in one line."""

from __future__ import annotations

import pytest

from datafactory.frame import device
from datafactory.frame.device import device_of
from datafactory.paths.backend import CudaDevice
from datafactory.synthesis import cube
from shared.physics.errors import InputError

NONE = CudaDevice("", "there is no NVIDIA driver", "a driver")
WITHOUT_OPTIX = CudaDevice("a GPU", "the NVIDIA driver comes without OptiX", "all of the driver")
WHOLE = CudaDevice("a GPU")
NO_TORCH = "torch is built without CUDA"


@pytest.fixture
def machine(monkeypatch):
    """Makes up what is there."""

    def there(found: CudaDevice, problem: str | None) -> None:
        monkeypatch.setattr(device, "cuda_device", lambda: found)
        monkeypatch.setattr(device, "synthesis_problem", lambda: problem)

    return there


@pytest.mark.parametrize(
    ("found", "torch_problem", "tracing", "synthesis", "problem"),
    [
        (WHOLE, None, True, True, None),
        (NONE, None, True, True, "no NVIDIA driver"),
        (NONE, None, False, True, "no NVIDIA driver"),
        (NONE, NO_TORCH, False, False, "no NVIDIA driver"),
        (WITHOUT_OPTIX, None, True, True, "without OptiX"),
        # Stored paths and point targets are not traced; traced paths have no signals.
        (WITHOUT_OPTIX, None, False, True, None),
        (WHOLE, NO_TORCH, True, True, NO_TORCH),
        (WHOLE, NO_TORCH, True, False, None),
    ],
)
def test_cuda_is_taken_where_all_that_the_command_needs_is_there(
    machine, found, torch_problem, tracing, synthesis, problem
):
    machine(found, torch_problem)
    assert device_of("cpu", tracing, synthesis) == "cpu"
    assert device_of("auto", tracing, synthesis) == ("cuda" if problem is None else "cpu")
    if problem is None:
        assert device_of("cuda", tracing, synthesis) == "cuda"
        return
    with pytest.raises(InputError, match=f"--device: cuda: .*{problem}.*; expected ") as refused:
        device_of("cuda", tracing, synthesis)
    assert "\n" not in str(refused.value)
    assert "--device cpu" in str(refused.value) or "driver" in str(refused.value)


def test_the_processor_asks_for_nothing(monkeypatch):
    monkeypatch.setattr(device, "cuda_device", lambda: pytest.fail("no driver is needed"))
    monkeypatch.setattr(device, "synthesis_problem", lambda: pytest.fail("no torch is needed"))
    assert device_of("cpu", True, True) == "cpu"


def test_kernels_that_cannot_be_had_are_refused(monkeypatch):
    monkeypatch.setattr(cube, "synthesis_problem", lambda: NO_TORCH)
    assert cube.kernels_on("cpu") is cube.ON_CPU
    with pytest.raises(InputError, match=f"--device: cuda: {NO_TORCH}; expected torch for CUDA: pip install"):
        cube.kernels_on("cuda")
