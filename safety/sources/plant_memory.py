"""Memory of a lidar where plants stood: what it called plants from ahead is plants while the machine passes.

At the edge of a stand, beside the machine, too few cells about a place are seen to show that plants surround it, and
in single scans they stand out of the ground. What is higher than the plants were is none.
"""

import math

import numpy as np

from geometry.arrays import Float64, Int64
from safety.sources.multiple_evaluation import cell_keys

LEAST = 3.0  # scans that showed plants
FORGOTTEN = 0.05  # scans, when decayed to this


class PlantMemory:
    """Scans that showed plants in each cell of odom, which decay over `memory_s`, and the greatest height of these."""

    def __init__(self, cell_m: float, memory_s: float) -> None:
        self._cell_m, self._memory_ns = cell_m, memory_s * 1e9
        self._cells: Int64 = np.empty(0, np.int64)
        self._scans, self._height_m = np.empty(0), np.empty(0)
        self._stamp_ns = 0

    def add(self, stamp_ns: int, xy_odom_m: Float64, height_m: Float64) -> None:
        """Returns (N, 2) of plants in a scan, and their heights (N,); the same scan again adds nothing."""
        if stamp_ns == self._stamp_ns:
            return
        decay = math.exp(-abs(stamp_ns - self._stamp_ns) / self._memory_ns)
        keys, which = np.unique(np.concatenate([self._cells, self._keys(xy_odom_m)]), return_inverse=True)
        known, found = np.split(which, [len(self._cells)])
        scans, top_m = np.zeros(len(keys)), np.zeros(len(keys))
        scans[known], top_m[known] = decay * self._scans, self._height_m
        scans[np.unique(found)] += 1.0
        np.maximum.at(top_m, found, height_m)
        is_kept = scans > FORGOTTEN
        self._cells, self._scans, self._height_m = keys[is_kept], scans[is_kept], top_m[is_kept]
        self._stamp_ns = stamp_ns

    def height_m(self, xy_odom_m: Float64) -> Float64:
        """Height (N,) of the plants that stood where returns (N, 2) are, 0 where none did."""
        if len(self._cells) == 0:
            return np.zeros(len(xy_odom_m))
        keys = self._keys(xy_odom_m)
        place = np.minimum(np.searchsorted(self._cells, keys), len(self._cells) - 1)
        stood = (self._cells[place] == keys) & (self._scans[place] >= LEAST)
        return np.where(stood, self._height_m[place], 0.0)

    def _keys(self, xy_odom_m: Float64) -> Int64:
        return cell_keys(np.column_stack([xy_odom_m, np.zeros(len(xy_odom_m))]), self._cell_m)
