"""All Reeds-Shepp paths between two poses, each as signed lengths at three curvatures.

Formulas of Reeds and Shepp 1990, section 8 (8.1 to 8.11), for a turning radius of 1, a start at the origin heading
along x, and a goal (x, y, φ). Each gives further paths by time reversal, by reflection, and from its other end.
"""

import math
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import NamedTuple

from geometry.pose2 import Pose2

MIN_LENGTH = 1e-9
_QUARTER = 0.5 * math.pi
_MIRRORED = {"L": "R", "R": "L", "S": "S"}
_TURN = {"L": 1.0, "S": 0.0, "R": -1.0}

Lengths = tuple[float, ...] | None


class Segment(NamedTuple):
    """Part of a path: forward where `length_m` is positive, else reverse."""

    length_m: float
    curvature_radpm: float


ReedsSheppPath = tuple[Segment, ...]


def reeds_shepp_paths(start: Pose2, goal: Pose2, radius_m: float) -> list[ReedsSheppPath]:
    """All Reeds-Shepp paths between two poses, shortest first."""
    dx, dy = goal.x_m - start.x_m, goal.y_m - start.y_m
    c, s = math.cos(start.yaw_rad), math.sin(start.yaw_rad)
    x, y = (c * dx + s * dy) / radius_m, (c * dy - s * dx) / radius_m
    found = [_scaled(letters, lengths, radius_m) for letters, lengths in _all(x, y, goal.yaw_rad - start.yaw_rad)]
    return sorted(found, key=lambda w: (round(length_m(w), 9), w))


def length_m(segments: ReedsSheppPath) -> float:
    """Total length, forward and reverse."""
    return sum(abs(t.length_m) for t in segments)


def cusps(segments: ReedsSheppPath) -> int:
    """Number of changes of direction."""
    signs = [t.length_m > 0.0 for t in segments]
    return sum(a != b for a, b in pairwise(signs))


def _scaled(letters: str, lengths: tuple[float, ...], radius_m: float) -> ReedsSheppPath:
    parts = zip(letters, lengths, strict=True)
    return tuple(Segment(u * radius_m, _TURN[c] / radius_m) for c, u in parts if abs(u) > MIN_LENGTH)


def _all(x: float, y: float, phi: float) -> Iterator[tuple[str, tuple[float, ...]]]:
    c, s = math.cos(phi), math.sin(phi)
    for letters, formula, has_other_end in FAMILIES:
        ends = [(x, y, False)] + ([(x * c + y * s, x * s - y * c, True)] if has_other_end else [])
        for a, b, is_other_end in ends:
            for time in (1.0, -1.0):
                for side in (1.0, -1.0):
                    found = formula(time * a, side * b, time * side * phi)
                    if found is not None:
                        order = -1 if is_other_end else 1
                        name = letters if side > 0.0 else "".join(_MIRRORED[k] for k in letters)
                        yield name[::order], tuple(time * u for u in found[::order])


def _wrap(angle: float) -> float:
    return math.remainder(angle, 2.0 * math.pi)


def _lsl(x: float, y: float, phi: float) -> Lengths:
    a, b = x - math.sin(phi), y - 1.0 + math.cos(phi)
    t = math.atan2(b, a)
    v = _wrap(phi - t)
    return (t, math.hypot(a, b), v) if t >= 0.0 and v >= 0.0 else None


def _lsr(x: float, y: float, phi: float) -> Lengths:
    a, b = x + math.sin(phi), y - 1.0 - math.cos(phi)
    square = a * a + b * b - 4.0
    if square < 0.0:
        return None
    u = math.sqrt(square)
    t = _wrap(math.atan2(b, a) + math.atan2(2.0, u))
    v = _wrap(t - phi)
    return (t, u, v) if t >= 0.0 and v >= 0.0 else None


def _lrl(x: float, y: float, phi: float) -> Lengths:
    a, b = x - math.sin(phi), y - 1.0 + math.cos(phi)
    distance = math.hypot(a, b)
    if distance > 4.0:
        return None
    u = -2.0 * math.asin(0.25 * distance)
    t = _wrap(math.atan2(b, a) + 0.5 * u + math.pi)
    v = _wrap(phi - t + u)
    return (t, u, v) if t >= 0.0 and u <= 0.0 else None


def _outer(u: float, v: float, a: float, b: float, phi: float) -> tuple[float, float]:
    """First and last angle of a path of four turns whose inner two are known."""
    delta = _wrap(u - v)
    p, q = math.sin(u) - math.sin(delta), math.cos(u) - math.cos(delta) - 1.0
    angle = math.atan2(b * p - a * q, a * p + b * q)
    is_far = 2.0 * (math.cos(delta) - math.cos(v) - math.cos(u)) + 3.0 < 0.0
    t = _wrap(angle + math.pi) if is_far else _wrap(angle)
    return t, _wrap(t - u + v - phi)


def _lrlr_onwards(x: float, y: float, phi: float) -> Lengths:
    a, b = x + math.sin(phi), y - 1.0 - math.cos(phi)
    rho = 0.25 * (2.0 + math.hypot(a, b))
    if rho > 1.0:
        return None
    u = math.acos(rho)
    t, v = _outer(u, -u, a, b, phi)
    return (t, u, -u, v) if t >= 0.0 and v <= 0.0 else None


def _lrlr_back(x: float, y: float, phi: float) -> Lengths:
    a, b = x + math.sin(phi), y - 1.0 - math.cos(phi)
    rho = (20.0 - a * a - b * b) / 16.0
    if not 0.0 <= rho <= 1.0:
        return None
    u = -math.acos(rho)
    t, v = _outer(u, u, a, b, phi)
    return (t, u, u, v) if t >= 0.0 and v >= 0.0 else None


def _lrsl(x: float, y: float, phi: float) -> Lengths:
    a, b = x - math.sin(phi), y - 1.0 + math.cos(phi)
    rho = math.hypot(a, b)
    if rho < 2.0:
        return None
    root = math.sqrt(rho * rho - 4.0)
    u = 2.0 - root
    t = _wrap(math.atan2(b, a) + math.atan2(root, -2.0))
    v = _wrap(phi - _QUARTER - t)
    return (t, -_QUARTER, u, v) if t >= 0.0 and u <= 0.0 and v <= 0.0 else None


def _lrsr(x: float, y: float, phi: float) -> Lengths:
    a, b = x + math.sin(phi), y - 1.0 - math.cos(phi)
    rho, t = math.hypot(a, b), math.atan2(a, -b)
    if rho < 2.0:
        return None
    u = 2.0 - rho
    v = _wrap(t + _QUARTER - phi)
    return (t, -_QUARTER, u, v) if t >= 0.0 and u <= 0.0 and v <= 0.0 else None


def _lrslr(x: float, y: float, phi: float) -> Lengths:
    a, b = x + math.sin(phi), y - 1.0 - math.cos(phi)
    rho = math.hypot(a, b)
    if rho < 2.0:
        return None
    u = 4.0 - math.sqrt(rho * rho - 4.0)
    t = _wrap(math.atan2((4.0 - u) * a - 2.0 * b, -2.0 * a + (u - 4.0) * b))
    v = _wrap(t - phi)
    return (t, -_QUARTER, u, -_QUARTER, v) if u <= 0.0 and t >= 0.0 and v >= 0.0 else None


FAMILIES: tuple[tuple[str, Callable[[float, float, float], Lengths], bool], ...] = (
    ("LSL", _lsl, False), ("LSR", _lsr, False), ("LRL", _lrl, True), ("LRLR", _lrlr_onwards, False),
    ("LRLR", _lrlr_back, False), ("LRSL", _lrsl, True), ("LRSR", _lrsr, True), ("LRSLR", _lrslr, False),
)  # fmt: skip
