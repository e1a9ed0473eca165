"""Visibility and detection of one object in one scan."""

import math

import numpy as np

from geometry.arrays import Float32, Float64
from messages.perception import Obstacles
from validation.obstacle_stop.boxes import Box
from validation.obstacle_stop.observation import ObjectObservation, Setting

BEHIND_M = 3.0
AHEAD_RAD = math.radians(45.0)  # BD-5.4.1b: the region on the working path is 90 degrees wide


def in_forward_region(rows: list[ObjectObservation], min_returns: int) -> list[ObjectObservation]:
    """Observations with enough returns in the 90° region ahead, from which detection ranges are computed."""
    return [s for s in rows if abs(s.bearing_rad) <= AHEAD_RAD and s.returns >= min_returns]


def is_under_vehicle(box: Box, setting: Setting) -> bool:
    """Whether the box overlaps the vehicle, as when a log is driven through an inserted object."""
    x, y = box.center_m[:2]
    reach = 0.5 * float(box.size_m[:2].min())
    return bool(-BEHIND_M < x < setting.front_m + reach and abs(y) < 0.5 * setting.width_m + reach)


def is_in_corridor(observation: ObjectObservation, min_returns: int) -> bool:
    """Whether the object is in the corridor: by its returns or, without returns, by beams through its box."""
    if observation.in_corridor >= min_returns:
        return True
    return observation.above_ground < min_returns <= observation.beams_through and math.isfinite(
        observation.box_clearance_m
    )


def clearance_of(observation: ObjectObservation) -> float:
    """Clearance to the nearest return in the corridor, else to the box."""
    return observation.clearance_m if math.isfinite(observation.clearance_m) else observation.box_clearance_m


def detection_of(
    mine: np.ndarray, points: Float32, box: Box, obstacles: Obstacles | None, association_m: float
) -> tuple[bool, bool]:
    """`is_detected` and `is_detected_strictly` for the returns with indices `mine`."""
    sizes = np.diff(obstacles.offsets) if obstacles is not None else np.empty(0, np.int64)
    if obstacles is None or not len(mine) or not len(sizes):
        return False, False
    is_mine = np.zeros(len(points), bool)
    is_mine[mine] = True
    hits = np.bincount(np.repeat(np.arange(len(sizes)), sizes), is_mine[obstacles.indices], len(sizes))
    k = int(hits.argmax())
    is_detected = bool(hits.sum() >= 0.5 * len(mine))
    if hits[k] < 0.5 * len(mine):
        return is_detected, False
    own = points[obstacles.indices[obstacles.offsets[k] : obstacles.offsets[k + 1]]]
    return True, bool(box.contains(own, association_m).mean() >= 0.5)


def front_distance_m(points_m: Float32 | Float64, setting: Setting) -> float:
    """Horizontal distance of the nearest point from the front edge of the vehicle."""
    ahead = np.maximum(points_m[:, 0] - setting.front_m, 0.0)
    aside = np.maximum(np.abs(points_m[:, 1]) - 0.5 * setting.width_m, 0.0)
    return float(np.hypot(ahead, aside).min())
