"""Ground under scattered returns: a surface through their low parts that follows waves, but no compact object on it."""

import math

import numpy as np

from geometry.arrays import Bool, Float32, Float64, Int32, Int64
from geometry.jit import inline_kernel, kernel

REACH = 3  # cells over which a lower place lowers the surface
PIT_M, PIT_REACH = 0.3, 2  # depth of reflections below the ground, and cells about them that show it
RANKS = 32  # up to this rank a quantile is found in one pass


@kernel
def heights_above_ground(
    xyz: Float32, corner_m: tuple[float, float], shape: tuple[int, int], cell_m: float, quantile: float, slope: float,
    residual_slope: float,
    ground_limit_m: float,
) -> tuple[Float64, Float64]:  # fmt: skip
    """Height (N,) of each return (3, N) above the surface through the low returns of the cells around it, and the
    tops (3, R, C) of the cells: second largest z, height, and height below `ground_limit_m`; infinite where there are
    fewer than three.

    The grid of `shape` cells begins at `corner_m`; returns beyond it belong to its outermost cells. The low `quantile`
    of each cell, without pits, may rise by `slope` (rise over run) from its lowest neighbour; the mean of 3 x 3 cells
    of that is the trend. The same of the rest, with `residual_slope`, is what remains of the ground.
    """
    rows, columns = shape
    count = xyz.shape[1]
    cell, at = np.empty(count, np.int64), np.empty((count, 2))
    for k in range(count):
        at[k, 0], at[k, 1] = (xyz[0, k] - corner_m[0]) / cell_m, (xyz[1, k] - corner_m[1]) / cell_m
        row, column = min(max(int(at[k, 0]), 0), rows - 1), min(max(int(at[k, 1]), 0), columns - 1)
        cell[k] = row * columns + column
    begin = np.zeros(rows * columns + 1, np.int64)
    for k in range(count):
        begin[cell[k] + 1] += 1
    begin = np.cumsum(begin)
    place, filled = np.empty(count, np.int64), begin[:-1].copy()
    for k in range(count):
        place[k] = filled[cell[k]]
        filled[cell[k]] += 1
    height, by_cell, tops = np.empty(count), np.empty(count), np.empty((3, rows * columns))
    for k in range(count):
        height[k] = xyz[2, k]
        by_cell[place[k]] = height[k]
    tops[0] = second_largest(by_cell, begin, np.inf)
    low = _without_pits(_low(by_cell, begin, quantile, rows, columns))
    trend = _smoothed(envelope(low, slope * cell_m, REACH))
    for k in range(count):
        height[k] -= _interpolated(trend, at[k, 0] - 0.5, at[k, 1] - 0.5)
        by_cell[place[k]] = height[k]
    low = _without_pits(_low(by_cell, begin, quantile, rows, columns))
    rest = envelope(low, residual_slope * cell_m, REACH).reshape(-1)
    for k in range(count):
        height[k] -= rest[cell[k]]
        by_cell[place[k]] = height[k]
    tops[1], tops[2] = second_largest(by_cell, begin, np.inf), second_largest(by_cell, begin, ground_limit_m)
    return height, tops.reshape((3, rows, columns))


@kernel
def typical_of_blocks(tops: Float64, size: int, quantile: float, least: int) -> Float64:
    """Quantile of the finite tops (R, C) of a block of `size` by `size` cells that is typical of the blocks about it.

    Of each cell, (R, C): the lower median of its block and the eight around; infinite where all of them have fewer
    than `least` finite tops.
    """
    rows, columns = tops.shape
    shape = (rows + size - 1) // size, (columns + size - 1) // size
    own, some, known = np.full(shape, np.inf), np.empty(size * size), np.empty(9)
    for i in range(shape[0]):
        for j in range(shape[1]):
            count = 0
            for row in range(i * size, min((i + 1) * size, rows)):
                for column in range(j * size, min((j + 1) * size, columns)):
                    if tops[row, column] < np.inf:
                        some[count] = tops[row, column]
                        count += 1
            if count >= least:
                own[i, j] = np.sort(some[:count])[int(np.ceil(quantile * (count - 1)))]
    out = np.full((rows, columns), np.inf)
    for i in range(shape[0]):
        for j in range(shape[1]):
            count = 0
            for a in range(max(i - 1, 0), min(i + 2, shape[0])):
                for b in range(max(j - 1, 0), min(j + 2, shape[1])):
                    if own[a, b] < np.inf:
                        known[count] = own[a, b]
                        count += 1
            if count > 0:
                out[i * size : (i + 1) * size, j * size : (j + 1) * size] = np.sort(known[:count])[(count - 1) // 2]
    return out


@kernel
def broad_tops(tops: Float64) -> Float64:
    """Height of what is at least three cells broad about each cell (R, C) with the tops: their opening; at least 0.

    The residue of waves of the ground rises from cell to cell; a body that lies, less than a cell wide, at once.
    """
    rows, columns = tops.shape
    low, out = np.full((rows, columns), np.inf), np.zeros((rows, columns))
    for i in range(rows):
        for j in range(columns):
            for a in range(max(i - 1, 0), min(i + 2, rows)):
                for b in range(max(j - 1, 0), min(j + 2, columns)):
                    low[i, j] = min(low[i, j], tops[a, b])
    for i in range(rows):
        for j in range(columns):
            for a in range(max(i - 1, 0), min(i + 2, rows)):
                for b in range(max(j - 1, 0), min(j + 2, columns)):
                    if low[a, b] < np.inf:
                        out[i, j] = max(out[i, j], low[a, b])
    return out


@kernel
def stand_out_of_cell(
    xyz: Float32, height_m: Float64, plants_m: Float64, corner_m: tuple[float, float], cell_m: float,
    least_m: Float64, dense_m: Float64, margin_m: float, shares: tuple[float, float], returns: int, width_m: float,
) -> tuple[Bool, Bool]:  # fmt: skip
    """Which returns (3, N) of height (N,) stand out with enough others of their cell, (N,), and which are of plants.

    Cells as in `heights_above_ground`, with the height of plants in each (R, C). `least_m` (N,): height above which
    returns count if the first of `shares` of their cell do. `dense_m` (N,): height above which they count if the second
    share and a number of `returns` do whose standard deviation along y is `width_m` (a row of crop runs along x).
    `margin_m`: above plants.
    """
    rows, columns = plants_m.shape
    x0, y0, size = np.float32(corner_m[0]), np.float32(corner_m[1]), np.float32(cell_m)
    cell, plants = np.empty(xyz.shape[1], np.int64), plants_m.reshape(-1)
    count = np.zeros((3, rows * columns), np.int64)  # of all returns, of those above the first limit, of the second
    sums = np.zeros((2, rows * columns))  # of y and y² of those above the second
    is_above, is_plant = np.empty(xyz.shape[1], np.bool_), np.empty(xyz.shape[1], np.bool_)
    for k in range(xyz.shape[1]):
        row = min(int((xyz[0, k] - x0) / size), rows - 1)
        column = min(int((xyz[1, k] - y0) / size), columns - 1)
        here = cell[k] = row * columns + column
        plant_m = plants[here]
        is_plant[k] = plant_m > 0.0 and height_m[k] <= plant_m + margin_m
        is_above[k] = not is_plant[k] if plant_m > 0.0 else height_m[k] > least_m[k]
        count[0, here] += 1
        count[1, here] += is_above[k]
        if plant_m == 0.0 and height_m[k] > dense_m[k]:
            y = float(xyz[1, k] - y0)
            count[2, here] += 1
            sums[0, here] += y
            sums[1, here] += y * y
    for k in range(xyz.shape[1]):
        all_of, above, dense = count[:, cell[k]]
        is_dense = height_m[k] > dense_m[k] and plants[cell[k]] == 0.0
        is_dense &= dense >= max(float(returns), shares[1] * all_of)
        if is_dense:
            mean, square = sums[:, cell[k]] / dense
            is_dense = max(0.0, square - mean * mean) >= width_m * width_m
        is_above[k] = (is_above[k] and above >= shares[0] * all_of) or is_dense
    return is_above, is_plant


@kernel
def cells_in_grid(xyz: Float32, corner: tuple[float, float], shape: tuple[int, int], cell_m: float) -> Int64:
    """Cell (N,) of each return (3, N), row by row, in a grid of `shape` that begins `corner` cells from the origin.

    Returns beyond it belong to its outermost cells.
    """
    scale, x0, y0 = np.float32(1.0 / cell_m), np.float32(corner[0]), np.float32(corner[1])
    cell = np.empty(xyz.shape[1], np.int64)
    for k in range(xyz.shape[1]):
        row, column = int(xyz[0, k] * scale - x0), int(xyz[1, k] * scale - y0)
        cell[k] = min(max(row, 0), shape[0] - 1) * shape[1] + min(max(column, 0), shape[1] - 1)
    return cell


@kernel
def above_cells(xyz: Float32, cell: Int64, ground_m: Float32, height_m: np.float32, slope: np.float32) -> Bool:
    """Which returns (3, N) are higher above the ground (C,) of their cell (N,) than a height, plus a slope times their
    distance from x = y = 0."""
    out = np.empty(xyz.shape[1], np.bool_)
    for k in range(xyz.shape[1]):
        distance_m = np.sqrt(xyz[0, k] * xyz[0, k] + xyz[1, k] * xyz[1, k])
        out[k] = xyz[2, k] > ground_m[cell[k]] + height_m + slope * distance_m
    return out


@kernel
def plane_sums(low_m: Float64, is_known: Bool, reach: int) -> Float64:
    """Sums of 1, x, y, x², xy, y², z, zx, zy over the known cells in the square within reach of each, (R, C, 9).

    x: row, y: column, z: `low_m` (R, C) of a cell. A sum over a square is the difference of four sums from the corner
    of the grid.
    """
    rows, columns = low_m.shape
    total = np.zeros((rows + 1, columns + 1, 9))  # of the rows before along the columns, then of both
    for i in range(rows):
        for j in range(columns):
            for n in range(9):
                total[i + 1, j + 1, n] = total[i, j + 1, n]
            if is_known[i, j]:
                x, y, z = float(i), float(j), low_m[i, j]
                terms = (1.0, x, y, x * x, x * y, y * y, z, z * x, z * y)
                for n in range(9):
                    total[i + 1, j + 1, n] += terms[n]
    for i in range(rows + 1):
        for j in range(columns):
            for n in range(9):
                total[i, j + 1, n] += total[i, j, n]
    out = np.empty((rows, columns, 9))
    for i in range(rows):
        top, bottom = max(i - reach, 0), min(i + reach + 1, rows)
        for j in range(columns):
            left, right = max(j - reach, 0), min(j + reach + 1, columns)
            for n in range(9):
                lower = total[bottom, right, n] - total[bottom, left, n]
                out[i, j, n] = lower - total[top, right, n] + total[top, left, n]
    return out


@kernel
def heights_above_planes(
    xyz: Float32, cell: Int64, planes: Float64, middle_m: tuple[float, float], cell_m: float
) -> Float64:  # fmt: skip
    """Height (N,) of each return (3, N) above the plane z = p + q row + r column of its cell (N,), in `planes`.

    `middle_m`: middle of the first cell; `planes` (cells, 3).
    """
    out = np.empty(xyz.shape[1])
    for k in range(xyz.shape[1]):
        row, column = (xyz[0, k] - middle_m[0]) / cell_m, (xyz[1, k] - middle_m[1]) / cell_m
        plane = planes[cell[k]]
        out[k] = xyz[2, k] - (plane[0] + plane[1] * row + plane[2] * column)
    return out


@kernel
def lowest_of_cells(order: Int64, cell: Int64, z: Float64) -> Int64:
    """The lowest return of each cell, the first of equal ones, by ascending cell; `order` (N,) sorts `cell` (N,)."""
    lowest, count = np.empty(len(order), np.int64), 0
    for k in order:
        last = lowest[count - 1]
        if count == 0 or cell[k] != cell[last]:
            lowest[count] = k
            count += 1
        elif z[k] < z[last] or (z[k] == z[last] and k < last):
            lowest[count - 1] = k
    return lowest[:count]


@kernel
def low_levels(cell: Int64, level: Int32, shape: tuple[int, int], order: int, share: float) -> Int32:
    """Level of the `order`-th lowest return of each cell, or of the lowest `share` if that is more; -1: fewer returns.

    `cell`, `level` (N,) of each return; `shape`: number of cells and of levels.
    """
    counts, found = np.zeros(shape, np.int32), np.full(shape[0], -1, np.int32)
    for k in range(cell.shape[0]):
        counts[cell[k], level[k]] += 1
    for here in range(shape[0]):
        total = counts[here].sum()
        if total >= order:
            needed, below = max(float(order), share * total), 0
            while below < needed:
                found[here] += 1
                below += counts[here, found[here]]
    return found


@kernel
def envelope(low: Float64, rise_m: float, reach: int) -> Float64:
    """The greatest surface at or below `low` (R, C), which may be infinite, that rises by at most `rise_m` per cell
    within reach."""
    rows, columns = low.shape
    rise = np.empty((2 * reach + 1, 2 * reach + 1))
    for i in range(2 * reach + 1):
        for j in range(2 * reach + 1):
            rise[i, j] = rise_m * math.sqrt((i - reach) ** 2 + (j - reach) ** 2)
    out = low.copy()
    for row in range(rows):
        for column in range(columns):
            if low[row, column] == np.inf:
                continue
            for i in range(max(row - reach, 0), min(row + reach + 1, rows)):
                for j in range(max(column - reach, 0), min(column + reach + 1, columns)):
                    bound = low[row, column] + rise[i - row + reach, j - column + reach]
                    out[i, j] = min(out[i, j], bound)
    return out


@kernel
def plant_heights(tops: Float64, reach: int, steps: Int64, low: float, high: float, share: float) -> Float64:
    """Upper quartile of the tops (R, C) above `low`, at most `high`, within reach of each cell in rows and columns; 0
    where fewer than `share` of the finite ones are.

    `steps` (C,): rows from one of these cells to the next in each column, where rows lie closer than columns.
    """
    rows, columns = tops.shape
    out, some = np.zeros((rows, columns)), np.empty((2 * reach + 1) ** 2)
    for row in range(rows):
        for column in range(columns):
            known = count = 0
            for k in range(-reach, reach + 1):
                i = row + k * steps[column]
                if not 0 <= i < rows:
                    continue
                for j in range(max(column - reach, 0), min(column + reach + 1, columns)):
                    known += tops[i, j] < np.inf
                    if low < tops[i, j] <= high:
                        some[count] = tops[i, j]
                        count += 1
            if count > 0 and count >= share * known:
                out[row, column] = np.sort(some[:count])[3 * count // 4]
    return out


@inline_kernel
def _without_pits(low: Float64) -> Float64:
    """The low heights (R, C) of the cells, infinite where three quarters of the known ones about it are more than
    `PIT_M` higher.

    Reflections in water and on wet ground lie below it; each lowers the surface within reach.
    """
    rows, columns = low.shape
    out = low.copy()
    for row in range(rows):
        for column in range(columns):
            known = level = 0
            for i in range(max(row - PIT_REACH, 0), min(row + PIT_REACH + 1, rows)):
                for j in range(max(column - PIT_REACH, 0), min(column + PIT_REACH + 1, columns)):
                    known += low[i, j] < np.inf
                    level += low[i, j] <= low[row, column] + PIT_M
            if 4 * level <= known:
                out[row, column] = np.inf
    return out


@inline_kernel
def _low(by_cell: Float64, begin: Int64, quantile: float, rows: int, columns: int) -> Float64:
    """Low quantile of the heights `by_cell[begin[c]:begin[c + 1]]` of each cell c; infinite in an empty one."""
    low, lowest = np.full((rows, columns), np.inf), np.empty(RANKS)
    for here in range(rows * columns):
        count = begin[here + 1] - begin[here]
        if count == 0:
            continue
        rank = int(quantile * count)
        if rank >= RANKS:
            low[here // columns, here % columns] = np.partition(by_cell[begin[here] : begin[here + 1]], rank)[rank]
            continue
        lowest[: rank + 1] = np.inf  # the lowest so far, ascending
        for k in range(begin[here], begin[here + 1]):
            place = rank
            if by_cell[k] >= lowest[rank]:
                continue
            while place > 0 and lowest[place - 1] > by_cell[k]:
                lowest[place] = lowest[place - 1]
                place -= 1
            lowest[place] = by_cell[k]
        low[here // columns, here % columns] = lowest[rank]
    return low


@kernel
def second_largest(by_cell: Float32 | Float64, begin: Int32 | Int64, limit: float) -> Float64:
    """Second largest value below the limit of each cell c, `by_cell[begin[c]:begin[c + 1]]`; infinite where fewer than
    three are."""
    found = np.full(len(begin) - 1, np.inf)
    for here in range(len(begin) - 1):
        largest, second, count = -np.inf, -np.inf, 0
        for k in range(begin[here], begin[here + 1]):
            value = by_cell[k]
            if value < limit:
                count += 1
                second = max(second, min(value, largest))
                largest = max(largest, value)
        if count >= 3:
            found[here] = second
    return found


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
