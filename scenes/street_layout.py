"""The layout of the shipped street: a main street along x, cross streets between its blocks, furniture and people.

Datasets, figures and weights rest on its bytes. What ``datafactory city`` writes is in ``datafactory.scenes.city``.

Cross section of the main street, from its centre line: lane 3.5 m, parking strip 2 m, kerb 0.12 m high, pavement 3 m,
facades at 8.5 to 11 m (widths of a two-lane collector road with parking, RASt 06). Traffic keeps to the right. Moving
cars, pedestrians and cyclists have a ``radar:velocity``. People are point targets with a radar cross section.
"""

from __future__ import annotations

import numpy as np
from street_parts import RIDER_HEIGHT, TORSO_HEIGHT, HouseStyle, cyclist, house, pedestrian, tree

from datafactory.scenes.city import furniture, vehicles
from datafactory.scenes.city.shapes import Surface, stepped_surface, welded
from datafactory.scenes.city.site import CLASSES, Placement

BLOCK_LENGTH = 76.0
LANE = 3.5
KERB = 5.5
FACADE = 8.5
CROSS_KERB = 4.0
CROSS_FACADE = 6.5
KERB_HEIGHT = 0.12
DROPPED_KERB_HEIGHT = 0.03
"""At crossings, DIN 18040-3."""
REACH_X = 30.0
"""The road goes on this far [m] beyond the last house, the ground with it."""
REACH_Y = 70.0

PEDESTRIAN_RCS_DBSM = -1.4
"""Mean of a human, 3GPP TR 38.901."""
CYCLIST_RCS_DBSM = -10.0
"""Middle of the -8 to -13 dBsm of Belgiovane and Chen (2016)."""


class StreetLayout:
    """The layout of one street: collects placements while its builders draw from one generator, in a fixed order.

    :param seed: of the NumPy generator
    :param blocks: blocks of 76 m along the main street, with a cross street between neighbours
    :param largest_floors: storeys of the tallest house
    """

    def __init__(self, seed: int, blocks: int, largest_floors: int = 5) -> None:
        self.rng = np.random.default_rng(seed)
        self.largest_floors = largest_floors
        self.placements: list[Placement] = []
        self._counts: dict[str, int] = {}
        stride = BLOCK_LENGTH + 2.0 * CROSS_FACADE
        self.block_starts = [stride * (i - 0.5 * (blocks - 1)) - 0.5 * BLOCK_LENGTH for i in range(blocks)]
        self.crossings = [start - CROSS_FACADE for start in self.block_starts[1:]]
        self.half_length = -self.block_starts[0]
        # A pedestrian crossing lies 9 m east of each cross street; a city of one block has one in its middle.
        self.zebras = [centre + 9.0 for centre in self.crossings] or [0.0]
        self.models: dict[str, Surface] = {name: vehicles.car(shape) for name, shape in vehicles.CAR_SHAPES.items()}
        self.models |= {f"Tree_{i}": tree(self.rng) for i in range(3)}
        self.models |= {f"Sign_{kind}": furniture.sign(kind) for kind in ("round", "triangle", "panel")}
        self.models |= {"Lamp": furniture.lamp_post(), "Bollard": furniture.bollard(), "Bin": furniture.litter_bin()}
        self.models |= {"Pedestrian": pedestrian(), "Cyclist": cyclist()}

    def build(self) -> tuple[Placement, ...]:
        """Everything in the city, ground first."""
        self._ground()
        for start in self.block_starts:
            for side in (1, -1):
                self._house_row(start, start + BLOCK_LENGTH, side)
                self._kerb_line(start, side)
        for centre in self.crossings:
            self._cross_street(centre)
        for x in self.zebras:
            self._zebra(x)
        self._traffic()
        self._people()
        return tuple(self.placements)

    def _name(self, group: str, kind: str) -> str:
        number = self._counts.get(kind, 0)
        self._counts[kind] = number + 1
        return f"{group}/{kind}_{number}"

    def _place(
        self,
        group: str,
        kind: str,
        model: str,
        position: tuple[float, float, float],
        yaw_deg: float = 0.0,
        velocity: tuple[float, float] = (0.0, 0.0),
        rcs_dbsm: float | None = None,
    ) -> None:
        x, y, z = (round(value, 3) + 0.0 for value in position)
        vx, vy = (round(value, 2) + 0.0 for value in velocity)
        self.placements.append(
            Placement(
                self._name(group, kind), self.models[model], (x, y, z), yaw_deg, (vx, vy, 0.0), rcs_dbsm, model,
                radar_class=CLASSES.get(kind, ""),
            )
        )  # fmt: skip

    def _ground(self) -> None:
        """Roads at z = 0, pavements and plots behind kerbs: one terrace, cut into a named surface for each use."""
        end = self.half_length + REACH_X
        xs, labels = [-end], []
        edges = [(c + offset, label) for c in self.crossings for offset, label in _CROSS_PROFILE]
        edges += [(x + offset, label) for x in self.zebras for offset, label in ((-1.5, "block"), (1.5, "dropped"))]
        for x, label in sorted(edges):
            xs.append(x)
            labels.append(label)
        xs.append(end)
        labels.append("block")
        ys = [-REACH_Y, -FACADE, -KERB, KERB, FACADE, REACH_Y]

        def use(i: int, j: int) -> str:
            if j == 2:
                return "Road_0"
            if labels[i] == "cross":
                return f"Road_{1 + sum(centre < xs[i] for centre in self.crossings)}"
            if labels[i] == "dropped" and j in (1, 3):
                return "DroppedKerb"
            return "Pavement" if labels[i] == "walk" or j in (1, 3) else "Plot"

        levels = {"Pavement": KERB_HEIGHT, "Plot": KERB_HEIGHT, "DroppedKerb": DROPPED_KERB_HEIGHT}
        uses = [[use(i, j) for j in range(len(ys) - 1)] for i in range(len(xs) - 1)]
        heights = [[levels.get(name, 0.0) for name in row] for row in uses]
        polygons = stepped_surface(xs, ys, heights, lambda i, j: uses[i][j])
        materials = {"Plot": "vegetation", "Pavement": "concrete", "DroppedKerb": "concrete"}
        for name in sorted({polygon.material for polygon in polygons}):
            surface = welded(polygon for polygon in polygons if polygon.material == name)
            material = materials.get(name, "asphalt")
            surface = Surface(surface.vertices, surface.faces, (material,) * len(surface.faces))
            self.placements.append(Placement(f"Ground/{name}", surface))

    def _house(self, width: float, depth: float, x: float, y: float, yaw_deg: float) -> None:
        rng = self.rng
        gabled = bool(rng.random() < 0.45)
        style = HouseStyle(
            width=width,
            depth=depth,
            floors=int(rng.integers(2, min(4, self.largest_floors) if gabled else self.largest_floors, endpoint=True)),
            wall=str(rng.choice(["brick", "concrete", "plasterboard", "marble"], p=[0.4, 0.3, 0.2, 0.1])),
            frame=str(rng.choice(["wood", "metal"])),
            gabled=gabled,
            door_bay=int(rng.integers(max(1, int(width / 2.7)))),
        )
        position = (round(x, 3), round(y, 3), 0.0)
        self.placements.append(Placement(self._name("Houses", "House"), house(style), position, yaw_deg))

    def _frontage(self, start: float, end: float) -> list[tuple[float, float, float]]:
        """Houses along a frontage as (start, width, setback) [m]: runs of one setback with gaps between the runs."""
        rng, row, at, setback = self.rng, [], start, 0.0
        while end - at >= 8.0:
            width = min(rng.uniform(9.0, 16.0), end - at)
            row.append((at, width, setback))
            at += width
            if rng.random() < 0.4:
                at += rng.uniform(2.0, 5.0)
                setback = rng.uniform(0.0, 2.5)
        return row

    def _house_row(self, start: float, end: float, side: int) -> None:
        for at, width, setback in self._frontage(start, end):
            x = at if side > 0 else at + width
            self._house(width, self.rng.uniform(9.0, 12.0), x, side * (FACADE + setback), 0.0 if side > 0 else 180.0)

    def _cross_street(self, centre: float) -> None:
        """Houses along both arms of a cross street, behind those of the main street; two signs and a waiting car."""
        for arm in (1, -1):
            for side in (1, -1):
                for at, width, setback in self._frontage(26.0, REACH_Y - 4.0):
                    # East of the street the facade faces -x (yaw -90 degrees: x' runs along -y), west of it +x.
                    far_end = (side > 0) == (arm > 0)
                    y = arm * (at + width) if far_end else arm * at
                    yaw_deg = -90.0 if side > 0 else 90.0
                    self._house(
                        width, self.rng.uniform(8.0, 10.0), centre + side * (CROSS_FACADE + setback), y, yaw_deg
                    )
            corner = (centre + arm * (CROSS_KERB + 0.5), arm * -(KERB + 0.5), KERB_HEIGHT)
            self._place("Signs", "Sign", "Sign_triangle", corner, 90.0 * arm)
            heading = 90.0 * arm
            self._place("Cars", "Car", "Hatchback", (centre + arm * 2.0, -arm * 14.0, 0.0), heading)

    def _kerb_line(self, start: float, side: int) -> None:
        """Along one kerb of one block: lamps, trees, signs and bins on the pavement, parked cars in the strip."""
        rng = self.rng
        for slot in range(9):
            x = start + 4.0 + 8.5 * slot
            if self._near_zebra(x, 3.0):
                continue
            y, z = side * (KERB + 0.6), KERB_HEIGHT
            if slot % 4 == (0 if side > 0 else 2):
                self._place("Lamps", "Lamp", "Lamp", (x, y, z), 0.0 if side > 0 else 180.0)
                continue
            choice = rng.choice(["tree", "sign", "bin", "none"], p=[0.6, 0.15, 0.1, 0.15])
            if choice == "tree":
                model = f"Tree_{rng.integers(3)}"
                self._place("Trees", "Tree", model, (x, y, z), float(rng.integers(0, 360)))
            elif choice == "sign":
                model = f"Sign_{rng.choice(['round', 'triangle', 'panel'])}"
                # Signs face oncoming traffic, which on the south side (y < 0) drives towards +x.
                self._place("Signs", "Sign", model, (x, y, z), 180.0 if side > 0 else 0.0)
            elif choice == "bin":
                self._place("Bins", "Bin", "Bin", (x, y, z))
        for slot in range(11):
            x = start + 7.0 + 6.2 * slot + rng.uniform(-0.3, 0.3)
            free = rng.random() < 0.4 or self._near_zebra(x, 8.0)
            model = str(rng.choice(["Saloon", "Hatchback", "Van"], p=[0.45, 0.4, 0.15]))
            offset, skew = rng.uniform(-0.08, 0.08), rng.integers(-2, 2, endpoint=True)
            if not free:
                heading = float(skew) + (180.0 if side > 0 else 0.0)
                self._place("Cars", "Car", model, (x, side * (LANE + 0.96 + offset), 0.0), heading)

    def _near_zebra(self, x: float, distance: float) -> bool:
        return any(abs(x - zebra) < distance for zebra in self.zebras)

    def _zebra(self, x: float) -> None:
        """Bollards and signs at a pedestrian crossing, and someone on it."""
        for side in (1, -1):
            for offset in (-2.0, 2.0):
                self._place("Bollards", "Bollard", "Bollard", (x + offset, side * (KERB + 0.35), KERB_HEIGHT))
            sign_at = (x + 2.4 * side, side * (KERB + 0.5), KERB_HEIGHT)
            self._place("Signs", "Sign", "Sign_panel", sign_at, 180.0 if side > 0 else 0.0)
        crossing_at = (x + self.rng.uniform(-0.8, 0.8), self.rng.uniform(-3.0, 3.0), TORSO_HEIGHT)
        self._place(
            "People", "Pedestrian", "Pedestrian", crossing_at, 90.0, (0.0, self.rng.uniform(1.0, 1.6)),
            PEDESTRIAN_RCS_DBSM,
        )  # fmt: skip

    def _traffic(self) -> None:
        """Cars in both lanes with at least 12 m between their centres, and cyclists at the lanes' right edges."""
        rng = self.rng
        for direction in (1, -1):
            x = -self.half_length + rng.uniform(5.0, 25.0)
            while x < self.half_length:
                model = str(rng.choice(["Saloon", "Hatchback", "Van"], p=[0.45, 0.4, 0.15]))
                speed = rng.uniform(6.0, 13.5)
                if not self._near_zebra(x, 5.0):
                    place = (x, -direction * 0.5 * LANE, 0.0)
                    self._place("Cars", "Car", model, place, 0.0 if direction > 0 else 180.0, (direction * speed, 0.0))
                x += rng.uniform(22.0, 45.0)
            for start in self.block_starts:
                x = start + rng.uniform(5.0, BLOCK_LENGTH - 5.0)
                self._place(
                    "People", "Cyclist", "Cyclist", (x, -direction * 3.05, RIDER_HEIGHT),
                    0.0 if direction > 0 else 180.0, (direction * rng.uniform(3.5, 6.5), 0.0), CYCLIST_RCS_DBSM,
                )  # fmt: skip

    def _people(self) -> None:
        """Two walkers on either pavement of each block, between the row of trees and the facades."""
        rng = self.rng
        for start in self.block_starts:
            for side, _ in np.ndindex(2, 2):
                y = (1 - 2 * side) * rng.uniform(KERB + 1.3, FACADE - 0.4)
                direction = int(rng.choice([-1, 1]))
                x = start + rng.uniform(2.0, BLOCK_LENGTH - 2.0)
                self._place(
                    "People", "Pedestrian", "Pedestrian", (x, y, KERB_HEIGHT + TORSO_HEIGHT),
                    0.0 if direction > 0 else 180.0, (direction * rng.uniform(0.8, 1.7), 0.0), PEDESTRIAN_RCS_DBSM,
                )  # fmt: skip


_CROSS_PROFILE = (
    (-CROSS_FACADE, "block"),
    (-CROSS_KERB, "walk"),
    (CROSS_KERB, "cross"),
    (CROSS_FACADE, "walk"),
)
"""Cross section of a cross street: at each offset from its centre [m], the use of the ground west of it."""
