"""Steerable form of a word: curvature is ramped while driving and steps only at standstill. Compiled.

A curve is up to `MAX_SEGMENTS` signed lengths (negative in reverse) with their curvatures. Within one direction the
curvature is the mean over `ramp_m` around each point; both ends are continued. That moves the end point, so the lengths
are corrected (Newton's method, least change) until the curve ends at its goal.
"""

import math

import numpy as np

from geometry.arrays import Float64
from geometry.jit import kernel

MAX_SEGMENTS = 7
CORRECTIONS = 12
TOLERANCE_M = 1e-4


@kernel
def trace(
    lengths_m: Float64, curvatures_radpm: Float64, start: Float64, ramp_m: float, step_m: float, poses: Float64
) -> int:
    """Fills rows of `poses`: x, y, heading, curvature, direction; returns their number, 0 when there are too many.

    The first row of a new direction repeats the pose of the last one.
    """
    x, y, heading, count, first = start[0], start[1], start[2], 0, 0
    knots, turned = np.empty(MAX_SEGMENTS + 3), np.empty(MAX_SEGMENTS + 3)
    while first < len(lengths_m):
        if abs(lengths_m[first]) < 1e-9:
            first += 1
            continue
        direction = 1.0 if lengths_m[first] > 0.0 else -1.0
        knots[0], turned[0], knots[1] = -ramp_m, 0.0, 0.0
        turned[1] = ramp_m * curvatures_radpm[first]
        n, total, last = 2, 0.0, first
        while last < len(lengths_m) and lengths_m[last] * direction > -1e-9:
            length = abs(lengths_m[last])
            if length >= 1e-9:
                total += length
                knots[n], turned[n] = total, turned[n - 1] + length * curvatures_radpm[last]
                n += 1
                final = curvatures_radpm[last]
            last += 1
        knots[n], turned[n] = total + ramp_m, turned[n - 1] + ramp_m * final
        steps = max(1, math.ceil(total / step_m - 1e-9))
        if count + steps + 1 > len(poses):
            return 0
        step = total / steps
        low, high = 0, 0
        for k in range(steps + 1):
            at = k * step
            while high < n - 1 and knots[high + 1] < at + 0.5 * ramp_m:
                high += 1
            while low < n - 1 and knots[low + 1] < at - 0.5 * ramp_m:
                low += 1
            poses[count, 0], poses[count, 1], poses[count, 2] = x, y, heading
            poses[count, 3] = _mean(knots, turned, low, high, at, ramp_m)
            poses[count, 4] = direction
            count += 1
            if k < steps:
                middle = at + 0.5 * step
                a, b = low, high
                while b < n - 1 and knots[b + 1] < middle + 0.5 * ramp_m:
                    b += 1
                while a < n - 1 and knots[a + 1] < middle - 0.5 * ramp_m:
                    a += 1
                turn = direction * step * _mean(knots, turned, a, b, middle, ramp_m)
                x += direction * step * math.cos(heading + 0.5 * turn)
                y += direction * step * math.sin(heading + 0.5 * turn)
                heading += turn
        first = last
    return count


@kernel
def _mean(knots: Float64, turned: Float64, low: int, high: int, at: float, ramp_m: float) -> float:
    """Mean curvature over `ramp_m` around an arc length, from the heading change at the knots around its ends."""
    a, b = at - 0.5 * ramp_m, at + 0.5 * ramp_m
    before = turned[low] + (turned[low + 1] - turned[low]) * (a - knots[low]) / (knots[low + 1] - knots[low])
    after = turned[high] + (turned[high + 1] - turned[high]) * (b - knots[high]) / (knots[high + 1] - knots[high])
    return float((after - before) / ramp_m)


@kernel
def solve(
    lengths_m: Float64, curvatures_radpm: Float64, start: Float64, goal: Float64, ramp_m: float, step_m: float,
    poses: Float64,
) -> bool:  # fmt: skip
    """Corrects the lengths so that the curve ends at the goal; False without solution."""
    arm_m = 0.0
    for k in range(len(lengths_m)):
        arm_m = max(arm_m, abs(curvatures_radpm[k]))
    arm_m = 1.0 / max(arm_m, 1e-3)
    n = len(lengths_m)
    slopes, error = np.zeros((3, n)), np.zeros(3)
    square = np.zeros((3, 3))
    for _ in range(CORRECTIONS):
        if not _residual(lengths_m, curvatures_radpm, start, goal, ramp_m, step_m, arm_m, poses, error):
            return False
        if max(abs(error[0]), abs(error[1]), abs(error[2])) < TOLERANCE_M:
            return True
        _slopes(lengths_m, curvatures_radpm, goal[0] + error[0], goal[1] + error[1], step_m, arm_m, poses, slopes)
        for i in range(3):
            for j in range(3):
                square[i, j] = 1e-9 if i == j else 0.0
                for k in range(n):
                    square[i, j] += slopes[i, k] * slopes[j, k]
        weights = np.linalg.solve(square, error)
        for k in range(n):
            change = 0.0
            for i in range(3):
                change -= slopes[i, k] * weights[i]
            if abs(lengths_m[k]) >= 1e-9:
                if (lengths_m[k] + change) * lengths_m[k] <= 0.0:
                    return False
                lengths_m[k] += change
    return False


@kernel
def _slopes(
    lengths_m: Float64, curvatures_radpm: Float64, x_m: float, y_m: float, step_m: float, arm_m: float, poses: Float64,
    slopes: Float64,
) -> None:  # fmt: skip
    """Change (3, N) of the end (x, y) with each length: what follows the middle of a segment is moved and turned."""
    row, first = 0, 0
    while first < len(lengths_m):
        direction, last, total = (1.0 if lengths_m[first] > 0.0 else -1.0), first, 0.0
        while last < len(lengths_m) and lengths_m[last] * direction > -1e-9:
            total += abs(lengths_m[last])
            last += 1
        steps, at = max(1, math.ceil(total / step_m - 1e-9)), 0.0
        for k in range(first, last):
            length = abs(lengths_m[k])
            slopes[0, k] = slopes[1, k] = slopes[2, k] = 0.0
            if length >= 1e-9:
                n, bend = row + round((at + 0.5 * length) / total * steps), curvatures_radpm[k]
                slopes[0, k] = math.cos(poses[n, 2]) - bend * (y_m - poses[n, 1])
                slopes[1, k] = math.sin(poses[n, 2]) + bend * (x_m - poses[n, 0])
                slopes[2, k] = arm_m * bend
            at += length
        row += steps + 1 if total >= 1e-9 else 0
        first = last


@kernel
def _residual(
    lengths_m: Float64, curvatures_radpm: Float64, start: Float64, goal: Float64, ramp_m: float, step_m: float,
    arm_m: float, poses: Float64, error: Float64,
) -> bool:  # fmt: skip
    count = trace(lengths_m, curvatures_radpm, start, ramp_m, step_m, poses)
    if count == 0:
        return False
    error[0], error[1] = poses[count - 1, 0] - goal[0], poses[count - 1, 1] - goal[1]
    turn = poses[count - 1, 2] - goal[2]
    error[2] = arm_m * (turn - 2.0 * math.pi * math.floor((turn + math.pi) / (2.0 * math.pi)))
    return True
