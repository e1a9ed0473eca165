"""Noise textures with mip levels, in one flat array; the mean of each is `UNIT`."""

import math
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt

from geometry.arrays import Float32, Float64, UInt8
from geometry.jit import inline_kernel
from simulation.randomness import generator

Int8 = npt.NDArray[np.int8]
SIDE = 512
MIP_LEVELS = 8
UNIT = 64.0  # level of 1.0
SOIL, GRASS, GRAIN, CLOUD = range(4)


@dataclass(frozen=True)
class Textures:
    """`values` (K, n): all levels in sequence; level l is a square of SIDE >> l."""

    values: UInt8


@cache
def textures() -> Textures:
    """All textures; independent of the run's seed."""
    random = generator(0, "textures")
    soil = _layers(random, ((3, 0.5), (8, 0.6), (24, 0.9), (80, 1.0), (256, 1.1)), 1.0)
    clods = np.maximum(_layers(random, ((40, 1.0), (110, 0.8)), 1.0), 0.0)
    grass = _layers(random, ((4, 0.6), (16, 0.6), (64, 0.8)), 1.0) + _layers(random, ((128, 1.0), (300, 1.4)), 4.0)
    grain = _layers(random, ((6, 0.6), (20, 0.8), (60, 0.9), (200, 0.9)), 1.0)
    cloud = _layers(random, ((3, 1.0), (6, 0.8), (12, 0.5), (28, 0.3), (70, 0.15)), 1.0)
    planes = [_scaled(soil + 1.2 * clods, 0.34), _scaled(grass, 0.36), _scaled(grain, 0.28), _scaled(cloud, 0.5)]
    return Textures(np.rint(np.stack([_pyramid(plane) for plane in planes]) * UNIT).clip(0, 255).astype(np.uint8))


def _layers(random: np.random.Generator, layers: tuple[tuple[int, float], ...], stretch: float) -> Float64:
    """Sum of periodic band-limited noise: cells per side, and strength."""
    frequency = np.fft.fftfreq(SIDE) * SIDE
    fy, fx = np.meshgrid(frequency * stretch, frequency, indexing="ij")
    radius = np.hypot(fx, fy)
    total = np.zeros((SIDE, SIDE))
    for cells, strength in layers:
        white = np.fft.fft2(random.standard_normal((SIDE, SIDE)))
        band = np.real(np.fft.ifft2(white * np.exp(-((radius - cells) ** 2) / (0.5 * (0.6 * cells) ** 2))))
        total += strength * band / band.std()
    return total


def _scaled(plane: Float64, deviation: float) -> Float32:
    """Mean 1 with this deviation, at least 0.1."""
    return np.asarray(np.maximum(1.0 + deviation * (plane - plane.mean()) / plane.std(), 0.1), np.float32)


def _pyramid(plane: Float32) -> Float32:
    levels = [plane]
    for _ in range(MIP_LEVELS - 1):
        side = levels[-1].shape[0] // 2
        levels.append(np.asarray(cv2.resize(levels[-1], (side, side), interpolation=cv2.INTER_AREA), np.float32))
    return np.concatenate([level.ravel() for level in levels])


@inline_kernel
def mip_level(scale: float, pixel_m: float) -> tuple[int, int, float]:
    """Mip level for pixels `pixel_m` wide and `scale` texels per metre: its start, side minus one, texels per metre."""
    start, side = 0, SIDE
    while scale * pixel_m > 1.4 and side > SIDE >> (MIP_LEVELS - 1):
        start += side * side
        side >>= 1
        scale *= 0.5
    return start, side - 1, scale


@inline_kernel
def nearest_texel(planes: UInt8, which: int, start: int, mask: int, u: float, v: float) -> float:
    """The texel at (u, v) of a level."""
    i, j = math.floor(u) & mask, math.floor(v) & mask
    return float(planes[which, np.uint32(start + j * (mask + 1) + i)] * (1.0 / UNIT))


@inline_kernel
def bilinear(planes: UInt8, which: int, start: int, mask: int, u: float, v: float) -> float:
    """Bilinear interpolation at (u, v) of a level."""
    i, j = math.floor(u), math.floor(v)
    f, g = u - i, v - j
    a, b = start + (j & mask) * (mask + 1), start + ((j + 1) & mask) * (mask + 1)
    i, k = i & mask, (i + 1) & mask
    low = planes[which, np.uint32(a + i)] * (1.0 - f) + planes[which, np.uint32(a + k)] * f
    high = planes[which, np.uint32(b + i)] * (1.0 - f) + planes[which, np.uint32(b + k)] * f
    return float((low * (1.0 - g) + high * g) * (1.0 / UNIT))


def texture_table() -> Float64:
    """For each `Material` its texture (-1: none), texels per metre, and the mapping of u and v.

    u = scale (x + along (y + z)), v = scale stretch (z + across (y - 0.4 x)); the sixth number is the strength.
    Texels are at most a pixel wide some metres away, since the nearest is taken.
    """
    table = np.full((12, 6), -1.0)
    # on the ground v runs along y alone, so that slopes do not stretch it: large across, small stretch
    flat = 1e4
    table[1] = [SOIL, 75.0, 0.3, flat, 1.0 / flat, 1.6]
    table[2] = [GRASS, 90.0, 0.3, flat, 1.0 / flat, 1.2]
    table[3] = [GRAIN, 80.0, 0.3, flat, 1.0 / flat, 1.3]
    table[4] = [GRASS, 60.0, 0.4, 0.8, 1.0, 1.7]
    table[5] = [GRAIN, 60.0, 0.5, 0.0, 4.0, 1.0]
    table[6] = [GRAIN, 60.0, 0.5, 0.0, 0.4, 0.25]
    table[9] = [GRAIN, 100.0, 0.5, 0.7, 1.0, 0.16]
    table[10] = [GRASS, 100.0, 0.4, 0.5, 1.0, 0.4]
    table[11] = [GRAIN, 120.0, 0.0, 6.0, 0.16, 1.0]
    return table
