"""Ground under scattered returns: a surface through their low parts that follows waves, but no compact object on it."""

import math

import numpy as np

from geometry.arrays import Float32, Float64, Int64
from geometry.jit import inline_kernel, kernel

REACH = 3  # cells over which a lower place lowers the surface


@kernel
def heights_above_ground(
    xyz: Float32, corner_m: tuple[float, float], shape: tuple[int, int], cell_m: float, quantile: float, slope: float,
    residual_slope: float,
    ground_limit_m: float,
) -> tuple[Float64, Float64]:  # fmt: skip
    """Height (N,) of each return (3, N) above the surface through the low returns of the cells around it, and the
    second largest height below `ground_limit_m` in each cell with at least three such returns (M,).

    The grid of `shape` cells begins at `corner_m`; returns beyond it belong to its outermost cells. The low `quantile`
    of each cell may rise by `slope` (rise over run) from its lowest neighbour; the mean of 3 x 3 cells of that is the
    trend. The same of the rest, with `residual_slope`, is what remains of the ground.
    """
    rows, columns = shape
    count = xyz.shape[1]
    cell = np.empty(count, np.int64)
    for k in range(count):
        row = min(max(int((xyz[0, k] - corner_m[0]) / cell_m), 0), rows - 1)
        column = min(max(int((xyz[1, k] - corner_m[1]) / cell_m), 0), columns - 1)
        cell[k] = row * columns + column
    begin = np.zeros(rows * columns + 1, np.int64)
    for k in range(count):
        begin[cell[k] + 1] += 1
    begin = np.cumsum(begin)
    place, filled = np.empty(count, np.int64), begin[:-1].copy()
    for k in range(count):
        place[k] = filled[cell[k]]
        filled[cell[k]] += 1
    height, by_cell = np.empty(count, np.float64), np.empty(count, np.float64)
    for k in range(count):
        height[k] = xyz[2, k]
        by_cell[place[k]] = height[k]
    trend = _smoothed(_envelope(_low(by_cell, begin, quantile, rows, columns), slope * cell_m))
    for k in range(count):
        height[k] -= _interpolated(
            trend, (xyz[0, k] - corner_m[0]) / cell_m - 0.5, (xyz[1, k] - corner_m[1]) / cell_m - 0.5
        )
        by_cell[place[k]] = height[k]
    rest = _envelope(_low(by_cell, begin, quantile, rows, columns), residual_slope * cell_m)
    for k in range(count):
        height[k] -= rest[cell[k] // columns, cell[k] % columns]
        by_cell[place[k]] = height[k]
    return height, _second_largest(by_cell, begin, ground_limit_m)


@inline_kernel
def _low(by_cell: Float64, begin: Int64, quantile: float, rows: int, columns: int) -> Float64:
    """Low quantile of the heights `by_cell[begin[c]:begin[c + 1]]` of each cell c; infinite in an empty one."""
    low = np.full((rows, columns), np.inf)
    for here in range(rows * columns):
        count = begin[here + 1] - begin[here]
        if count > 0:
            some = np.sort(by_cell[begin[here] : begin[here + 1]])
            low[here // columns, here % columns] = some[int(quantile * count)]
    return low


@inline_kernel
def _second_largest(by_cell: Float64, begin: Int64, limit: float) -> Float64:
    """Second largest value below the limit of each cell that has at least three."""
    found = np.empty(len(begin) - 1, np.float64)
    used = 0
    for here in range(len(begin) - 1):
        largest, second, count = -np.inf, -np.inf, 0
        for k in range(begin[here], begin[here + 1]):
            value = by_cell[k]
            if value < limit:
                count += 1
                second = max(second, min(value, largest))
                largest = max(largest, value)
        if count >= 3:
            found[used] = second
            used += 1
    return found[:used]


@inline_kernel
def _envelope(low: Float64, rise_m: float) -> Float64:
    """The greatest surface at or below `low` that rises by at most `rise_m` per cell within reach."""
    rows, columns = low.shape
    out = low.copy()
    for row in range(rows):
        for column in range(columns):
            for i in range(max(row - REACH, 0), min(row + REACH + 1, rows)):
                for j in range(max(column - REACH, 0), min(column + REACH + 1, columns)):
                    above = low[i, j] + rise_m * math.sqrt((i - row) ** 2 + (j - column) ** 2)
                    if above < out[row, column]:
                        out[row, column] = above
    return out


@inline_kernel
def _smoothed(surface: Float64) -> Float64:
    """Mean of the finite values of 3 x 3 cells; 0 where there is none."""
    rows, columns = surface.shape
    out = np.zeros((rows, columns))
    for row in range(rows):
        for column in range(columns):
            total, number = 0.0, 0
            for i in range(max(row - 1, 0), min(row + 2, rows)):
                for j in range(max(column - 1, 0), min(column + 2, columns)):
                    if surface[i, j] < np.inf:
                        total += surface[i, j]
                        number += 1
            if number > 0:
                out[row, column] = total / number
    return out


@inline_kernel
def _interpolated(surface: Float64, row: float, column: float) -> float:
    """Bilinear interpolation between the centres of the cells; constant beyond them."""
    rows, columns = surface.shape
    row, column = min(max(row, 0.0), rows - 1.001), min(max(column, 0.0), columns - 1.001)
    i, j = int(row), int(column)
    a, b = row - i, column - j
    near = (1.0 - b) * surface[i, j] + b * surface[i, j + 1]
    far = (1.0 - b) * surface[i + 1, j] + b * surface[i + 1, j + 1]
    return float((1.0 - a) * near + a * far)
