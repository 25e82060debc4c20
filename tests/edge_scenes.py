"""Edges of scenes, and the exact lengths of ways over them."""

import numpy as np
from scipy.optimize import minimize_scalar
from sionna_scenes import WAVELENGTH_M

from datafactory.paths.edges import WedgeEdges
from datafactory.scenes.poses import Pose

WAVENUMBER = 2.0 * np.pi / WAVELENGTH_M
HOME = Pose((0.0, 0.0, 0.0))
RADAR = np.zeros(3)


def only_edge_at(edges: WedgeEdges, point) -> WedgeEdges:
    away = np.linalg.norm(np.cross(edges.direction, np.array(point) - edges.start), axis=1)
    return edges.take(away < 1e-6)


def shortest_over(edge: WedgeEdges, tx: np.ndarray, rx: np.ndarray) -> float:
    """Fermat, by search along the edge's line."""

    def length(z: float) -> float:
        point = edge.start[0] + z * edge.direction[0]
        return float(np.linalg.norm(tx - point) + np.linalg.norm(rx - point))

    return float(minimize_scalar(length, bracket=(0.0, 1.0), tol=1e-12).fun)
