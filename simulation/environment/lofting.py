r"""Lofted bodies: cross-sections along a line, at two levels of detail that differ by less than 2 cm.

keys:  x, y, z of the centre,  half the size across (up or ahead),  half the size along `aside`
    _____
   /  |  \         a section is |u|^p + |v|^p = 1: p = 2 is an ellipse, larger p approaches a rectangle
  |---+---| u     keys are joined by monotone cubics (no overshoot): few keys make a smooth limb
   \__|__/
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from geometry.arrays import Float64, Int32
from simulation.environment.meshes import Mesh

Keys = tuple[tuple[float, float, float, float, float], ...]


@dataclass(frozen=True)
class Part:
    """A closed mesh and its region (appearance), such as `skin`."""

    mesh: Mesh
    region: str


def loft(
    keys: Keys, sides: int, rings: int, aside: tuple[float, float, float] = (0.0, 1.0, 0.0), power: float = 2.0,
    axis: tuple[float, float, float] | None = None,
) -> Mesh:  # fmt: skip
    """A closed body through `keys`: `rings` sections of `sides` corners, normal to its line or to `axis`."""
    table = np.array(keys, np.float64)
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(table[:, :3], axis=0), axis=1))])
    # rings at the keys, the others spread evenly between them: ends stay round
    at = np.interp(np.linspace(0.0, len(s) - 1, max(rings, 2)), np.arange(len(s)), s)
    dense = np.asarray(PchipInterpolator(s, table)(at), np.float64)
    line = dense[:, :3] if axis is None else np.outer(np.arange(len(dense)), axis)
    u, v = _frames(line, np.array(aside, np.float64))
    turn = 2.0 * math.pi * (np.arange(sides) + 0.5) / sides
    across, along = (np.sign(f) * np.abs(f) ** (2.0 / power) for f in (np.cos(turn), np.sin(turn)))
    ring = (
        dense[:, None, :3]
        + (dense[:, 3, None] * across)[..., None] * u[:, None]
        + (dense[:, 4, None] * along)[..., None] * v[:, None]
    )
    vertices = np.concatenate([ring.reshape(-1, 3), dense[[0, -1], :3]])
    return Mesh(vertices.astype(np.float32), _triangles(sides, len(dense)))


def _frames(line: Float64, aside: Float64) -> tuple[Float64, Float64]:
    """Unit vectors (K, 3) of each section: across, in the plane of bending, and aside."""
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    u = np.cross(aside, tangent)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return u, np.cross(tangent, u)


def _triangles(sides: int, rings: int) -> Int32:
    k = np.arange(sides)
    n = (k + 1) % sides
    first, last = np.full(sides, rings * sides), np.full(sides, rings * sides + 1)
    end = (rings - 1) * sides
    faces = [np.stack([first, n, k], axis=1), np.stack([last, k + end, n + end], axis=1)]
    for r in range(rings - 1):
        low, high = r * sides, (r + 1) * sides
        faces += [np.stack([k + low, n + low, k + high], axis=1), np.stack([n + low, n + high, k + high], axis=1)]
    return np.concatenate(faces).astype(np.int32)


def blob(center: tuple[float, float, float], halves: tuple[float, float, float], sides: int, rings: int) -> Mesh:
    """An ellipsoid lofted along z."""
    (x, y, z), (a, b, c) = center, halves
    angle = np.linspace(-0.5 * math.pi, 0.5 * math.pi, max(rings, 5))
    keys = tuple((x, y, z + c * math.sin(t), max(a * math.cos(t), 1e-4), max(b * math.cos(t), 1e-4)) for t in angle)
    return loft(keys, sides, max(rings, 5))
