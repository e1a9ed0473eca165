"""Hits: enough raised returns in one cell of odom in one scan, or some in each of two scans."""

import numpy as np

from geometry.arrays import Float64, Int64

BITS = 21  # cells of 0.5 m: a thousand kilometres each way


def cell_keys(points_odom_m: Float64, cell_m: float) -> Int64:
    """The cell of each point (N, 3) as one number."""
    cell = np.floor(points_odom_m / cell_m).astype(np.int64) + (1 << (BITS - 1))
    return np.asarray((cell[:, 0] << (2 * BITS)) | (cell[:, 1] << BITS) | cell[:, 2])


def evaluate(keys: Int64, before: Int64, once: int, twice: int) -> tuple[np.ndarray, Int64]:
    """Which points are hits, (N,) bool, and the cells to remember for the next scan, sorted.

    `before` are the cells that had at least `twice` returns in the scan before.
    """
    cells, which, counts = np.unique(keys, return_inverse=True, return_counts=True)
    is_hit = (counts >= once) | ((counts >= twice) & np.isin(cells, before, assume_unique=True))
    return is_hit[which], cells[counts >= twice]


def thin(points_m: Float64, grid_m: float) -> Float64:
    """One of the points (N, 3) in each square of a grid seen from above, so that a wall costs no more than a post."""
    square = np.floor(points_m[:, :2] / grid_m).astype(np.int64)
    _, first = np.unique((square[:, 0] << BITS) + square[:, 1], return_index=True)
    return points_m[first]
