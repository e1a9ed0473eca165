"""Negative obstacles in the range image of a lidar: ditches, pits and edges where the ground falls away.

Between two returns of the ground next to each other in a column it falls more steeply than before the first and behind
the second: no crest does that, it is steepest at one of them. A beam that passes through the surface travels beneath it
for a run before it returns, which in furrows and wheel tracks is no longer than they are wide.

    o sensor
       `──.__
    ─────────`─.        ,────────── ground before and behind
              │ `──.__ /
              ├─ run ─►x   return, `depth` below the ground
"""

import numpy as np

from geometry.arrays import Float64, Int64
from geometry.jit import inline_kernel, kernel

REACH_M = 2.5  # from a return, in which others show the grade of the ground
MIN_SPAN_M = 0.5  # that they cover
STEEPEST = 0.3  # of the ground, against the plane through the wheels
FAR_SIDE_M = 2.0  # before and behind a return, in which both sides of a ditch are seen
ABOVE_M = 0.05  # what rises more above such ground before it is none: the foot of a wall


@kernel
def negative_obstacles(
    columns: Int64, run_m: Float64, z_m: Float64, sensor_z_m: float, depth_m: float, beneath_m: float, fall: float
) -> Float64:
    """Horizontal distance of the last return of the ground before each return (N,) of a negative obstacle; else 0.

    `columns` (N,): column of each, ascending; within one, returns are ordered from the lowest beam to the highest.
    `run_m` (N,): horizontal distance from the sensor; `z_m` (N,): height in base. `depth_m`, `beneath_m`: least depth
    and run of one; `fall`: least grade at which the ground falls away, more than that on both sides, unless it rises
    again.
    """
    out = np.zeros(len(run_m))
    ground = np.empty(len(run_m), np.int64)  # returns of the ground in this column
    k, count = 0, len(run_m)
    while k < count:
        end, known = k, 0
        while end < count and columns[end] == columns[k]:
            end += 1
        for i in range(k, end):
            x, z = run_m[i], z_m[i]
            if known == 0:
                if abs(z) <= STEEPEST * x + ABOVE_M:
                    ground[0], known = i, 1
                continue
            last = ground[known - 1]
            gap_m = x - run_m[last]
            if gap_m <= 0.0 or z > z_m[last] + STEEPEST * gap_m + ABOVE_M:
                continue
            grade = _grade_before(ground[:known], run_m, z_m)
            fallen_m = z_m[last] + min(grade, _grade_behind(i, end, run_m, z_m)) * gap_m - z
            steepness = (sensor_z_m - z) / x
            is_hole = fallen_m >= max(depth_m, beneath_m * steepness)
            if is_hole and fallen_m < fall * gap_m:
                is_hole = gap_m <= FAR_SIDE_M and _rises_behind(i, end, run_m, z_m, depth_m)
            if is_hole:
                out[i] = run_m[last]
            else:
                ground[known] = i
                known += 1
        k = end
    return out


@inline_kernel
def _rises_behind(first: int, end: int, run_m: Float64, z_m: Float64, by_m: float) -> bool:
    """Whether the ground behind a return is higher: the far side of a ditch."""
    is_higher = False
    for k in range(first + 1, end):
        if run_m[k] > run_m[first] + FAR_SIDE_M:
            break
        is_higher = is_higher or z_m[k] >= z_m[first] + by_m
    return is_higher


@inline_kernel
def _grade_before(ground: Int64, run_m: Float64, z_m: Float64) -> float:
    """Grade of the ground up to the last of its returns; level where few show it."""
    n = sx = sz = sxx = sxz = 0.0
    last = ground[-1]
    for k in range(len(ground) - 1, -1, -1):
        u, z = run_m[ground[k]] - run_m[last], z_m[ground[k]] - z_m[last]
        if u < -REACH_M:
            break
        n, sx, sz, sxx, sxz = n + 1.0, sx + u, sz + z, sxx + u * u, sxz + u * z
    spread = sxx - sx * sx / n
    grade = (sxz - sx * sz / n) / (spread + 0.25 * MIN_SPAN_M)
    return min(max(grade, -STEEPEST), STEEPEST)


@inline_kernel
def _grade_behind(first: int, end: int, run_m: Float64, z_m: Float64) -> float:
    """Grade from a return on; the steepest descent where none show it."""
    n = sx = sz = sxx = sxz = 0.0
    for k in range(first, end):
        u, z = run_m[k] - run_m[first], z_m[k] - z_m[first]
        if u > REACH_M:
            break
        n, sx, sz, sxx, sxz = n + 1.0, sx + u, sz + z, sxx + u * u, sxz + u * z
    spread = sxx - sx * sx / n
    grade = (sxz - sx * sz / n) / max(spread, 1e-9) if spread >= MIN_SPAN_M * MIN_SPAN_M / 6.0 else -STEEPEST
    return min(max(grade, -STEEPEST), STEEPEST)
