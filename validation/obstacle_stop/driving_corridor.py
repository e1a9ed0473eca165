"""Driving corridor: the area that the vehicle front sweeps along its path, in base."""

import math
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float64
from geometry.jit import kernel
from geometry.polyline import arc_length
from messages.plan import Path

STEP_M = 0.5
SEARCH_M = 5.0


@dataclass(frozen=True, eq=False)
class DrivingCorridor:
    """Path of the front centre `path_m` (M, 2) in base; `start_m` is the arc length at its present position."""

    path_m: Float64
    start_m: float
    half_width_m: float

    def clearances(self, xy_m: Float64) -> Float64:
        """Distance along the corridor to each point (N, 2), (N,); infinite outside it and behind the front."""
        if len(xy_m) == 0:
            return np.empty(0)
        s, aside = project(self.path_m, xy_m)
        is_inside = (np.abs(aside) <= self.half_width_m) & (s > self.start_m)
        return np.where(is_inside, s - self.start_m, np.inf)

    def outline_m(self) -> Float64:
        """Outline ring (K, 2), for figures."""
        d = np.gradient(self.path_m, axis=0)
        n = np.column_stack([-d[:, 1], d[:, 0]]) / np.maximum(np.hypot(d[:, 0], d[:, 1]), 1e-9)[:, None]
        return np.vstack([self.path_m + self.half_width_m * n, (self.path_m - self.half_width_m * n)[::-1]])


def corridor_along(
    path: Path, s_m: float, pose_map: Float64, front_m: float, half_width_m: float, length_m: float
) -> DrivingCorridor:
    """Corridor along a path from about arc length `s_m` on, for a pose in map (3,): x, y, yaw."""
    first, last = max(s_m - SEARCH_M, float(path.s_m[0])), min(s_m + length_m, float(path.s_m[-1]))
    s = np.append(np.arange(first, last, STEP_M), last)
    near = slice(max(0, int(np.searchsorted(path.s_m, first)) - 1), int(np.searchsorted(path.s_m, last)) + 2)
    x, y = (np.interp(s, path.s_m[near], path.p_map_m[near, k]) for k in (0, 1))
    heading = np.interp(s, path.s_m[near], np.unwrap(path.heading_rad[near]))
    front = np.column_stack([x + front_m * np.cos(heading), y + front_m * np.sin(heading)]) - pose_map[:2]
    c, n = math.cos(pose_map[2]), math.sin(pose_map[2])
    front_base = np.column_stack([c * front[:, 0] + n * front[:, 1], c * front[:, 1] - n * front[:, 0]])
    front_base = front_base[np.concatenate([[True], np.hypot(*np.diff(front_base, axis=0).T) > 1e-3])]
    if len(front_base) < 2:
        front_base = np.array([[front_m, 0.0], [front_m + STEP_M, 0.0]])
    here, _ = project(front_base, np.array([[front_m, 0.0]]))
    return DrivingCorridor(front_base, float(here[0]), half_width_m)


def project(path_m: Float64, xy_m: Float64) -> tuple[Float64, Float64]:
    """Arc length of the nearest position on a polyline for each point (N,), and distance; infinite beyond its ends."""
    s, aside = np.empty(len(xy_m)), np.empty(len(xy_m))
    at_m = arc_length(path_m)
    length = np.diff(at_m)
    _project(path_m, np.diff(path_m, axis=0) / length[:, None], length, at_m, xy_m, s, aside)
    return s, aside


@kernel
def _project(
    path: Float64, u: Float64, length: Float64, at_m: Float64, xy: Float64, s: Float64, aside: Float64
) -> None:
    last = len(u) - 1
    for i in range(len(xy)):
        nearest, best, past = 0, np.inf, 0.0
        for k in range(last + 1):
            x, y = xy[i, 0] - path[k, 0], xy[i, 1] - path[k, 1]
            along, across = x * u[k, 0] + y * u[k, 1], u[k, 0] * y - u[k, 1] * x
            over = along - min(max(along, 0.0), length[k])
            distance = over * over + across * across
            if distance < best:
                nearest, best, past, s[i] = k, distance, over, at_m[k] + along - over
        is_past = (nearest == 0 and past < 0.0) or (nearest == last and past > 0.0)
        # outside a bend the nearest position is the corner
        aside[i] = np.inf if is_past else np.sqrt(best)
