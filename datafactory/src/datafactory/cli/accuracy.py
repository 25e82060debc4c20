"""``datafactory accuracy``: what accuracy costs in time."""

from __future__ import annotations

from datafactory.api.options import AccuracyOptions, OrderOptions
from datafactory.cli.console import plain_console, shown, table
from datafactory.cli.options import asking
from datafactory.defaults import DEFAULT_FRAMES, IMAGE_BATCH
from shared.physics.errors import InputError

TABLE_WIDTH = 120
"""Columns that the table needs; a narrower terminal wraps its lines rather than its cells."""


@asking(AccuracyOptions)
def accuracy(asked: AccuracyOptions) -> None:
    """Show what accuracy costs in time: every approximation as a knob with its price and its error."""
    from datafactory.accuracy import chart, report, study
    from datafactory.accuracy.knobs import Sample
    from datafactory.api.asking import materials_of, order_of
    from datafactory.api.declared import common
    from datafactory.paths.backend import select_variant, set_threads
    from datafactory.run.preparation import prepare

    scene, out, quick = asked.scene, asked.out, asked.quick
    if scene is None:
        raise InputError("--scene", "missing", "a scene file or sionna:NAME")
    console = plain_console()
    # As many frames are drawn as of a run, of which the first are measured; rays and depth are varied.
    order = order_of(common(OrderOptions, asked, scenes=scene, frames=DEFAULT_FRAMES, rays=None))
    menu = study.menu_of_study(quick, asked.rays, asked.most_rays, order.radar)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise InputError("--out", f"{out} is a file", "a folder") from None
    select_variant()
    set_threads(1)
    count = min(1 if quick else asked.frames, len(order.poses) or IMAGE_BATCH)
    job = prepare(order, materials_of(asked.materials), console.print).job
    samples = [Sample(job.deal.frame(frame_id), job.scenes[0], order) for frame_id in range(count)]
    batch = 1 if quick else IMAGE_BATCH
    with shown(console) as progress:
        rows = study.study(samples, menu, asked.repeats, batch, lambda done, total, label: progress(label, done, total))
    wide = plain_console(narrowest=TABLE_WIDTH)
    wide.print(table(f"What accuracy costs: {scene}", report.HEADINGS, report.table_rows(rows)))
    for line in report.explanation(menu.effort):
        console.print(line)
    title = (
        f"{scene}: {count} frame{'s' if count > 1 else ''}, seed {asked.seed}, radar {order.radar.name}, "
        f"{menu.usual_rays} rays, images in batches of {batch}"
    )
    for path in (*report.write_tables(rows, out), chart.write_picture(rows, title, out)):
        console.print(f"wrote {path}")
