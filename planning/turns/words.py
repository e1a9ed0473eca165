"""Words of turns: sequences of arcs and straights between two poses, forward or with reversing, at radius 1.

Forward: Dubins 1957 (arc, straight, arc; three arcs). With reversing also all of Reeds and Shepp 1990, section 8, and
the fishtail (arc, straight in reverse, arc), which needs less depth than a loop and stops on straights alone.
A word is a row of `lengths` (signed: negative in reverse) and one of `sides` (1 left, 0 straight, -1 right).
"""

import math

from geometry.arrays import Float64
from geometry.jit import kernel

SEGMENTS = 5
MAX_WORDS = 96
_QUARTER = 0.5 * math.pi
_FULL = 2.0 * math.pi
_TINY = 1e-9


@kernel
def words(x: float, y: float, phi: float, has_reverse: bool, lengths: Float64, sides: Float64) -> int:
    """Fills `lengths` and `sides` (MAX_WORDS, SEGMENTS) with the words from (0, 0, 0) to (x, y, phi); their number."""
    count = 0
    for mirror in (1.0, -1.0):
        count = _arcs_and_straight(x, mirror * y, mirror * phi, mirror, has_reverse, lengths, sides, count)
        count = _three_arcs(x, mirror * y, mirror * phi, mirror, lengths, sides, count)
        if not has_reverse:
            continue
        for time in (1.0, -1.0):
            a, b, p = time * x, mirror * y, time * mirror * phi
            count = _reeds_shepp(a, b, p, time, mirror, False, lengths, sides, count)
            c, s = math.cos(p), math.sin(p)
            count = _reeds_shepp(a * c + b * s, a * s - b * c, p, time, mirror, True, lengths, sides, count)
    return count


@kernel
def _put(
    lengths: Float64, sides: Float64, count: int, mirror: float, time: float, is_other_end: bool, letters: int,
    t: float, u: float, v: float, w: float, z: float,
) -> int:  # fmt: skip
    """Adds a word; `letters` has one decimal digit per segment: 1 straight, 2 left, 3 right, from the first."""
    if count >= len(lengths):
        return count
    values = (t, u, v, w, z)
    n = 0
    rest = letters
    while rest > 0:
        n, rest = n + 1, rest // 10
    rest = letters
    for k in range(SEGMENTS):
        lengths[count, k] = sides[count, k] = 0.0
    for k in range(n - 1, -1, -1):
        digit, rest = rest % 10, rest // 10
        side = 0.0 if digit == 1 else (mirror if digit == 2 else -mirror)
        at = n - 1 - k if is_other_end else k
        lengths[count, at], sides[count, at] = time * values[k], side
    return count + 1


@kernel
def _turn(angle: float) -> float:
    turn = angle % _FULL
    return 0.0 if turn > _FULL - 1e-9 else turn


@kernel
def _wrap(angle: float) -> float:
    return angle - _FULL * math.floor((angle + math.pi) / _FULL)


@kernel
def _arcs_and_straight(
    x: float, y: float, phi: float, mirror: float, has_reverse: bool, lengths: Float64, sides: Float64, count: int
) -> int:
    """Left, straight, left or right; the straight also in reverse."""
    a, b = x - math.sin(phi), y - 1.0 + math.cos(phi)
    u = math.hypot(a, b)
    t = math.atan2(b, a)
    count = _put(lengths, sides, count, mirror, 1.0, False, 212, _turn(t), u, _turn(phi - t), 0.0, 0.0)
    if has_reverse:
        t = t + math.pi
        count = _put(lengths, sides, count, mirror, 1.0, False, 212, _turn(t), -u, _turn(phi - t), 0.0, 0.0)
    a, b = x + math.sin(phi), y - 1.0 - math.cos(phi)
    square = a * a + b * b - 4.0
    if square >= 0.0:
        u = math.sqrt(square)
        t = math.atan2(b, a) + math.atan2(2.0, u)
        count = _put(lengths, sides, count, mirror, 1.0, False, 213, _turn(t), u, _turn(t - phi), 0.0, 0.0)
        if has_reverse:
            t = math.atan2(b, a) + math.atan2(2.0, -u)
            count = _put(lengths, sides, count, mirror, 1.0, False, 213, _turn(t), -u, _turn(t - phi), 0.0, 0.0)
    return count


@kernel
def _three_arcs(x: float, y: float, phi: float, mirror: float, lengths: Float64, sides: Float64, count: int) -> int:
    """Left, right, left, all forward: the bulb of two neighbouring lines."""
    a, b = x - math.sin(phi), y - 1.0 + math.cos(phi)
    distance = math.hypot(a, b)
    if distance > 4.0:
        return count
    u = _FULL - 2.0 * math.asin(0.25 * distance)
    t = _turn(math.atan2(b, a) + math.pi - math.asin(0.25 * distance))
    return _put(lengths, sides, count, mirror, 1.0, False, 232, t, u, _turn(phi - t + u), 0.0, 0.0)


@kernel
def _reeds_shepp(
    x: float, y: float, phi: float, time: float, mirror: float, is_other_end: bool, lengths: Float64, sides: Float64,
    count: int,
) -> int:  # fmt: skip
    """Formulas 8.1 to 8.11; from the other end only those that differ."""
    a, b = x - math.sin(phi), y - 1.0 + math.cos(phi)
    rho, theta = math.hypot(a, b), math.atan2(b, a)
    if not is_other_end:
        t, v = theta, _wrap(phi - theta)
        if t >= 0.0 and v >= 0.0:
            count = _put(lengths, sides, count, mirror, time, False, 212, t, rho, v, 0.0, 0.0)
    if rho <= 4.0:
        u = -2.0 * math.asin(0.25 * rho)
        t = _wrap(theta + 0.5 * u + math.pi)
        v = _wrap(phi - t + u)
        if t >= 0.0 and u <= 0.0:
            count = _put(lengths, sides, count, mirror, time, is_other_end, 232, t, u, v, 0.0, 0.0)
    if rho >= 2.0:
        root = math.sqrt(rho * rho - 4.0)
        u = 2.0 - root
        t = _wrap(theta + math.atan2(root, -2.0))
        v = _wrap(phi - _QUARTER - t)
        if t >= 0.0 and u <= 0.0 and v <= 0.0:
            count = _put(lengths, sides, count, mirror, time, is_other_end, 2312, t, -_QUARTER, u, v, 0.0)
    a, b = x + math.sin(phi), y - 1.0 - math.cos(phi)
    rho, theta = math.hypot(a, b), math.atan2(b, a)
    if rho >= 2.0:
        t, u = math.atan2(a, -b), 2.0 - rho
        v = _wrap(t + _QUARTER - phi)
        if t >= 0.0 and u <= 0.0 and v <= 0.0:
            count = _put(lengths, sides, count, mirror, time, is_other_end, 2313, t, -_QUARTER, u, v, 0.0)
    if is_other_end:
        return count
    if rho >= 2.0:
        u = math.sqrt(rho * rho - 4.0)
        t = _wrap(theta + math.atan2(2.0, u))
        v = _wrap(t - phi)
        if t >= 0.0 and v >= 0.0:
            count = _put(lengths, sides, count, mirror, time, False, 213, t, u, v, 0.0, 0.0)
        w = 4.0 - u
        t = _wrap(math.atan2((4.0 - w) * a - 2.0 * b, -2.0 * a + (w - 4.0) * b))
        v = _wrap(t - phi)
        if w <= 0.0 and t >= 0.0 and v >= 0.0:
            count = _put(lengths, sides, count, mirror, time, False, 23123, t, -_QUARTER, w, -_QUARTER, v)
    return _four_arcs(a, b, rho, phi, time, mirror, lengths, sides, count)


@kernel
def _four_arcs(
    a: float, b: float, rho: float, phi: float, time: float, mirror: float, lengths: Float64, sides: Float64, count: int
) -> int:
    share = 0.25 * (2.0 + rho)
    if share <= 1.0:
        u = math.acos(share)
        t, v = _outer(u, -u, a, b, phi)
        if t >= 0.0 and v <= 0.0:
            count = _put(lengths, sides, count, mirror, time, False, 2323, t, u, -u, v, 0.0)
    share = (20.0 - rho * rho) / 16.0
    if 0.0 <= share <= 1.0:
        u = -math.acos(share)
        t, v = _outer(u, u, a, b, phi)
        if t >= 0.0 and v >= 0.0:
            count = _put(lengths, sides, count, mirror, time, False, 2323, t, u, u, v, 0.0)
    return count


@kernel
def _outer(u: float, v: float, a: float, b: float, phi: float) -> tuple[float, float]:
    """First and last angle of a path of four arcs whose inner two are known."""
    delta = _wrap(u - v)
    p, q = math.sin(u) - math.sin(delta), math.cos(u) - math.cos(delta) - 1.0
    angle = math.atan2(b * p - a * q, a * p + b * q)
    is_far = 2.0 * (math.cos(delta) - math.cos(v) - math.cos(u)) + 3.0 < 0.0
    t = _wrap(angle + math.pi) if is_far else _wrap(angle)
    return t, _wrap(t - u + v - phi)


@kernel
def end_of(lengths: Float64, sides: Float64) -> tuple[float, float, float]:
    """Pose at the end of a word."""
    x, y, h = 0.0, 0.0, 0.0
    for k in range(len(lengths)):
        if sides[k] == 0.0:
            x, y = x + lengths[k] * math.cos(h), y + lengths[k] * math.sin(h)
        else:
            turned = h + sides[k] * lengths[k]
            x += sides[k] * (math.sin(turned) - math.sin(h))
            y -= sides[k] * (math.cos(turned) - math.cos(h))
            h = turned
    return x, y, h
