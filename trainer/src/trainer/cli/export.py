"""``trainer export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def export(
    run: Annotated[Path, typer.Argument(help="Run folder of trainer fit.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", help="File to write, ending in .onnx.", show_default=False)],
) -> None:
    """Write a run's network as ONNX, checked against torch."""
    from trainer.run.export import export as run_export

    result = run_export(run, out)
    print(
        f"{result.path}: within {result.difference:.1e} of torch; one image takes {1e3 * result.torch_seconds:.0f} ms "
        f"in torch, {1e3 * result.onnx_seconds:.0f} ms in onnxruntime"
    )
