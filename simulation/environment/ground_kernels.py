"""Compiled kernel: height of the features of the ground that a scenario adds."""

import math

from geometry.arrays import Float64
from geometry.jit import kernel

# columns of a feature: kind, a point and the unit vector across it, height, and three numbers of the kind
WAVES, CREST, SLOPE, FURROWS, RUTS, BANK = 0.0, 1.0, 2.0, 3.0, 4.0, 5.0
COLUMNS = 9
EDGE_M = 2.0  # furrows and ruts begin gradually at the edge of the field
BEND_M = 8.0  # a side slope begins gradually


@kernel
def feature_height(x: float, y: float, features: Float64, field: Float64) -> float:
    """Sum of the features (N, COLUMNS) at a point; `field` (K, 2): corners of the field.

    WAVES: length, phase. CREST: length from foot to foot. SLOPE: tangent as height. FURROWS: spacing. RUTS: width,
    track, spacing of the pairs. BANK: width of its face.
    """
    z = 0.0
    for i in range(features.shape[0]):
        kind, x0, y0, nx, ny, a, p, q, r = features[i]
        s = (x - x0) * nx + (y - y0) * ny
        if kind == WAVES:
            z += a * math.sin(2.0 * math.pi / p * s + q)
        elif kind == CREST:
            if abs(s) < 0.5 * p:
                z += 0.5 * a * (1.0 + math.cos(2.0 * math.pi / p * s))
        elif kind == SLOPE:
            if s > 0.0:
                z += a * (s * s / (2.0 * BEND_M) if s < BEND_M else s - 0.5 * BEND_M)
        elif kind == FURROWS:
            z += a * within(x, y, field) * math.sin(2.0 * math.pi / p * s)
        elif kind == BANK:
            z -= 0.5 * a * (1.0 - math.cos(math.pi * min(max(s / p, 0.0), 1.0)))
        else:
            off = abs(abs(s - r * math.floor(s / r + 0.5)) - 0.5 * q)
            if off < 0.5 * p:
                z -= 0.5 * a * within(x, y, field) * (1.0 + math.cos(2.0 * math.pi / p * off))
    return z


@kernel
def within(x: float, y: float, field: Float64) -> float:
    """0 outside a polygon (K, 2), rising to 1 at `EDGE_M` inside."""
    inside, square, n = False, EDGE_M * EDGE_M, field.shape[0]
    for i in range(n):
        x1, y1, x2, y2 = field[i, 0], field[i, 1], field[(i + 1) % n, 0], field[(i + 1) % n, 1]
        dx, dy = x2 - x1, y2 - y1
        share = ((x - x1) * dx + (y - y1) * dy) / max(dx * dx + dy * dy, 1e-12)
        share = min(max(share, 0.0), 1.0)
        square = min(square, (x - x1 - share * dx) ** 2 + (y - y1 - share * dy) ** 2)
        if (y1 > y) != (y2 > y) and x < x1 + dx * (y - y1) / dy:
            inside = not inside
    depth = math.sqrt(square) / EDGE_M
    return depth * depth * (3.0 - 2.0 * depth) if inside else 0.0
