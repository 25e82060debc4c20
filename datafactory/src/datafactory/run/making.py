"""An order to a dataset or to traced paths: its scenes are opened while workers get ready, then the recipe is made.

What makes one frame stands in :mod:`datafactory.frame.chain`.
"""

from __future__ import annotations

import math
import time
from contextlib import AbstractContextManager
from dataclasses import replace

from datafactory.effects.catalogue import ALL
from datafactory.paths.trace import find_shapes
from datafactory.run import recipe
from datafactory.run.engines import LOCAL
from datafactory.run.memory import processes_ahead, require_room, workers_for
from datafactory.run.order import Order
from datafactory.run.pipeline import Execution, Report, produce
from datafactory.run.preparation import Prepared, load_of, opened_scenes, prepare
from datafactory.run.progress import claimed
from datafactory.scenes.materials.table import MaterialTable
from shared.signal.tdm import statement


def render(order: Order, table: MaterialTable, execution: Execution) -> Report:
    """Render a dataset.

    :raises InputError: anything wrong with the order or its inputs, before anything is written
    :raises OSError: the disk or the store fails; what was finished can be resumed
    :raises RunFailed: worker processes died; what was finished can be resumed
    """
    started = time.perf_counter()
    with claimed(execution.directory, execution.resume), _ahead(order, execution):
        jobs = execution.job.of if execution.job else 1
        require_room(execution.directory, math.ceil(_frames(order) / jobs), recipe.frames_described(order)["shapes"])
        order, execution = _fitted(order, execution)
        if said := statement(order.radar):
            execution.announce(said)
        return produce(recipe.of_frames(order, _prepared(order, table, execution)), execution, started)


def trace_paths(order: Order, table: MaterialTable, execution: Execution) -> Report:
    """Trace scene frames into ``paths/`` of the folder, for :func:`render` with ``Order.traced``; otherwise like it."""
    started = time.perf_counter()
    with claimed(execution.directory, execution.resume), _ahead(order, execution):
        order, execution = _fitted(order, execution, rendered=False)
        # One trace serves many radars: each leaves out for itself what it would not notice.
        order = replace(order, effects=order.effects or ALL)
        return produce(recipe.of_paths(order, _prepared(order, table, execution)), execution, started)


def _frames(order: Order) -> int:
    return order.scene_frames + (len(order.targets) or order.points)


def _ahead(order: Order, execution: Execution) -> AbstractContextManager[None]:
    """Workers get ready while scenes are opened: libraries take as long."""
    device = order.settings.device
    count = processes_ahead(execution.workers, device)
    if order.traced is None:
        return execution.engine.ahead(min(count, _frames(order)), device if order.scenes else None)
    return execution.engine.ahead(count, None)


def _fitted(order: Order, execution: Execution, rendered: bool = True) -> tuple[Order, Execution]:
    """The order with its scenes opened, and the execution with as many workers as there is memory for.

    :raises InputError: a scene that cannot be read, a run that cannot fit into memory
    """
    scenes = opened_scenes(order)
    workers = workers_for(load_of(order, scenes, rendered), execution.processes_here, execution.announce)
    if execution.engine.name == LOCAL:
        execution = replace(execution, workers=workers)
    return replace(order, scenes=tuple(scenes)), execution


def _prepared(order: Order, table: MaterialTable, execution: Execution) -> Prepared:
    """The order's inputs; what its frames need of the scenes' shapes is found here, once for all workers."""
    prepared = prepare(order, table, execution.announce)
    for scene in prepared.scenes:
        find_shapes(scene.merged, order.of_scenes.trace)
    return prepared
