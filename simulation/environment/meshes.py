"""Triangle meshes of simple solids; every solid is closed."""

import math
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float32, Float64, Int32
from geometry.transforms import apply

_BOX_TRIANGLES = np.array(
    [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6],
     [3, 0, 4], [3, 4, 7]], np.int32)  # fmt: skip


@dataclass(frozen=True)
class Mesh:
    """`vertices_m` (N, 3) float32 and `triangles` (M, 3) into them."""

    vertices_m: Float32
    triangles: Int32

    def transformed(self, T: Float64) -> "Mesh":
        """The mesh after a rigid transform."""
        return Mesh(apply(T, self.vertices_m).astype(np.float32), self.triangles)


def join(meshes: list[Mesh]) -> Mesh:
    """All meshes as one."""
    offsets = np.cumsum([0] + [len(m.vertices_m) for m in meshes[:-1]])
    triangles = [m.triangles + np.int32(o) for m, o in zip(meshes, offsets, strict=True)]
    return Mesh(np.concatenate([m.vertices_m for m in meshes]), np.concatenate(triangles).astype(np.int32))


def box(low_m: tuple[float, float, float], high_m: tuple[float, float, float]) -> Mesh:
    """An axis-aligned box."""
    (x0, y0, z0), (x1, y1, z1) = low_m, high_m
    bottom = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
    corners = [[x, y, z0] for x, y in bottom] + [[x, y, z1] for x, y in bottom]
    return Mesh(np.array(corners, np.float32), _BOX_TRIANGLES)


def limb(
    top_m: tuple[float, float, float], bottom_m: tuple[float, float, float], radius_m: float, sides: int = 6
) -> Mesh:
    """A prism between two points."""
    a, b = np.array(top_m), np.array(bottom_m)
    axis = (b - a) / np.linalg.norm(b - a)
    aside = np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.9 else [0.0, 1.0, 0.0])
    aside /= np.linalg.norm(aside)
    turn = 2.0 * math.pi * np.arange(sides) / sides
    ring = radius_m * (np.cos(turn)[:, None] * aside + np.sin(turn)[:, None] * np.cross(axis, aside))
    vertices = np.concatenate([a + ring, b + ring, [a, b]]).astype(np.float32)
    return Mesh(vertices, _prism_triangles(sides))


def _prism_triangles(sides: int) -> Int32:
    k = np.arange(sides)
    n = (k + 1) % sides
    top, bottom = np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    faces = [[k, n, k + sides], [n, n + sides, k + sides], [top, n, k], [bottom, k + sides, n + sides]]
    return np.concatenate([np.stack(f, axis=1) for f in faces]).astype(np.int32)


def ellipsoid(center_m: tuple[float, float, float], size_m: tuple[float, float, float], sides: int = 8) -> Mesh:
    """An ellipsoid by its full axes: rings of `sides` corners between two poles."""
    polar = math.pi * np.arange(1, sides // 2) / (sides // 2)
    around = 2.0 * math.pi * np.arange(sides) / sides
    rings = np.stack([
        np.outer(np.sin(polar), np.cos(around)), np.outer(np.sin(polar), np.sin(around)),
        np.outer(np.cos(polar), np.ones(sides)),
    ], axis=-1).reshape(-1, 3)  # fmt: skip
    unit = np.concatenate([rings, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])
    vertices = np.array(center_m) + 0.5 * np.array(size_m) * unit
    return Mesh(vertices.astype(np.float32), _ellipsoid_triangles(sides, len(polar)))


def _ellipsoid_triangles(sides: int, rings: int) -> Int32:
    k = np.arange(sides)
    n = (k + 1) % sides
    north, south = np.full(sides, rings * sides), np.full(sides, rings * sides + 1)
    faces = [
        np.stack([north, k, n], axis=1),
        np.stack([south, n + (rings - 1) * sides, k + (rings - 1) * sides], axis=1),
    ]
    for r in range(rings - 1):
        low, high = r * sides, (r + 1) * sides
        faces += [np.stack([k + low, k + high, n + low], axis=1), np.stack([n + low, k + high, n + high], axis=1)]
    return np.concatenate(faces).astype(np.int32)


def grid(xyz_m: Float64) -> Mesh:
    """A surface over a regular grid of points (rows, columns, 3)."""
    rows, columns = xyz_m.shape[:2]
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    lower = np.stack([first, first + columns, first + 1], axis=1)
    upper = np.stack([first + 1, first + columns, first + columns + 1], axis=1)
    return Mesh(xyz_m.reshape(-1, 3).astype(np.float32), np.concatenate([lower, upper]).astype(np.int32))
