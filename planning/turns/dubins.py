"""Dubins paths: all six words between two poses, and their points."""

import math
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float64
from geometry.pose2 import Pose2

WORDS = ("LSL", "RSR", "LSR", "RSL", "RLR", "LRL")
_TURN = {"L": 1.0, "S": 0.0, "R": -1.0}


@dataclass(frozen=True)
class DubinsPath:
    """A word (such as LSL) with the lengths of its three segments, from `start`, at turning radius `radius_m`."""

    start: Pose2
    word: str
    lengths_m: tuple[float, float, float]
    radius_m: float

    @property
    def length_m(self) -> float:
        """Total length."""
        return sum(self.lengths_m)


def dubins_paths(start: Pose2, goal: Pose2, radius_m: float) -> list[DubinsPath]:
    """All Dubins paths between two poses, shortest first (Shkel & Lumelsky 2001, eq. 9 to 20)."""
    dx, dy = goal.x_m - start.x_m, goal.y_m - start.y_m
    d, theta = math.hypot(dx, dy) / radius_m, math.atan2(dy, dx)
    a, b = start.yaw_rad - theta, goal.yaw_rad - theta
    found = []
    for word in WORDS:
        parts = _parts(word, d, a, b)
        if parts is not None:
            t, p, q = (x * radius_m for x in parts)
            found.append(DubinsPath(start, word, (t, p, q), radius_m))
    return sorted(found, key=lambda c: (c.length_m, c.word))


def _parts(word: str, d: float, a: float, b: float) -> tuple[float, float, float] | None:
    sa, ca, sb, cb = math.sin(a), math.cos(a), math.sin(b), math.cos(b)
    if word == "LSL":
        p2, tangent = 2 + d * d - 2 * math.cos(a - b) + 2 * d * (sa - sb), math.atan2(cb - ca, d + sa - sb)
        return None if p2 < 0 else (_turn(tangent - a), math.sqrt(p2), _turn(b - tangent))
    if word == "RSR":
        p2, tangent = 2 + d * d - 2 * math.cos(a - b) + 2 * d * (sb - sa), math.atan2(ca - cb, d - sa + sb)
        return None if p2 < 0 else (_turn(a - tangent), math.sqrt(p2), _turn(tangent - b))
    if word == "LSR":
        p2 = -2 + d * d + 2 * math.cos(a - b) + 2 * d * (sa + sb)
        if p2 < 0:
            return None
        p = math.sqrt(p2)
        tangent = math.atan2(-ca - cb, d + sa + sb) - math.atan2(-2.0, p)
        return _turn(tangent - a), p, _turn(tangent - b)
    if word == "RSL":
        p2 = -2 + d * d + 2 * math.cos(a - b) - 2 * d * (sa + sb)
        if p2 < 0:
            return None
        p = math.sqrt(p2)
        tangent = math.atan2(ca + cb, d - sa - sb) - math.atan2(2.0, p)
        return _turn(a - tangent), p, _turn(b - tangent)
    side = 1.0 if word == "RLR" else -1.0
    cosine = (6 - d * d + 2 * math.cos(a - b) + side * 2 * d * (sa - sb)) / 8
    if abs(cosine) > 1:
        return None
    p = 2 * math.pi - math.acos(cosine)
    if word == "RLR":
        t = _turn(a - math.atan2(ca - cb, d - sa + sb) + p / 2)
        return t, p, _turn(a - b - t + p)
    t = _turn(-a + math.atan2(-ca + cb, d + sa - sb) + p / 2)
    return t, p, _turn(b - a - t + p)


def _turn(angle_rad: float) -> float:
    turn = angle_rad % (2 * math.pi)
    return 0.0 if turn > 2 * math.pi - 1e-9 else turn


def points_of(path: DubinsPath, step_m: float) -> Float64:
    """Points (N, 2) of a path with both ends, at most `step_m` apart."""
    pose, out = path.start, [np.array([[path.start.x_m, path.start.y_m]])]
    for letter, length in zip(path.word, path.lengths_m, strict=True):
        if length < 1e-9:
            continue
        s = np.linspace(0.0, length, max(2, math.ceil(length / step_m) + 1))[1:]
        x, y, heading = _along(pose, _TURN[letter] / path.radius_m, s)
        out.append(np.column_stack([x, y]))
        pose = Pose2(float(x[-1]), float(y[-1]), float(heading[-1]))
    return np.vstack(out)


def _along(pose: Pose2, curvature: float, s: Float64) -> tuple[Float64, Float64, Float64]:
    h = pose.yaw_rad + curvature * s
    if curvature == 0.0:
        return pose.x_m + s * math.cos(pose.yaw_rad), pose.y_m + s * math.sin(pose.yaw_rad), h
    x = pose.x_m + (np.sin(h) - math.sin(pose.yaw_rad)) / curvature
    y = pose.y_m - (np.cos(h) - math.cos(pose.yaw_rad)) / curvature
    return x, y, h
