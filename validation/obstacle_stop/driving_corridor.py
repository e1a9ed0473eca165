"""The tube: the volume that the vehicle's front will sweep, seen from base at one moment."""

import math
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float64
from geometry.polyline import arc_length
from messages.plan import Path

STEP_M = 0.5
SEARCH_M = 5.0


@dataclass(frozen=True, eq=False)
class Tube:
    """The way (M, 2) of the middle of the front in base now, `start_m` the way to the front's present place on it."""

    way_m: Float64
    start_m: float
    half_width_m: float

    def gaps(self, xy_m: Float64) -> Float64:
        """Free way to each point (N, 2) along the tube, (N,); infinite outside it and behind the front."""
        if len(xy_m) == 0:
            return np.empty(0)
        s, aside = places(self.way_m, xy_m)
        inside = (np.abs(aside) <= self.half_width_m) & (s > self.start_m)
        return np.where(inside, s - self.start_m, np.inf)

    def outline_m(self) -> Float64:
        """A ring (K, 2) about it, for the eye."""
        d = np.gradient(self.way_m, axis=0)
        n = np.column_stack([-d[:, 1], d[:, 0]]) / np.maximum(np.hypot(d[:, 0], d[:, 1]), 1e-9)[:, None]
        return np.vstack([self.way_m + self.half_width_m * n, (self.way_m - self.half_width_m * n)[::-1]])


def tube_of(path: Path, place_m: float, pose_map: Float64, front_m: float, half_width_m: float, reach_m: float) -> Tube:
    """The tube along a path from about `place_m` on, for the pose (3,: x, y, yaw in map)."""
    first, last = max(place_m - SEARCH_M, float(path.s_m[0])), min(place_m + reach_m, float(path.s_m[-1]))
    s = np.append(np.arange(first, last, STEP_M), last)
    x, y = (np.interp(s, path.s_m, path.p_map_m[:, k]) for k in (0, 1))
    heading = np.interp(s, path.s_m, np.unwrap(path.heading_rad))
    front = np.column_stack([x + front_m * np.cos(heading), y + front_m * np.sin(heading)]) - pose_map[:2]
    c, n = math.cos(pose_map[2]), math.sin(pose_map[2])
    way = np.column_stack([c * front[:, 0] + n * front[:, 1], c * front[:, 1] - n * front[:, 0]])
    way = way[np.concatenate([[True], np.hypot(*np.diff(way, axis=0).T) > 1e-3])]
    if len(way) < 2:
        way = np.array([[front_m, 0.0], [front_m + STEP_M, 0.0]])
    here, _ = places(way, np.array([[front_m, 0.0]]))
    return Tube(way, float(here[0]), half_width_m)


def places(way_m: Float64, xy_m: Float64) -> tuple[Float64, Float64]:
    """Way along the polyline to the foot of each point (N,), and the distance there, infinite past its ends."""
    a, d = way_m[:-1], np.diff(way_m, axis=0)
    length = np.hypot(d[:, 0], d[:, 1])
    u = d / length[:, None]
    along = xy_m @ u.T - np.einsum("ij,ij->i", a, u)
    across = u[:, 0] * (xy_m[:, 1:] - a[:, 1]) - u[:, 1] * (xy_m[:, :1] - a[:, 0])
    over = along - np.clip(along, 0.0, length)
    k = np.argmin(np.hypot(over, across), axis=1)
    row = np.arange(len(xy_m))
    is_past = ((k == 0) & (over[row, k] < 0.0)) | ((k == len(length) - 1) & (over[row, k] > 0.0))
    # in the wedge outside a bend the nearest place is the corner itself
    aside = np.where(is_past, np.inf, np.hypot(over[row, k], across[row, k]))
    return arc_length(way_m)[k] + np.clip(along, 0.0, length)[row, k], aside
