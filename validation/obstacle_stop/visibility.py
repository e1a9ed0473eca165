"""Visibility of true objects from the sensors: field of view, range, occlusion. Numbers only.

A box is visible when a sensor sees at least `MIN_SHARE` of the points on it and no label says that it is largely
hidden.
What hides it: other true boxes, and static structure of the log (returns at other times, see structure.py).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from geometry.arrays import Bool, Float64
from messages.truth import Occlusion

MIN_SHARE = 0.25
SHARES = (0.15, 0.5, 0.85)  # of length, width and height: points on a box
ELEVATION_SLACK_RAD = math.radians(0.5)


@dataclass(frozen=True, eq=False)
class View:
    """Field of view of a mounted sensor: `T_base_sensor` (4, 4), half angle in azimuth, elevations, farthest range."""

    T_base_sensor: Float64
    half_azimuth_rad: float
    elevation_rad: tuple[float, float]
    range_m: float

    def covers(self, points_base_m: Float64) -> Bool:
        """Mask (N,) of the points (N, 3) in base inside the field of view."""
        p = (points_base_m - self.T_base_sensor[:3, 3]) @ self.T_base_sensor[:3, :3]
        flat = np.hypot(p[:, 0], p[:, 1])
        elevation = np.arctan2(p[:, 2], flat)
        low, high = self.elevation_rad
        is_seen = (elevation >= low - ELEVATION_SLACK_RAD) & (elevation <= high + ELEVATION_SLACK_RAD)
        is_seen &= np.abs(np.arctan2(p[:, 1], p[:, 0])) <= self.half_azimuth_rad
        return np.asarray(is_seen & (np.hypot(flat, p[:, 2]) <= self.range_m))


class Solid(Protocol):
    """Something that hides what is behind it."""

    def blocks(self, origin_m: Float64, points_m: Float64) -> Bool:
        """Mask (N,): whether it lies between the origin (3,) and each point (N, 3)."""


@dataclass(frozen=True, eq=False)
class SolidBox:
    """A box that hides what is behind it: centre (3,), size (3,), yaw."""

    center_m: Float64
    size_m: Float64
    yaw_rad: float

    def points_m(self) -> Float64:
        """Points (27, 3) spread over the box."""
        x, y, z = (np.array(SHARES) * side - 0.5 * side for side in self.size_m)
        grid = np.stack(np.meshgrid(x, y, z), axis=-1).reshape(-1, 3)
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        turned = np.column_stack([c * grid[:, 0] - s * grid[:, 1], s * grid[:, 0] + c * grid[:, 1], grid[:, 2]])
        return np.asarray(turned + self.center_m)

    def blocks(self, origin_m: Float64, points_m: Float64) -> Bool:
        """Mask (N,): whether the box lies between the origin and each point; not when either is inside."""
        start, end = self._local(origin_m[None])[0], self._local(points_m)
        d, half = end - start, 0.5 * self.size_m
        with np.errstate(divide="ignore", invalid="ignore"):
            one, two = (-half - start) / d, (half - start) / d
        enter, leave = np.fmax.reduce(np.fmin(one, two), axis=1), np.fmin.reduce(np.fmax(one, two), axis=1)
        return np.asarray((enter < leave) & (enter > 0.0) & (leave < 1.0))

    def _local(self, points_m: Float64) -> Float64:
        d = points_m - self.center_m
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return np.column_stack([c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0], d[:, 2]])


def visible_share(box: SolidBox, views: Sequence[View], solids: Sequence[Solid]) -> float:
    """Greatest share of the points on a box that one of the sensors sees; all coordinates in base."""
    points, best = box.points_m(), 0.0
    for view in views:
        is_free = view.covers(points)
        for solid in solids:
            if is_free.any():
                is_free[is_free] = ~solid.blocks(view.T_base_sensor[:3, 3], points[is_free])
        best = max(best, float(is_free.mean()))
    return best


def is_visible(box: SolidBox, occlusion: Occlusion, views: Sequence[View], solids: Sequence[Solid]) -> bool:
    """Whether an object is visible; a label overrules what its surroundings suggest, not the fields of view."""
    if occlusion is Occlusion.LARGELY:
        return False
    return visible_share(box, views, () if occlusion is Occlusion.NONE else solids) >= MIN_SHARE
