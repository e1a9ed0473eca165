"""Compiled kernels: beams through a layer of plants on uneven ground (arrays as in `simulation.environment.canopy`)."""

import math

import numpy as np

from geometry.arrays import Float32, Float64, UInt8
from geometry.jit import inline_kernel, kernel

STEP_M = 0.25  # inside the canopy, where extinction is constant
BEFORE_M = 0.05
NEAR_M = 0.02  # shortest step towards it
MAX_STEPS = 500


@inline_kernel
def ground_at(x: float, y: float, ground: Float32, grid: Float64) -> tuple[float, int, int]:
    """Height of the ground, bilinear, and nearest row and column; row -1 outside of the grid."""
    u, v = (x - grid[0]) / grid[2], (y - grid[1]) / grid[2]
    if not (0.0 <= u < ground.shape[1] - 1 and 0.0 <= v < ground.shape[0] - 1):  # also infinite, and no number
        return 0.0, -1, -1
    j, i = int(u), int(v)
    a, b = u - j, v - i
    low = (1.0 - a) * ground[i, j] + a * ground[i, j + 1]
    high = (1.0 - a) * ground[i + 1, j] + a * ground[i + 1, j + 1]
    return (1.0 - b) * low + b * high, i + int(b + 0.5), j + int(a + 0.5)


@inline_kernel
def entry(ray: Float32, top: float, ground: Float32, grid: Float64, tallest: float) -> float:
    """Range from which plants can follow: just before the surface of their tops, 0 for a sensor below the tallest."""
    g, i, _ = ground_at(ray[0], ray[1], ground, grid)
    return 0.0 if i >= 0 and ray[2] - g < tallest else max(top - BEFORE_M, 0.0)


@inline_kernel
def next_piece(
    t: float, ray: Float32, flat: float, ground: Float32, stand: UInt8, grid: Float64, stands: Float64, tallest: float,
    max_slope: float,
) -> tuple[float, float, int]:  # fmt: skip
    """From range t: length of the next step, extinction on it, and stand (0: none); length 0 where no plant follows."""
    z = ray[2] + t * ray[5]
    g, i, j = ground_at(ray[0] + t * ray[3], ray[1] + t * ray[4], ground, grid)
    above = z - g - tallest
    length, k, found = STEP_M, 0.0, 0
    if i < 0:
        length = 0.0
    elif above > 0.0:  # no step reaches the top of the tallest plants on ground of the largest slope
        closing = max_slope * flat - ray[5]
        length = max(above / closing, NEAR_M) if closing > 1e-3 else 0.0
    else:
        s = stand[i, j]
        if s > 0 and z - g < stands[s - 1, 0]:
            found, k = s, stands[s - 1, 1] + stands[s - 1, 2] * flat
    return length, k, found


@kernel
def canopy_hits(
    rays: Float32, tops: Float32, until: Float32, depths: Float32, divergence: float, ground: Float32, stand: UInt8,
    grid: Float64, stands: Float64, max_slope: float,
) -> tuple[Float32, UInt8]:  # fmt: skip
    """See `Canopy.hits`."""
    n, parts = until.shape
    out, which = np.full((n, parts), np.inf, np.float32), np.zeros((n, parts), np.uint8)
    tallest = stands[:, 0].max()
    for m in range(n):
        ray = rays[m]
        flat = math.sqrt(ray[3] * ray[3] + ray[4] * ray[4])
        far, deepest, shallowest = until[m].max(), depths[m].max(), depths[m].min()
        t, depth, separate = entry(ray, tops[m], ground, grid, tallest), 0.0, 0
        for _ in range(MAX_STEPS):
            length, k, s = next_piece(t, ray, flat, ground, stand, grid, stands, tallest, max_slope)
            if length == 0.0 or t > far:
                break
            if k > 0.0 and separate == 0:  # plant parts in the beam where it enters
                separate = int(min(max((divergence * t / stands[s - 1, 3]) ** 2, 1.0), float(parts)))
            if k > 0.0 and depth + k * length >= shallowest:
                for p in range(parts):
                    rest = depths[m, p % separate] - depth
                    at = t + rest / k
                    if 0.0 < rest <= k * length and at < until[m, p] and out[m, p] == np.inf:
                        out[m, p], which[m, p] = at, s
            depth += k * length
            t += length
            if depth > deepest:
                break
    return out, which


@kernel
def optical_depths(
    rays: Float32,
    tops: Float32,
    until: Float32,
    ground: Float32,
    stand: UInt8,
    grid: Float64,
    stands: Float64,
    max_slope: float,
) -> Float64:
    """See `Canopy.optical_depth`."""
    out, tallest = np.zeros(rays.shape[0]), stands[:, 0].max()
    for m in range(rays.shape[0]):
        ray = rays[m]
        t = entry(ray, tops[m], ground, grid, tallest)
        flat = math.sqrt(ray[3] * ray[3] + ray[4] * ray[4])
        for _ in range(MAX_STEPS):
            length, k, _s = next_piece(t, ray, flat, ground, stand, grid, stands, tallest, max_slope)
            if length == 0.0 or t >= until[m]:
                break
            out[m] += k * min(length, until[m] - t)
            t += length
    return out
