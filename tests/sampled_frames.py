"""Frames of a tiny scene to measure accuracy on, and a menu of few settings."""

from dataclasses import replace

from prepared_scenes import TINY

from datafactory.accuracy.knobs import Effort, Menu, Sample
from datafactory.effects.catalogue import ALL
from datafactory.run.preparation import Order, prepare
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose
from shared.radar import Radar

POSE = Pose((-10.0, 0.0, 0.5), yaw_deg=5.0, velocity=(4.0, 1.0, 0.0))
EFFECTS = ALL.without("diffraction").without("refraction")
"""What the scene calls for, near enough, and quick."""
MENU = Menu(
    rays=(1000, 4000), depth=(1, 2), prune_db=(-20.0, -40.0), tolerance=(1e-3, 1e-6), truth_terms=(3, 5),
    effort=Effort(8000, realisations=3, reference_realisations=3),
)  # fmt: skip


def samples_of(order: Order) -> list[Sample]:
    """The frames of an order of one scene at given poses."""
    job = prepare(order, load_materials(None)).job
    return [Sample(job.deal.frame(frame_id), job.scenes[0], order) for frame_id in range(len(job.deal))]


def order_of_two(radar: Radar) -> Order:
    """Two frames of the tiny scene."""
    poses = (POSE, replace(POSE, position=(-8.0, 1.0, 0.5)))
    return Order(radar=radar, scenes=(str(TINY),), poses=poses, split="1:0:0", effects=EFFECTS, seed=3)
