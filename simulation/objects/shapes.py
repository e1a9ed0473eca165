"""Closed meshes with vertices at most a few decimetres apart: ultrasonic sensors use the nearest one."""

import math

import numpy as np

from geometry.arrays import Float64, Int32
from simulation.environment.lofting import Keys, loft
from simulation.environment.meshes import Mesh

MAX_CELLS = 12  # of a box along one axis


def block(low_m: tuple[float, float, float], high_m: tuple[float, float, float], cell_m: float = 0.3) -> Mesh:
    """An axis-aligned box of cells of about `cell_m`."""
    low, size = np.array(low_m), np.subtract(high_m, low_m)
    counts = [min(max(1, math.ceil(extent / cell_m)), MAX_CELLS) for extent in size]
    corners, triangles = _surface(counts)
    vertices = low + size * corners / np.array(counts)
    return Mesh(vertices.astype(np.float32), triangles)


def _surface(counts: list[int]) -> tuple[Float64, Int32]:
    """Lattice points (N, 3) on the surface of a box of cells, and its triangles (M, 3)."""
    index: dict[tuple[int, ...], int] = {}
    triangles = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for end in (0, counts[axis]):
            for i in range(counts[u]):
                for j in range(counts[v]):
                    square = []
                    for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
                        at = [0, 0, 0]
                        at[axis], at[u], at[v] = end, i + a, j + b
                        square.append(index.setdefault(tuple(at), len(index)))
                    p, q, r, s = square if end else square[::-1]
                    triangles += [(p, q, r), (p, r, s)]
    return np.array(list(index), np.float64), np.array(triangles, np.int32)


def rod(
    a_m: tuple[float, float, float], b_m: tuple[float, float, float], radius_m: float, sides: int = 8, rings: int = 4,
    end_radius_m: float | None = None,
) -> Mesh:  # fmt: skip
    """A round rod between two points, tapered towards `end_radius_m`."""
    share = np.linspace(0.0, 1.0, max(rings, 2))
    line = np.outer(1.0 - share, a_m) + np.outer(share, b_m)
    radius = (1.0 - share) * radius_m + share * (radius_m if end_radius_m is None else end_radius_m)
    keys: Keys = tuple((*map(float, p), float(r), float(r)) for p, r in zip(line, radius, strict=True))  # type: ignore[misc]
    direction = np.subtract(b_m, a_m)
    aside = (1.0, 0.0, 0.0) if abs(direction[1]) > 0.9 * np.linalg.norm(direction) else (0.0, 1.0, 0.0)
    return loft(keys, sides, max(rings, 2), aside)
