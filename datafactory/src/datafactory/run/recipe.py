"""What is to be made, ready to be made: a job, and what its manifest says of it.

The last place that knows the order: from here on there are frames, portions and shards.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import pyarrow as pa

from datafactory.frame.points import rayleigh_length
from datafactory.paths.storage import paths_schema
from datafactory.run.job import Job
from datafactory.run.order import Order
from datafactory.run.preparation import Prepared
from shared.dataset import arrow_schema, description
from shared.radar import Radar
from shared.signal.tdm import statement
from shared.signal.windows import angle_window, point_spread


@dataclass(frozen=True)
class Recipe:
    """A job, and the manifest's entries that are the run's own, its ``arguments`` among them."""

    job: Job
    manifest: dict[str, Any]


def of_frames(order: Order, prepared: Prepared) -> Recipe:
    """A dataset of frames."""
    settings, about = order.settings, frames_described(order)
    arguments = {
        **prepared.arguments,
        "processing": asdict(settings.processing),
        "prune_db": settings.prune_db,
        "close_targets": asdict(settings.close_targets),
    }
    stated = {key: about[key] for key in ("radar", "array", "virtual_sensor", "axes", "shapes", "conventions", "truth")}
    if order.licence is not None:
        arguments["license"] = stated["license"] = order.licence
    manifest = {"arguments": arguments, **stated, "scenes": prepared.entries}
    return Recipe(_job(order, prepared, arrow_schema(about), order.split), manifest)


def of_paths(order: Order, prepared: Prepared) -> Recipe:
    """A folder of traced paths."""
    manifest = {"arguments": prepared.arguments, "scenes": prepared.entries}
    return Recipe(_job(order, prepared, paths_schema(), None), manifest)


def frames_described(order: Order) -> dict[str, Any]:
    """What the frames of an order are, as each shard's metadata says it."""
    processing = order.settings.processing
    conventions = _conventions(order.radar, processing.truth_window)
    return description(order.radar, processing.peaks, processing.store, conventions)


def _job(order: Order, prepared: Prepared, schema: pa.Schema, split: str | None) -> Job:
    return Job(
        radar=order.radar,
        deal=prepared.deal,
        scenes=prepared.scenes,
        settings=order.settings,
        of_scenes=order.of_scenes,
        stored=prepared.stored,
        schema_message=schema.serialize().to_pybytes(),
        split=split,
    )


def _conventions(radar: Radar, window: str) -> dict[str, Any]:
    """What a reader of one shard needs to know beside the axes.

    :param window: of the truth, see :func:`shared.signal.windows.angle_window`
    """
    elements = radar.virtual_sensor.channels
    y, wavelength = radar.virtual_sensor.rx[:, 1], radar.waveform.wavelength_m
    spacing = abs(float(y[1] - y[0])) if len(y) > 1 else 0.0
    width = sidelobe = None  # of what is no line of elements
    if spacing > 0.0:
        width, sidelobe = point_spread(angle_window(window, elements), spacing / wavelength)
    return {
        "conventions": {
            "frame": "x forward, y left, z up, origin at the centroid of the full array's RX; u = y / range",
            "units": "range_channel and image_peak in sqrt(W), noise_power in W per channel and range-Doppler cell",
            "velocity": "; ".join(filter(None, ("range rate, positive is receding", statement(radar)))),
            "image": "truth magnitude relative to image_peak; row r in the first Doppler cell of range bin r",
        },
        "truth": {
            "window": window,
            "width_u": width,
            "width_bins": None if width is None else width / radar.grid.step,
            "peak_sidelobe_db": sidelobe,
            "rayleigh_length_u_of_array": rayleigh_length(radar),
        },
    }
