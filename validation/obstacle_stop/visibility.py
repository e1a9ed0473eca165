"""What one scan shows of one object."""

import math

import numpy as np

from geometry.arrays import Float32, Float64
from messages.perception import Obstacles
from validation.obstacle_stop.boxes import Box
from validation.obstacle_stop.observation import Setting, Sighting

BEHIND_M = 3.0
AHEAD_RAD = math.radians(45.0)  # BD-5.4.1b: the region on the working path is 90 degrees wide


def ahead(rows: list[Sighting], least_returns: int) -> list[Sighting]:
    """The sightings in the region on the working path that have enough returns: what detection ranges rest on."""
    return [s for s in rows if abs(s.bearing_rad) <= AHEAD_RAD and s.returns >= least_returns]


def is_under(box: Box, setting: Setting) -> bool:
    """Whether the vehicle's own body stands where the object should be: a log may drive through what is put in it."""
    x, y = box.center_m[:2]
    reach = 0.5 * float(box.size_m[:2].min())
    return bool(-BEHIND_M < x < setting.front_m + reach and abs(y) < 0.5 * setting.width_m + reach)


def is_in_tube(sighting: Sighting, least_returns: int) -> bool:
    """Whether the object is in the tube: by its returns, or, where its returns are gone, by beams that pass through."""
    if sighting.inside >= least_returns:
        return True
    return sighting.solid < least_returns <= sighting.through and math.isfinite(sighting.box_gap_m)


def gap_of(sighting: Sighting) -> float:
    """Gap to its nearest return in the tube, or to its box when it has too few."""
    return sighting.clearance_m if math.isfinite(sighting.clearance_m) else sighting.box_gap_m


def found(mine: np.ndarray, points: Float32, box: Box, obstacles: Obstacles | None, near_m: float) -> tuple[bool, bool]:
    """Whether clusters hold half of the box's returns (their indices), and whether one does that is as large as it."""
    sizes = np.diff(obstacles.offsets) if obstacles is not None else np.empty(0, np.int64)
    if obstacles is None or not len(mine) or not len(sizes):
        return False, False
    is_mine = np.zeros(len(points), bool)
    is_mine[mine] = True
    hits = np.bincount(np.repeat(np.arange(len(sizes)), sizes), is_mine[obstacles.indices], len(sizes))
    k = int(hits.argmax())
    is_seen = bool(hits.sum() >= 0.5 * len(mine))
    if hits[k] < 0.5 * len(mine):
        return is_seen, False
    own = points[obstacles.indices[obstacles.offsets[k] : obstacles.offsets[k + 1]]]
    return True, bool(box.contains(own, near_m).mean() >= 0.5)


def edge_m(points_m: Float32 | Float64, setting: Setting) -> float:
    """Level distance of the nearest point from the vehicle's front edge."""
    ahead = np.maximum(points_m[:, 0] - setting.front_m, 0.0)
    aside = np.maximum(np.abs(points_m[:, 1]) - 0.5 * setting.width_m, 0.0)
    return float(np.hypot(ahead, aside).min())
