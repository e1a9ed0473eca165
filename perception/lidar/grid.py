"""Polar grid about a sensor: cell of each return, and heights interpolated from a surface on the grid."""

import math
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float32, Float64, Int32, UInt8
from geometry.fast_angle import azimuth_of
from geometry.jit import kernel

TABLE_M = 0.25  # resolution of the table from range to bin
ZERO, ONE = np.float32(0.0), np.float32(1.0)
MAX_GRID_POINTS = 40_000  # returns that suffice for the ground of a scan; above it every second, third … is used


@dataclass(frozen=True)
class Grid:
    """Sectors by bins: `bin_table` maps range / TABLE_M to fractional bins, `range_m` are bin centres."""

    sectors: int
    bins: int
    bin_table: Float64
    range_m: Float64


def build_grid(sector_deg: float, first_bin_m: float, bin_growth: float, max_range_m: float) -> Grid:
    """Grid with bins `first_bin_m` wide at the sensor that widen by `bin_growth` per metre."""
    ranges = np.arange(0.0, max_range_m + 2 * TABLE_M, TABLE_M)
    growth = max(bin_growth, 1e-6)
    table = np.log1p(growth * ranges / first_bin_m) / math.log1p(growth)
    bins = int(table[-2]) + 1
    centers = first_bin_m / growth * (np.exp((np.arange(bins) + 0.5) * math.log1p(growth)) - 1.0)
    return Grid(round(360.0 / sector_deg), bins, table, centers)


def sort_into_cells(
    points_base_m: Float32, usable: UInt8, center_m: Float64, grid: Grid
) -> tuple[Float32, Int32, Float32]:
    """Fractional sector and bin (N, 2) of each return (bin -1: outside), and heights sorted by cell.

    The heights of cell c are `z[starts[c]:starts[c + 1]]`, c = sector * bins + bin.
    """
    n = len(points_base_m)
    polar = np.empty((n, 2), np.float32, order="F")
    starts = np.zeros(grid.sectors * grid.bins + 1, np.int32)
    z = np.empty(n, np.float32)
    center, table = center_m.astype(np.float32), grid.bin_table.astype(np.float32)
    _to_polar(points_base_m, center, np.float32(grid.sectors / (2.0 * math.pi)), polar)
    _sort_into_cells(points_base_m, usable, table, grid.sectors, grid.bins, polar, starts, z)
    return polar, starts, z


@kernel
def _to_polar(points: Float32, center: Float32, scale: np.float32, polar: Float32) -> None:
    """Azimuth (atan2 to 2e-4 rad, in sectors) and horizontal range of each return, without branches."""
    for i in range(points.shape[0]):
        x, y = points[i, 0] - center[0], points[i, 1] - center[1]
        polar[i, 0] = azimuth_of(x, y) * scale
        polar[i, 1] = np.sqrt(x * x + y * y)


@kernel
def _sort_into_cells(
    points: Float32, usable: UInt8, bin_table: Float32, sectors: int, bins: int, polar: Float32, starts: Int32,
    z: Float32,
) -> None:  # fmt: skip
    """Replaces ranges in `polar` by bins and sorts every stride-th return by cell."""
    n = points.shape[0]
    stride = max(1, n // MAX_GRID_POINTS)
    cells = np.full(n // stride + 1, -1, np.int32)
    limit, steps = np.float32((bin_table.shape[0] - 2) * TABLE_M), np.float32(1.0 / TABLE_M)
    # rounding must not leave the last sector
    end = np.float32(sectors - 1e-3)
    for i in range(n):
        s, r = polar[i, 0], polar[i, 1]
        inside = usable[i] != 0 and r < limit
        kept = s if usable[i] != 0 and ZERO <= s < end else ZERO
        polar[i, 0] = min(s, end) if inside else kept
        at = r * steps if inside else ZERO
        k = np.uint32(at)
        b = bin_table[k] + (at - np.float32(k)) * (bin_table[k + 1] - bin_table[k])
        polar[i, 1] = b if inside else -ONE
    for j in range((n + stride - 1) // stride):
        s, b = polar[j * stride, 0], polar[j * stride, 1]
        if b >= 0.0:
            cells[j] = min(int(s), sectors - 1) * bins + min(int(b), bins - 1)
            starts[cells[j] + 1] += 1
    for c in range(starts.shape[0] - 1):
        starts[c + 1] += starts[c]
    fill = starts[:-1].copy()
    for j in range(cells.shape[0]):
        if cells[j] >= 0:
            z[fill[cells[j]]] = points[j * stride, 2]
            fill[cells[j]] += 1


def heights_above(points_base_m: Float32, polar: Float32, surface_m: Float64) -> Float32:
    """Height (N,) of each return above a surface (sectors, bins), bilinear between cell centres; NaN outside."""
    above = np.empty(len(points_base_m), np.float32)
    # one more sector at either end closes the circle without a modulo
    closed = np.concatenate([surface_m[-1:], surface_m, surface_m[:1]]).astype(np.float32)
    _heights(points_base_m, polar, closed.reshape(-1), surface_m.shape[1], above)
    return above


@kernel
def _heights(points: Float32, polar: Float32, surface: Float32, bins: int, above: Float32) -> None:
    one, half, last, width = np.float32(1.0), np.float32(0.5), np.uint32(bins - 2), np.uint32(bins)
    for i in range(points.shape[0]):
        s, b = polar[i, 0] + half, max(polar[i, 1] - half, ZERO)
        k, j = np.uint32(s), min(np.uint32(b), last)
        u, v = s - np.float32(k), min(b - np.float32(j), one)
        c = k * width + j
        near = (one - u) * surface[c] + u * surface[c + width]
        far = (one - u) * surface[c + np.uint32(1)] + u * surface[c + width + np.uint32(1)]
        h = points[i, 2] - ((one - v) * near + v * far)
        above[i] = h if polar[i, 1] >= ZERO else np.float32(np.nan)


@kernel
def take_rows(points: Float32, indices: Int32) -> Float32:
    """`points[indices]`, row by row: numpy takes five times as long on column-major points."""
    out = np.empty((indices.shape[0], 3), np.float32)
    for n in range(indices.shape[0]):
        i = indices[n]
        out[n, 0], out[n, 1], out[n, 2] = points[i, 0], points[i, 1], points[i, 2]
    return out
