"""Guidance lines as polylines (N, 2) in `map`; lines to the left have positive numbers.

AB and A+ are straight, a circle keeps its centre, an adaptive curve keeps its distance at every place, so that inner
bends get tighter and may vanish.
"""

import math
from dataclasses import dataclass

import numpy as np
import shapely

from configs.mission import Work
from geometry.arrays import Float64
from geometry.polyline import extend, polyline, resample
from messages.errors import FieldError

LEAST_M = 0.1
STEP_M = 0.1


@dataclass(frozen=True)
class Straight:
    """AB by two points, or A+ by a point and a heading; `length_m` is drawn from A on."""

    a_m: tuple[float, float]
    heading_rad: float
    length_m: float

    def line(self, number: int, width_m: float) -> Float64:
        """Line `number`."""
        along = np.array([math.cos(self.heading_rad), math.sin(self.heading_rad)])
        left = np.array([-along[1], along[0]])
        a = np.array(self.a_m) + number * width_m * left
        return np.vstack([a, a + self.length_m * along])


def ab(a_m: tuple[float, float], b_m: tuple[float, float]) -> Straight:
    """The line through two points; raises FieldError when they are nearer than 0.1 m."""
    dx, dy = b_m[0] - a_m[0], b_m[1] - a_m[1]
    length = math.hypot(dx, dy)
    if not length >= LEAST_M:
        raise FieldError(f"A and B are {length:.2f} m apart; drive at least {LEAST_M} m between them")
    return Straight(a_m, math.atan2(dy, dx), length)


def a_plus(a_m: tuple[float, float], heading_rad: float, length_m: float) -> Straight:
    """The line through a point with a heading."""
    return Straight(a_m, heading_rad, length_m)


@dataclass(frozen=True)
class Circle:
    """A circle driven counter-clockwise, or clockwise; left is towards the centre when counter-clockwise."""

    center_m: tuple[float, float]
    radius_m: float
    is_clockwise: bool = False

    def line(self, number: int, width_m: float) -> Float64:
        """Line `number`, closed; raises FieldError when no circle is left there."""
        radius = self.radius_m + (number if self.is_clockwise else -number) * width_m
        if radius < LEAST_M:
            raise FieldError(f"circle line {number} would have a radius of {radius:.2f} m; choose one further out")
        count = max(16, math.ceil(2.0 * math.pi * radius / STEP_M))
        angle = np.linspace(0.0, 2.0 * math.pi, count + 1) * (-1.0 if self.is_clockwise else 1.0)
        points = np.array(self.center_m) + radius * np.column_stack([np.cos(angle), np.sin(angle)])
        points[-1] = points[0]
        return points


@dataclass(frozen=True)
class Curve:
    """An adaptive curve as it was recorded, (N, 2)."""

    points_m: Float64

    def line(self, number: int, width_m: float) -> Float64:
        """Line `number` at exactly its distance; raises FieldError when bends leave nothing of it."""
        base = resample(polyline(self.points_m), STEP_M)
        if number == 0:
            return base
        return _offset(base, number * width_m)


def curved_line_of(work: Work) -> "Curve | Circle | None":
    """The curve or circle to which the swaths of field work are parallel; None where they are straight."""
    if work.swath_circle_m is not None:
        x, y, radius_m = work.swath_circle_m
        return Circle((x, y), radius_m)
    return Curve(polyline(work.swath_curve_m)) if work.swath_curve_m else None


def _offset(base: Float64, to_left_m: float) -> Float64:
    """All places at that distance on that side; the longest piece where inner bends cut it."""
    shape = shapely.offset_curve(shapely.LineString(base), to_left_m, quad_segs=64, join_style="round")
    pieces = [g for g in getattr(shape, "geoms", [shape]) if g.length > LEAST_M]
    if not pieces:
        raise FieldError(f"no curve is left {abs(to_left_m):.1f} m to the {'left' if to_left_m > 0 else 'right'}")
    points = np.asarray(max(pieces, key=lambda g: g.length).coords, np.float64)
    is_turned = float((points[-1] - points[0]) @ (base[-1] - base[0])) < 0.0
    return resample(points[::-1] if is_turned else points, STEP_M)


def prolonged(line_m: Float64, before_m: float, after_m: float) -> Float64:
    """An open line carried on straight at both ends, so that it can be entered and left."""
    return extend(line_m, before_m, after_m)
