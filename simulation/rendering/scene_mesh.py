"""Triangles with normals, colours and materials, and a grid that finds them by place."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from geometry.arrays import Float32, Float64, Int32, UInt8
from simulation.environment.meshes import Mesh


class Material(IntEnum):
    """Material of a triangle: texture and reflection."""

    SMOOTH = 0
    SOIL = 1
    GRASS = 2
    GRAVEL = 3
    LEAF = 4
    WOOD = 5
    METAL = 6
    GLOSS = 7
    GLASS = 8
    CLOTH = 9
    FUR = 10
    BARK = 11


@dataclass(frozen=True)
class Surface:
    """In `map`: `vertices_m`, unit `normals` and linear `colors` (RGB, 0 to 1), (N, 3) each; `triangles` (M, 3).

    `materials` (M,) of `Material`; `cutouts` (M,) 1 blades, 2 leaves, 0 none.
    """

    vertices_m: Float32
    normals: Float32
    colors: Float32
    triangles: Int32
    materials: UInt8
    cutouts: UInt8

    def transformed(self, T: Float64) -> "Surface":
        """The surface after a rigid transform."""
        R = T[:3, :3].astype(np.float32)
        vertices = self.vertices_m @ R.T + T[:3, 3].astype(np.float32)
        return Surface(vertices, self.normals @ R.T, self.colors, self.triangles, self.materials, self.cutouts)


def surface_of(mesh: Mesh, color: Float64, material: Material, cutout: int = 0, is_flat: bool = False) -> Surface:
    """A mesh of one material; `color` (3,) or (N, 3). With `is_flat` corners have the normal of their triangle."""
    m = len(mesh.triangles)
    colors = np.broadcast_to(color, mesh.vertices_m.shape).astype(np.float32)
    if is_flat:
        rows = mesh.triangles.ravel()
        mesh, colors = Mesh(mesh.vertices_m[rows], np.arange(3 * m, dtype=np.int32).reshape(-1, 3)), colors[rows]
    kinds = np.full(m, material, np.uint8)
    return Surface(mesh.vertices_m, normals_of(mesh), colors, mesh.triangles, kinds, np.full(m, cutout, np.uint8))


def normals_of(mesh: Mesh) -> Float32:
    """Unit normals (N, 3) at the vertices: area-weighted mean of the adjacent triangles."""
    a, b, c = (mesh.vertices_m[mesh.triangles[:, k]] for k in range(3))
    face = np.cross(b - a, c - a)
    total = np.zeros_like(mesh.vertices_m)
    for k in range(3):
        np.add.at(total, mesh.triangles[:, k], face)
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12), np.float32)


def merge(surfaces: list[Surface]) -> Surface:
    """All surfaces as one."""
    offsets = np.cumsum([0] + [len(s.vertices_m) for s in surfaces[:-1]])
    triangles = [s.triangles + np.int32(o) for s, o in zip(surfaces, offsets, strict=True)]
    return Surface(
        np.concatenate([s.vertices_m for s in surfaces]), np.concatenate([s.normals for s in surfaces]),
        np.concatenate([s.colors for s in surfaces]), np.concatenate(triangles).astype(np.int32),
        np.concatenate([s.materials for s in surfaces]), np.concatenate([s.cutouts for s in surfaces]),
    )  # fmt: skip


def arrays_of(surface: Surface) -> tuple[Float32, Float32, Float32, Int32, UInt8, UInt8]:
    """All arrays, in the order of the fields."""
    s = surface
    return s.vertices_m, s.normals, s.colors, s.triangles, s.materials, s.cutouts


class TriangleGrid:
    """Triangles of a surface by square ground cells."""

    def __init__(self, surface: Surface, side_m: float) -> None:
        middle = surface.vertices_m[surface.triangles].mean(axis=1)[:, :2]
        cell = np.floor(middle / side_m).astype(np.int64)
        key = (cell[:, 0] - cell[:, 0].min()) * 100_000 + cell[:, 1] - cell[:, 1].min()
        order = np.argsort(key, kind="stable")
        _, first = np.unique(key[order], return_index=True)
        self._groups = [g.astype(np.int32) for g in np.split(order, first[1:])]
        corners = [surface.vertices_m[surface.triangles[g]].reshape(-1, 3)[:, :2] for g in self._groups]
        low, high = np.array([c.min(axis=0) for c in corners]), np.array([c.max(axis=0) for c in corners])
        self._middle, self._radius = 0.5 * (low + high), 0.5 * np.linalg.norm(high - low, axis=1)

    def within(self, p_map_m: Float64, within_m: float, ahead: Float64 | None = None, half_angle: float = 0.0) -> Int32:
        """Triangles within a distance of a point and, if given, within `half_angle` of the direction `ahead` (2,)."""
        to = self._middle - p_map_m[:2]
        distance = np.linalg.norm(to, axis=1)
        is_near = distance - self._radius < within_m
        if ahead is not None:
            # a disc is outside a wedge when its centre is farther than its radius beyond either edge
            u, v = to @ ahead, np.abs(to @ np.array([-ahead[1], ahead[0]]))
            is_near &= v * np.cos(half_angle) - u * np.sin(half_angle) < self._radius
        rows = np.flatnonzero(is_near)
        # near cells first: triangles behind them then fail the depth test
        rows = rows[np.argsort(distance[rows], kind="stable")]
        return np.concatenate([self._groups[k] for k in rows]) if len(rows) else np.zeros(0, np.int32)
