"""Every part of a city is closed, faces outwards, and has planar convex faces; prisms, terraces, panes in frames."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from datafactory.scenes.city import furniture
from datafactory.scenes.city.buildings import (
    DEPTHS,
    FRAME_RECESS,
    PANE_RECESS,
    SIDES,
    Building,
    Opening,
    bays,
    building,
)
from datafactory.scenes.city.shapes import Surface, framed_pane, prism, stepped_surface, welded

RNG = np.random.default_rng(3)


def as_mesh(surface: Surface) -> trimesh.Trimesh:
    return trimesh.Trimesh(surface.vertices, surface.triangles(), process=False)


def house(shape: str, glazed: tuple[str, ...], **fields: object) -> Building:
    ground = ("door", "shop", "gate", "wall") if "front" in glazed else ()
    return Building(11.3, 9.7, 3, shape=shape, glazed=frozenset(glazed), ground=ground, **fields)  # type: ignore[arg-type]


PARTS = {
    **{f"house {shape} {len(glazed)}": building(house(shape, glazed, bands=True, cornice=True))
       for shape in ("flat", "gable", "hip") for glazed in (("front",), SIDES, (), ("front", "left"))},
    "house balconies": building(house("flat", ("front",), balconies=((1, 0), (2, 2)))),
    **{name: furniture.car(shape) for name, shape in furniture.CAR_SHAPES.items()},
    "lorry": furniture.lorry(), "bus": furniture.bus(),
    "lamp": furniture.lamp_post(9.0), "bollard": furniture.bollard(), "bin": furniture.litter_bin(),
    **{f"sign {kind}": furniture.sign(kind) for kind in ("round", "triangle", "panel")},
    "tree": furniture.street_tree(RNG, 1.3), "conifer": furniture.conifer(RNG),
    "traffic light": furniture.traffic_light(), "guard rail": furniture.guard_rail(8.0, 4.0),
    "railing": furniture.pedestrian_rail(3.0), "barrier": furniture.barrier(6.0), "shelter": furniture.bus_shelter(),
    "manhole": furniture.manhole_cover(), "fence": furniture.fence(5.0), "container": furniture.container(),
    "tank": furniture.tank(3.0, 8.0), "gantry": furniture.gantry(14.0), "bench": furniture.bench(),
    "noise wall": furniture.noise_wall(4.0, 4.0, "wood"),
}  # fmt: skip


@pytest.mark.parametrize("name", PARTS)
def test_every_body_of_a_part_is_closed_and_faces_outwards(name: str) -> None:
    mesh = as_mesh(PARTS[name])
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.area_faces.min() > 1e-6
    for body in mesh.split(repair=False):
        assert body.volume > 0


@pytest.mark.parametrize("name", PARTS)
def test_fans_are_right_because_every_face_is_planar_and_convex(name: str) -> None:
    surface = PARTS[name]
    for face in surface.faces:
        corners = surface.vertices[list(face)]
        edges = np.roll(corners, -1, axis=0) - corners
        turns = np.cross(np.roll(edges, 1, axis=0), edges)
        normal = turns.sum(axis=0) / np.linalg.norm(turns.sum(axis=0))
        assert np.all(turns @ normal > 0)
        # Vertices are kept to the millimetre, which bends a face by about as much.
        assert np.abs((corners - corners[0]) @ normal).max() < 2e-3


@pytest.mark.parametrize("shape", ["flat", "gable", "hip"])
def test_a_building_holds_its_walls_and_roof_less_its_recesses(shape: str) -> None:
    style = Building(12.0, 10.0, 2, shape=shape, glazed=frozenset({"front", "back"}), ground=("door",))
    opening, count = style.opening, style.bays
    assert count == bays(12.0, Opening()) == 4
    window = opening.width * (opening.head - opening.sill)
    pane = (opening.width - 0.14) * (opening.head - opening.sill - 0.14)
    recesses = (4 * count - 1) * (window * FRAME_RECESS + pane * PANE_RECESS)
    door = opening.width * (opening.head - style.base_m) * DEPTHS["door"]
    rise = 0.5 * style.depth * style.pitch
    roofs = {"flat": 0.0, "gable": 0.5 * style.depth * rise * style.width}
    # A hip roof: a prism between the ends of its ridge, and at each end a pyramid of half the depth.
    ridge = style.width - style.depth
    roofs["hip"] = 0.5 * style.depth * rise * ridge + style.depth * style.depth * rise / 3.0
    expected = style.width * style.depth * style.eaves + roofs[shape] - recesses - door
    assert as_mesh(building(style)).volume == pytest.approx(expected, abs=0.05)


def test_crowns_leave_room_for_lorries() -> None:
    tallest = furniture.lorry().vertices[:, 2].max()
    for radius in (1.0, 1.4):
        tree = furniture.street_tree(np.random.default_rng(0), radius)
        crown = {
            vertex
            for face, key in zip(tree.faces, tree.materials, strict=True)
            if key == "vegetation"
            for vertex in face
        }
        assert tree.vertices[list(crown), 2].min() >= tallest
        assert np.linalg.norm(tree.vertices[list(crown), :2], axis=1).max() <= 1.2 * radius + 1e-3


def test_prism_volume_and_outward_normals() -> None:
    mesh = as_mesh(prism([(0, 0), (3, 0), (0, 2)], 1.0, 5.0, "metal"))
    assert mesh.volume == pytest.approx(12.0)


def test_stepped_surface_adds_the_kerb_to_the_flat_area() -> None:
    polygons = stepped_surface([0.0, 2.0, 5.0], [0.0, 4.0], [[0.0], [0.12]], lambda i, j: ("asphalt", "concrete")[i])
    mesh = as_mesh(welded(polygons))
    assert mesh.area == pytest.approx(5.0 * 4.0 + 0.12 * 4.0)
    kerb = np.isclose(mesh.face_normals[:, 0], -1.0)
    assert kerb.sum() == 2
    assert np.all(mesh.face_normals[~kerb, 2] > 0.99)
    assert [polygon.material for polygon in polygons].count("concrete") == 2


def test_framed_pane_lies_behind_its_outline_by_the_recess() -> None:
    outline = np.array([(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (2.0, 0.0, 1.0), (0.0, 0.0, 1.0)])  # normal -y
    panes = [item for item in framed_pane(outline, 0.1, 0.05, "wood", "glass") if item.material == "glass"]
    assert len(panes) == 1
    assert panes[0].corners == pytest.approx(
        np.array([(0.1, 0.05, 0.1), (1.9, 0.05, 0.1), (1.9, 0.05, 0.9), (0.1, 0.05, 0.9)])
    )
