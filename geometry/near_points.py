"""Points near other points, and groups of points that are apart, in times that grow little faster than their number."""

import numpy as np

from geometry.arrays import Bool, Float64, Int32, Int64
from geometry.jit import kernel


def is_in_box(points_m: Float64, others_m: Float64, within_m: float) -> np.ndarray:
    """Whether each point (N, K) lies within the box about others (M, K; at least one) and a distance, (N,) bool."""
    low, high = others_m.min(axis=0) - within_m, others_m.max(axis=0) + within_m
    return np.asarray(((points_m >= low) & (points_m <= high)).all(axis=1))


def is_near(points_m: Float64, others_m: Float64, within_m: float) -> np.ndarray:
    """Whether each point (N, K) lies within a distance of one of the others (M, K; at least one), (N,) bool."""
    near = is_in_box(points_m, others_m, within_m)
    some, others = points_m[near], others_m[np.argsort(others_m[:, 0], kind="stable")]
    near[near] = _is_near(np.ascontiguousarray(some), np.ascontiguousarray(others), within_m)
    return near


def groups_of(points_m: Float64, within_m: float) -> list[Bool]:
    """Masks (N,) of the parts of points (N, 2) that are farther than about `within_m` from each other."""
    cells, cell = np.unique(np.floor(2.0 / within_m * points_m).astype(np.int64), axis=0, return_inverse=True)
    part = _parts(cells)[cell.ravel()]
    return [part == number for number in np.unique(part)]


@kernel
def _is_near(points: Float64, others: Float64, within: float) -> Bool:
    """As `is_near`; the others sorted by their first coordinate."""
    near = np.zeros(len(points), np.bool_)
    first = np.searchsorted(others[:, 0], points[:, 0] - 1.001 * within)  # rounding decides nothing
    for i in range(len(points)):
        for j in range(first[i], len(others)):
            if others[j, 0] - points[i, 0] > 1.001 * within:
                break
            square = 0.0
            for k in range(points.shape[1]):
                square += (points[i, k] - others[j, k]) ** 2
            if square <= within * within:
                near[i] = True
                break
    return near


@kernel
def root(parent: Int32 | Int64, k: int) -> int:
    """First of the group of entry k, where `parent` (N,) leads from each entry to one of its group before it."""
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@kernel
def _parts(cells: Int64) -> Int64:
    """Number (C,) of the lowest of the cells (C, 2; sorted, all different) that each touches by way of others."""
    part = np.arange(len(cells))
    after = 0  # first of the cells that may be in the next row, beside the present one
    for i in range(len(cells)):
        row, column = cells[i]
        while after < len(cells) and (
            cells[after, 0] <= row or (cells[after, 0] == row + 1 and cells[after, 1] < column - 1)
        ):
            after += 1
        for j in (i + 1, after, after + 1, after + 2):  # beside it, or in the next row
            if j < len(cells) and cells[j, 0] - row <= 1 and abs(cells[j, 1] - column) <= 1:
                one, other = root(part, i), root(part, j)
                part[max(one, other)] = min(one, other)
    for i in range(len(cells)):
        part[i] = root(part, i)
    return part
