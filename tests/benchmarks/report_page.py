"""How long the page of an evaluation takes to open: python tests/benchmarks/report_page.py DATASET [--frames 50]

Images of one test frame by das, iaa and omp for two arrays stand for those of all frames; Chromium as `make browser`
installs it, from the start of the navigation until the first frame is on the screen.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from playwright.sync_api import sync_playwright

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from browser import installed_browser

from shared.dataset.folder import open_dataset
from shared.dataset.reading import radar_of, read_frame
from shared.pictures import level_db, range_weighted
from trainer.data.arrays import choose_array
from trainer.evaluation.experiments.contenders import gather
from trainer.evaluation.report.page import (
    REPORT_SPAN_DB,
    ReportFrame,
    doppler_map,
    report_page,
    scene_levels,
    small_picture,
    to_bytes,
)
from trainer.evaluation.report.tables import metrics_table
from trainer.run.targets import AMPLITUDE

REPEATS = 5

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("dataset", type=Path)
parser.add_argument("--frames", type=int, default=50)
arguments = parser.parse_args()

dataset = open_dataset(arguments.dataset)
radar = radar_of(dataset.description(), arguments.dataset)
shard, row = dataset.rows("test")[0]
frame = read_frame(shard, row)
truth = frame.image * frame.image_peak
arrays = [choose_array(name, radar) for name in ("sparse6", "sparse4")]
images = {
    contender.name: to_bytes(
        scene_levels(contender.answer.image(frame.range_channel[0], frame.noise_power), contender.answer.unit, truth)
    )
    for contender in gather(["das", "iaa", "omp"], [], arrays, radar, arguments.dataset)
} | {"truth": to_bytes(scene_levels(truth, AMPLITUDE, truth))}
title, magnitude = doppler_map(frame, radar)
weighted = range_weighted(magnitude)
doppler = title, to_bytes(level_db(weighted, float(weighted.max()), REPORT_SPAN_DB))
camera = small_picture(dataset, frame.frame_id)
frames = [ReportFrame(f"frame {number}", 25, images, doppler, camera) for number in range(arguments.frames)]
page = report_page("fifty frames", "to be opened", radar, frames, [], metrics_table([], {}, {}))

browser = installed_browser()
if browser is None:
    raise SystemExit("there is no Chromium; make browser fetches one")
with TemporaryDirectory() as folder, sync_playwright() as driver:
    path = Path(folder) / "report.html"
    path.write_text(page, encoding="utf-8")
    chromium = browser.launched(driver, ["--disable-gpu"])
    seconds = []
    for _ in range(REPEATS):
        tab = chromium.new_page()
        started = time.perf_counter()
        tab.goto(path.as_uri())
        tab.wait_for_selector("body[data-ready=yes]")
        seconds.append(time.perf_counter() - started)
        tab.close()
    chromium.close()
print(
    f"{arguments.frames} frames of {len(images)} images, {path.name} {len(page) / 1e6:.0f} MB: "
    f"{min(seconds):.2f} to {max(seconds):.2f} s, median {statistics.median(seconds):.2f} s"
)
