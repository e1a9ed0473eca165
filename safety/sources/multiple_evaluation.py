"""Multiple evaluation (IEC 61496-3): a cell is hit by enough returns in one scan, or by some in each of two scans.

Low returns, near the height of the ground itself, count in two scans only. A cell whose returns float, with clear space
beneath them, counts in three: a bird at 6 m/s is not in it for so long, a branch, a barrier or a load is. So does one
of returns that hardly stand out of rough ground: plants that the machine passes look like a body in two scans. Before a
machine at rest one return in each of many scans is enough: a thin post between the columns of a lidar has no more.
"""

from typing import NamedTuple

import numpy as np

from geometry.arrays import Bool, Float64, Int64
from geometry.ground_surface import lowest_of_cells

MIN_DOUBTFUL_RATIO = 0.75  # of a cell's returns: at the edges of a bird beams prove nothing
BITS = 21  # per axis; with cells of 0.5 m ±500 km
NEIGHBOURS = [(i << (2 * BITS)) + (j << BITS) + k for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)]
MIN_FLOATING, MIN_FLOATING_RATIO = 2, 0.25  # returns, and share of all, that show that a body floats
MAX_STANDING = 0.25  # of the returns that show either; above it the body stands


def cell_keys(points_odom_m: Float64, cell_m: float) -> Int64:
    """Cell of each point (N, 3) as one integer."""
    cell = np.floor(points_odom_m / cell_m).astype(np.int64) + (1 << (BITS - 1))
    return np.asarray((cell[:, 0] << (2 * BITS)) | (cell[:, 1] << BITS) | cell[:, 2])


class Returns(NamedTuple):
    """Returns by cell: sorted cells (K,), the cell of each return (N,) as an index of these, and their numbers (K,)."""

    cells: Int64
    which: Int64
    counts: Int64

    def number(self, is_some: Bool) -> Float64:
        """Number of some of the returns (N,) in each cell, (K,)."""
        return np.asarray(np.bincount(self.which, is_some, len(self.cells)), np.float64)


def by_cell(keys: Int64) -> Returns:
    """Returns with cells (N,)."""
    return Returns(*np.unique(keys, return_inverse=True, return_counts=True))


def evaluate(
    returns: Returns, is_high: Bool, is_doubtful: Bool, before: tuple[Int64, Int64], single: int, multiple: int
) -> tuple[Bool, Int64]:
    """Whether each point is a hit, (N,) bool, and the sorted cells with at least `multiple` returns, for the next scan.

    `single`: minimum of high returns in this scan alone; `is_high` and `is_doubtful` (N,) bool: floats, or hardly
    stands out; `before`: cells of the previous scan and of the one before it.
    """
    cells, counts = returns.cells, returns.counts
    was_seen, was_seen_twice = (is_among(cells, some) for some in before)
    in_two = was_seen & (counts >= multiple)
    in_one = returns.number(is_high) >= single
    is_cell_doubtful = returns.number(is_doubtful) >= MIN_DOUBTFUL_RATIO * counts
    is_hit = np.where(is_cell_doubtful, in_two & was_seen_twice, in_one | in_two)
    return is_hit[returns.which], cells[counts >= multiple]


class Streaks(NamedTuple):
    """Sorted cells (K,) with the number of scans in a row (K,) in which each had a return."""

    cells: Int64
    scans: Int64

    def continued(self, cells: Int64) -> "Streaks":
        """Those of the next scan, with returns in sorted cells (L,)."""
        scans = np.ones(len(cells), np.int64)
        was_seen = is_among(cells, self.cells)
        scans[was_seen] += self.scans[np.searchsorted(self.cells, cells[was_seen])]
        return Streaks(cells, scans)

    def longer_than(self, scans: int) -> Int64:
        """Sorted cells seen in at least so many scans in a row."""
        return self.cells[self.scans >= scans]


def floats_as_a_whole(returns: Returns, is_floating: Bool, is_standing: Bool) -> Bool:
    """Which returns (N,) lie in cells of a body that floats by the returns there and in the cells around, (N,) bool.

    Beneath a part of it no beam passes, as at its edges and above the machine itself. Where a cell's own returns stand,
    those around it count for nothing.
    """
    floats, stands = returns.number(is_floating), returns.number(is_standing)
    is_open = (floats < MIN_DOUBTFUL_RATIO * returns.counts) & (stands <= MAX_STANDING * (floats + stands))
    if not is_open.any() or not floats.any():
        return np.zeros_like(is_floating)
    numbers = np.zeros((3, np.count_nonzero(is_open)))
    for step in NEIGHBOURS:
        place = np.searchsorted(returns.cells, returns.cells[is_open] + step)
        place[place == len(returns.cells)] = 0
        found = returns.cells[place] == returns.cells[is_open] + step
        numbers += np.where(found, np.stack([floats, stands, returns.counts])[:, place], 0.0)
    floats, stands, counts = numbers
    is_whole = (floats >= MIN_FLOATING) & (floats >= MIN_FLOATING_RATIO * counts)
    is_open[is_open] = is_whole & (stands <= MAX_STANDING * (floats + stands))
    return np.asarray(is_open[returns.which])


def is_among(cells: Int64, some: Int64) -> Bool:
    """Which of the cells (K,) are among some, both sorted, (K,)."""
    place = np.searchsorted(some, cells)
    found = place < len(some)
    found[found] = some[place[found]] == cells[found]
    return found


def thin(points_m: Float64, grid_m: float) -> Float64:
    """Lowest of the points (N, 3) per square of a horizontal grid, so that a wall costs no more than a post."""
    square = np.floor(points_m[:, :2] / grid_m).astype(np.int64)
    key = (square[:, 0] << BITS) + square[:, 1]
    z = points_m[:, 2] if points_m.shape[1] > 2 else np.zeros(len(points_m))
    return points_m[lowest_of_cells(np.argsort(key), key, np.ascontiguousarray(z))]
