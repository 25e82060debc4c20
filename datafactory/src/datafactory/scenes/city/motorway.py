"""What only a motorway has: guard rails and barriers along its edges and its median, gantries, bridges over it."""

from __future__ import annotations

import numpy as np

from datafactory.scenes.city.plan import Plan, Street
from datafactory.scenes.city.shapes import X_TO_Z_CYCLE, Surface, box, joined, prism
from datafactory.scenes.city.site import Site

PIECE_M = 8.0
CLEARANCE_M = 5.2
DECK_M = 1.1
GIRDERS = 4


def equip(site: Site, plan: Plan) -> None:
    """Rails, median, gantries and bridges of the main street."""
    main, kind = plan.main, plan.main.kind
    for street in plan.bridges:
        site.place("Bridges", "Bridge", _bridge(street, main), (street.at, 0.0, 0.0))
    median = "Barrier" if site.rng.random() < 0.5 else "GuardRail"
    for index in range(int((main.end - main.start) / PIECE_M)):
        x = main.start + PIECE_M * index
        # Rails face -y of their own: the traffic.
        site.place("Rails", "GuardRail", "GuardRail", (x, kind.kerb + 0.6, 0.0))
        site.place("Rails", "GuardRail", "GuardRail", (x + PIECE_M, -kind.kerb - 0.6, 0.0), 180.0)
        if median == "Barrier":
            site.place("Rails", "Barrier", "Barrier", (x, 0.0, 0.0))
        else:
            site.place("Rails", "GuardRail", "GuardRail", (x + PIECE_M, kind.median_m - 0.7, 0.0), 180.0)
            site.place("Rails", "GuardRail", "GuardRail", (x, -kind.median_m + 0.7, 0.0))
    for x in np.arange(main.start + site.rng.uniform(30.0, 90.0), main.end - 10.0, site.rng.uniform(110.0, 180.0)):
        site.place("Gantries", "Gantry", "Gantry", (round(float(x), 1), 0.0, 0.0), 180.0 * float(site.rng.integers(2)))
    for x in np.arange(main.start + 20.0, main.end, 50.0):
        for side in (1.0, -1.0):
            site.place("Posts", "Bollard", "Bollard", (round(float(x), 1), side * (kind.kerb + 1.4), 0.0))


def _bridge(street: Street, main: Street) -> Surface:
    """A road bridge along y over a street along x: abutments, piers beside the median, girders, deck and parapets."""
    half, reach = street.kind.facade, main.kind.facade + 2.0
    top = CLEARANCE_M + DECK_M
    deck = box((-half, -reach - 6.0, top - 0.3), (half, reach + 6.0, top), "concrete")
    places = np.linspace(-half + 0.6, half - 0.6, GIRDERS)
    girders = [box((x - 0.25, -reach, CLEARANCE_M), (x + 0.25, reach, top - 0.3), "concrete") for x in places]
    parapets = [
        box((x - 0.15, -reach - 6.0, top), (x + 0.15, reach + 6.0, top + 1.0), "concrete")
        for x in (-half + 0.15, half - 0.15)
    ]
    abutments = []
    for sign in (1.0, -1.0):
        near, far = sign * reach, sign * (reach + 6.0)
        abutments.append(box((-half, min(near, far), 0.0), (half, max(near, far), top - 0.3), "concrete"))
        # The embankment behind: a ramp down to the ground.
        ramp = [(far, 0.0), (far + sign * 14.0, 0.0), (far, top)]
        ramp = ramp if sign > 0.0 else ramp[::-1]
        abutments.append(prism(ramp, -half, half, "vegetation").moved((0.0, 0.0, 0.0), X_TO_Z_CYCLE))
    return joined([deck, *girders, *parapets, *abutments])
