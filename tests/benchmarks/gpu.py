"""What a GPU brings: the same frames rendered on the processor and on the GPU, by step, and what differs between them.

    python tests/benchmarks/gpu.py [--scene S] [--frames N] [--out build/gpu]

Each render is a command of its own, with one worker. Rays are not random: both trace the same ones. The noise is left
out, so that the difference is that of tracing and synthesis.
"""

import json
import math
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from shared.dataset.folder import open_dataset

COLUMNS = ("range_channel", "image")


def rendered(scene: str, frames: int, device: str, out: Path) -> dict[str, Any]:
    """The manifest's ``made`` of a fresh render."""
    shutil.rmtree(out, ignore_errors=True)
    command = [
        *(sys.executable, "-m", "datafactory", "render", scene, "--frames", str(frames), "--out", str(out)),
        *("--device", device, "--workers", "1", "--no-noise", "--effects", "all"),
    ]
    subprocess.run(command, check=True)
    return dict(json.loads((out / "manifest.json").read_text())["made"])


def difference_db(one: Path, other: Path, column: str) -> float:
    """Relative L2 difference of all frames' columns [dB]."""
    values = [
        np.concatenate(
            [getattr(frame, column).ravel() for split in opened.splits for frame in opened.frames(split, (column,))]
        )
        for opened in (open_dataset(one), open_dataset(other))
    ]
    apart = np.linalg.norm(values[1] - values[0]) / np.linalg.norm(values[0])
    return 20.0 * math.log10(max(float(apart), 1e-20))


def main(
    scene: Annotated[str, typer.Option(help="As of `datafactory render`.")] = "shipped:street",
    frames: Annotated[int, typer.Option(min=2, help="The first has the start of Mitsuba and torch in it.")] = 8,
    device: Annotated[str, typer.Option(help="Held against the processor; cpu tries this script out.")] = "cuda",
    out: Annotated[Path, typer.Option(help="Folder of the datasets and of gpu.json.")] = Path("build/gpu"),
) -> None:
    """Render on both, print seconds by step and differences, write gpu.json."""
    folders = {"processor": out / "processor", "device": out / "device"}
    made = {
        name: rendered(scene, frames, "cpu" if name == "processor" else device, folder)
        for name, folder in folders.items()
    }
    steps = sorted({step for item in made.values() for step in item["step_seconds"]})
    table = Table("step", "processor [s]", f"{device} [s]", title=f"{scene}, {frames} frames, one worker")
    for step in steps:
        table.add_row(step, *(f"{item['step_seconds'].get(step, 0.0):.1f}" for item in made.values()))
    table.add_row("frames a second", *(f"{frames / item['seconds']:.3f}" for item in made.values()))
    apart = {column: difference_db(folders["processor"], folders["device"], column) for column in COLUMNS}
    console = Console()
    console.print(table)
    for column, level in apart.items():
        console.print(f"{column}: {level:.1f} dB apart")
    record = {"scene": scene, "frames": frames, "device": device, "made": made, "difference_db": apart}
    (out / "gpu.json").write_text(json.dumps(record, indent=2) + "\n")
    console.print(f"wrote {out / 'gpu.json'}, on {made['device'].get('gpu', 'the processor')}", markup=False)


if __name__ == "__main__":
    typer.run(main)
