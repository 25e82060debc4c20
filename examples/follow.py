"""Follow a recording: images and points of each frame as a radar writes it.

    python examples/follow.py
    python examples/follow.py --file recording.c64 --radar my-radar.toml --model likes

A recorder appends frames to a file, complex64 [chirp, sample, channel] one after the other. This program reads each as
soon as it is whole, and prints what it sees, how many frames it does in a second, and how late it is: from the moment
when a frame was whole in the file to its points. Frames that were written meanwhile are skipped, the newest is taken,
and the skipped ones are counted. Without ``--file`` a recorder is played: a target that walks away.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from shared.radar import Radar, load_radar
from shared.signal import if_signal
from trainer import Predictor

OUT = Path(os.environ.get("EXAMPLES_OUT", "build/examples")) / "follow"


def main(
    file: Annotated[Path | None, typer.Option(help="Recording; one is played without.")] = None,
    radar: Annotated[str, typer.Option(help="Preset or TOML file.")] = "avr-qdm-110",
    model: Annotated[str, typer.Option(help="Shipped network, folder of a run, or estimator.")] = "sparse6",
    frames: Annotated[int, typer.Option(help="Of the recording that is played.")] = 12,
    rate: Annotated[float, typer.Option(help="Of it [frames/s].")] = 2.0,
    patience: Annotated[float, typer.Option(help="Without a new frame for so long the recording is over [s].")] = 5.0,
) -> None:
    measuring = load_radar(radar)
    predictor = Predictor.load(model, measuring)
    # Kernels are loaded before the first frame comes.
    shape = measuring.waveform.chirps, measuring.waveform.samples, measuring.array.channels
    predictor.cube(np.ones(shape, np.complex64))
    if file is None:
        OUT.mkdir(parents=True, exist_ok=True)
        file = OUT / "recording.c64"
        file.unlink(missing_ok=True)
        threading.Thread(target=play, args=(file, measuring, frames, rate), daemon=True).start()
    skipped, late, began = 0, [], 0.0
    for number, cube, whole_at in growing(file, measuring, patience):
        began = began or time.monotonic()
        found = predictor.cube(cube, number).points
        assert found is not None
        late.append(time.monotonic() - whole_at)
        skipped = number + 1 - len(late)
        strongest = f"{found.range_m[0]:6.2f} m, u = {found.u[0]:+.3f}" if len(found) else "nothing"
        print(f"frame {number:3}: {len(found):4} points, strongest at {strongest}, {1e3 * late[-1]:.0f} ms late")
    if len(late) > 1:
        passed, middle = time.monotonic() - began - patience, 1e3 * np.median(late[1:])
        print(f"{len(late) / passed:.2f} frames/s, {skipped} skipped, {middle:.0f} ms late in the middle")


def growing(file: Path, radar: Radar, patience_s: float) -> Iterator[tuple[int, np.ndarray, float]]:
    """(number, cube, when it was found whole) of the newest frame of a file, each at most once."""
    shape = radar.waveform.chirps, radar.waveform.samples, radar.array.channels
    size, seen, last = 8 * int(np.prod(shape)), 0, time.monotonic()
    while time.monotonic() - last < patience_s:
        whole = file.stat().st_size // size if file.exists() else 0
        if whole <= seen:
            time.sleep(0.01)
            continue
        found_at, seen = time.monotonic(), whole
        yield whole - 1, np.fromfile(file, np.complex64, size // 8, offset=(whole - 1) * size).reshape(shape), found_at
        last = time.monotonic()


def play(file: Path, radar: Radar, frames: int, rate: float) -> None:
    """Append frames at a rate: a target 12 m ahead that walks away at 1.5 m/s, in noise."""
    draw, velocity = np.random.default_rng(0), np.array([[1.5, 0.0, 0.0]])
    deviation = np.sqrt(0.5 * radar.sample_noise_power_w)
    for number in range(frames):
        next_at = time.monotonic() + 1.0 / rate
        place = np.array([[12.0, 2.0, 0.0]]) + velocity * number / rate
        cube = if_signal(radar, place, velocity, np.array([1e-6 + 0j])).astype(np.complex64)
        cube += deviation * draw.standard_normal((*cube.shape, 2), dtype=np.float32).view(np.complex64)[..., 0]
        with file.open("ab") as handle:
            cube.astype(np.complex64).tofile(handle)
        time.sleep(max(next_at - time.monotonic(), 0.0))


if __name__ == "__main__":
    typer.run(main)
