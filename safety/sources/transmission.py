"""Transmission: a cell that nearly all beams of a scan pass through holds no body, but dust.

Near the sensor hundreds of beams meet a cell, and dust on one in a hundred of them gives enough returns for a hit. The
beams that pass within half a cell of the middle of its returns, and return from behind it, show that it is transparent.
Beams that return nothing show nothing: they may be covered.
"""

import numpy as np

from geometry.arrays import Float32, Int64
from safety.config import TransmissionConfig


def are_transparent(
    keys: Int64, is_hit: np.ndarray, hits: Float32, returns: Float32, cell_m: float, config: TransmissionConfig
) -> np.ndarray:
    """Which of the obstacle returns, cell `keys` (N,) and `is_hit` (N,) bool, lie in a transparent cell, (N,) bool.

    `hits` (3, N) are the same returns and `returns` (3, M) all of the scan, relative to the sensor and not deskewed.
    Only cells of at most `max_returns` are tested: a body has more where beams are dense enough to prove anything.
    """
    cells, which, counts = np.unique(keys, return_inverse=True, return_counts=True)
    is_tested = np.zeros(len(cells), bool)
    is_tested[which[is_hit]] = True
    is_transparent = np.zeros(len(cells), bool)
    tested = np.flatnonzero(is_tested & (counts <= config.max_returns))
    if len(tested) == 0:
        return np.zeros(len(keys), bool)
    range_m, hit_range_m = np.linalg.norm(returns, axis=0), np.linalg.norm(hits, axis=0)
    for cell in tested:
        own = np.flatnonzero(which == cell)
        farthest_m = float(hit_range_m[own].max())
        middle = (hits[:, own] / hit_range_m[own]).mean(axis=1)
        within = farthest_m / np.hypot(farthest_m, 0.5 * cell_m)  # cosine of the angle of half a cell
        is_about = middle @ returns > within * np.linalg.norm(middle) * range_m
        passing = np.count_nonzero(is_about & (range_m > farthest_m + cell_m))
        is_transparent[cell] = len(own) < config.max_blocked_ratio * (len(own) + passing)
    return is_transparent[which]
