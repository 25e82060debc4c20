"""``datafactory accuracy``: what accuracy costs in time."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from datafactory.api.options import AccuracyOptions, OrderOptions
from datafactory.cli.console import plain_console, shown, table
from datafactory.cli.options import asking
from datafactory.frame.defaults import DEFAULT_FRAMES, IMAGE_BATCH
from shared.physics.errors import InputError

if TYPE_CHECKING:
    from shared.radar import Radar

TABLE_WIDTH = 175
"""Columns that the table needs; a narrower terminal wraps its lines rather than its cells."""


@asking(AccuracyOptions)
def accuracy(asked: AccuracyOptions) -> None:
    """Show what accuracy costs in time: every approximation as a knob with its price and its error."""
    from datafactory.accuracy import chart, knobs, lattices, report
    from datafactory.accuracy.power import Effort
    from datafactory.accuracy.samples import SampleFrame, made_with
    from datafactory.accuracy.sweep import sweep
    from datafactory.api.asking import materials_of, order_of
    from datafactory.api.declared import common
    from datafactory.effects.plan import plan_of_frame
    from datafactory.paths.backend import select_variant, set_threads
    from datafactory.run.preparation import prepare

    scene, out, quick = asked.scene, asked.out, asked.quick
    if scene is None:
        raise InputError("--scene", "missing", "a scene file or sionna:NAME")
    console = plain_console()
    # As many frames are drawn as of a run, of which the first are measured; rays and depth are varied.
    order = order_of(common(OrderOptions, asked, scenes=scene, frames=DEFAULT_FRAMES, rays=None))
    model = order.radar
    if asked.most_rays is not None:
        _check_most_rays(asked.most_rays, quick, model)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise InputError("--out", f"{out} is a file", "a folder") from None
    select_variant()
    set_threads(1)
    count = min(1 if quick else asked.frames, len(order.poses) or IMAGE_BATCH)
    prepared = prepare(order, materials_of(asked.materials), console.print)
    samples = [SampleFrame(prepared.deal.frame(frame_id), prepared.scenes[0]) for frame_id in range(count)]
    decided = plan_of_frame(samples[0].frame, samples[0].scene, model, order.of_scenes)
    effects = [name for name, on in decided.effects.items() if on]
    signal: tuple[knobs.Knob, ...] = knobs.SIGNAL_KNOBS
    power: tuple[knobs.Knob, ...] = knobs.POWER_KNOBS
    effort = Effort(knobs.REFERENCE_RAYS, repeats=asked.repeats)
    if quick:
        signal, power = knobs.QUICK_SIGNAL_KNOBS, knobs.QUICK_POWER_KNOBS
        effort = Effort(
            knobs.QUICK_REFERENCE_RAYS, realisations=2, reference_realisations=3, batch=1, rays=knobs.QUICK_RAYS
        )
    if asked.rays is not None:
        effort = replace(effort, rays=asked.rays, reference_rays=max(effort.reference_rays, 2 * asked.rays))
    if asked.most_rays is not None:
        power = knobs.with_more_rays(power, asked.most_rays)
        effort = replace(effort, reference_rays=max(effort.reference_rays, 2 * asked.most_rays))
    toggled = knobs.effect_knobs(effects)
    signal += tuple(knob for knob in toggled if not knob.power)
    power += tuple(knob for knob in toggled if knob.power)
    with shown(console) as progress:
        rows = sweep(
            samples, signal, power, effort, model, lambda done, total, label: progress(label, done, total),
            made_with(order),
        )  # fmt: skip
    rows = [row.planned({name: loss.change_db for name, loss in decided.losses.items()}) for row in rows]
    wide = plain_console(narrowest=TABLE_WIDTH)
    wide.print(table(f"What accuracy costs: {scene}", report.HEADINGS, report.table_rows(rows)))
    for line in (*report.EXPLANATION, report.effects_line(effects), *lattices.lines(rows)):
        console.print(line)
    batch = f"{effort.rays} rays, images in batches of {effort.batch}"
    title = f"{scene}: {count} frame{'s' if count > 1 else ''}, seed {asked.seed}, radar {model.name}, {batch}"
    for path in (*report.write_tables(rows, out), chart.write_picture(rows, title, out)):
        console.print(f"wrote {path}")


def _check_most_rays(most_rays: int, quick: bool, radar: Radar) -> None:
    """Refuse rays that are tried anyway, and more than the reference, which has twice as many, has memory for."""
    from datafactory.accuracy import knobs
    from datafactory.frame.chain import ChainSettings
    from datafactory.paths.solver import TraceSettings
    from datafactory.run.memory import Load, amount, rays_that_fit
    from shared.processes.machine import usable_memory

    usual = knobs.most_rays(knobs.QUICK_POWER_KNOBS if quick else knobs.POWER_KNOBS)
    if most_rays <= usual:
        raise InputError("--most-rays", f"{most_rays}, which are tried without it", f"more than {usual}")
    of_reference = TraceSettings(rays=2 * most_rays, depth=knobs.REFERENCE_DEPTH)
    load, limit = Load(radar, ChainSettings(trace=of_reference), traced=True), usable_memory()
    fitting = rays_that_fit(load, limit) // 2
    if fitting < most_rays:
        needed = f"a reference of {2 * most_rays} rays takes {amount(load.worker_bytes)} of memory"
        raise InputError("--most-rays", f"{needed}, {amount(limit)} may be used", f"at most {max(fitting, 0)}")
