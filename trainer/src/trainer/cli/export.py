"""``trainer export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from shared.physics.errors import InputError

EXTRA = "pip install 'sparseradar-trainer[export]'"


def export(
    run: Annotated[Path, typer.Argument(help="Run folder of trainer fit.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", help="File to write, ending in .onnx.", show_default=False)],
) -> None:
    """Write a run's network as ONNX, checked against torch."""
    try:
        from trainer.run.export import export as run_export
    except ModuleNotFoundError as error:
        if error.name not in ("onnx", "onnxruntime"):
            raise
        raise InputError("trainer export", f"the package {error.name} is not installed", EXTRA) from error

    result = run_export(run, out)
    print(
        f"{result.path}: within {result.difference:.1e} of torch; one image takes {1e3 * result.torch_seconds:.0f} ms "
        f"in torch, {1e3 * result.onnx_seconds:.0f} ms in onnxruntime"
    )
