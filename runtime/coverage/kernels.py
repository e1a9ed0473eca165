"""Compiled kernels: places that outlines reach, and returns of a lidar on an upright body at every place."""

import math

from geometry.arrays import Bool, Float64, Int64
from geometry.jit import kernel

STEEPEST = 1e-3  # least horizontal part of a ray's direction: a vertical ray keeps a direction


@kernel
def mark_reached(
    x_m: Float64, y_m: Float64, poses: Float64, rear_m: float, front_m: float, half_m: float, out: Bool
) -> None:
    """Marks the places (X, Y) inside a rectangle of a carrier at any of its poses (M, 3)."""
    for k in range(poses.shape[0]):
        c, s = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        for i in range(x_m.shape[0]):
            dx = x_m[i] - poses[k, 0]
            for j in range(y_m.shape[0]):
                dy = y_m[j] - poses[k, 1]
                along, across = c * dx + s * dy, c * dy - s * dx
                if rear_m <= along <= front_m and abs(across) <= half_m:
                    out[i, j] = True


@kernel
def hit_range(z_m: float, slope: float, near_m: float, far_m: float, low_m: float, top_m: float) -> float:
    """Horizontal range at which a ray from height `z_m` meets a body between two ranges; below 0: not.

    It meets the side between `low_m` and `top_m`, or the top. A ray that begins in the body does not meet it.
    """
    at_near, at_far = z_m + slope * near_m, z_m + slope * far_m
    if near_m > 0.0 and low_m <= at_near <= top_m:
        return near_m
    if at_near > top_m >= at_far and top_m >= low_m:
        return (top_m - z_m) / slope
    return -1.0


@kernel
def count_returns(
    rays: Float64, reach_m: Float64, x_m: Float64, y_m: Float64, low_m: Float64, top_m: Float64, radius_m: float,
    own_m: Float64, out: Int64,
) -> None:  # fmt: skip
    """Adds to `out` (H, X, Y) the returns of rays (N, 6: origin and direction) on a body at each place.

    `reach_m` (N, 2): shortest and longest range; `low_m` (X, Y): height from which a return counts; `top_m` (H,):
    heights of the bodies; `own_m` (K, 4: rear, front, right, left): returns in there are filtered out.
    """
    step, lowest, highest = x_m[1] - x_m[0], low_m.min(), top_m.max()
    for n in range(rays.shape[0]):
        ox, oy, oz = rays[n, 0], rays[n, 1], rays[n, 2]
        flat = math.hypot(rays[n, 3], rays[n, 4])
        if flat < STEEPEST:
            flat, ux, uy = STEEPEST, 1.0, 0.0
        else:
            ux, uy = rays[n, 3] / flat, rays[n, 4] / flat
        slope = rays[n, 5] / flat
        first, last = 0.0, reach_m[n, 1] * flat + radius_m
        if slope < 0.0:
            first = max(first, (oz - highest) / -slope - radius_m)
            last = min(last, (oz - lowest) / -slope + radius_m)
        elif oz > highest:
            continue
        if last <= first:
            continue
        is_x_major = abs(ux) >= abs(uy)
        major, minor = (x_m, y_m) if is_x_major else (y_m, x_m)
        o_major, o_minor = (ox, oy) if is_x_major else (oy, ox)
        u_major, u_minor = (ux, uy) if is_x_major else (uy, ux)
        ends = (o_major + u_major * first, o_major + u_major * last)
        a_first = max(0, math.ceil((min(ends[0], ends[1]) - radius_m - major[0]) / step))
        a_last = min(major.shape[0] - 1, math.floor((max(ends[0], ends[1]) + radius_m - major[0]) / step))
        wide = radius_m / abs(u_major)
        for a in range(a_first, a_last + 1):
            middle = o_minor + u_minor / u_major * (major[a] - o_major)
            b_first = max(0, math.ceil((middle - wide - minor[0]) / step))
            b_last = min(minor.shape[0] - 1, math.floor((middle + wide - minor[0]) / step))
            for b in range(b_first, b_last + 1):
                i, j = (a, b) if is_x_major else (b, a)
                dx, dy = x_m[i] - ox, y_m[j] - oy
                along, aside = dx * ux + dy * uy, dy * ux - dx * uy
                square = radius_m * radius_m - aside * aside
                if square <= 0.0:
                    continue
                half = math.sqrt(square)
                if along + half <= 0.0:
                    continue
                for h in range(top_m.shape[0]):
                    at = hit_range(oz, slope, max(along - half, 0.0), along + half, low_m[i, j], top_m[h])
                    if at < 0.0 or not reach_m[n, 0] <= at / flat <= reach_m[n, 1]:
                        continue
                    px, py = ox + ux * at, oy + uy * at
                    is_own = False
                    for k in range(own_m.shape[0]):
                        is_own |= own_m[k, 0] <= px <= own_m[k, 1] and own_m[k, 2] <= py <= own_m[k, 3]
                    if not is_own:
                        out[h, i, j] += 1
