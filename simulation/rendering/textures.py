"""Textures made of noise, each with its ever coarser copies, all in one flat array; the mean of each is 1."""

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from messages.message import Float32, Float64
from simulation.randomness import generator

SIDE = 512
LEVELS = 8
SOIL, GRASS, GRAIN, CLOUD = range(4)


@dataclass(frozen=True)
class Textures:
    """`values` (K, n) of all levels behind each other; level l is a square of SIDE >> l from `starts`."""

    values: Float32


@cache
def textures() -> Textures:
    """All textures; the same in every run, for the world is made of the same stuff."""
    random = generator(0, "textures")
    soil = _layers(random, ((3, 0.5), (8, 0.6), (24, 0.9), (80, 1.0), (256, 1.1)), 1.0)
    clods = np.maximum(_layers(random, ((40, 1.0), (110, 0.8)), 1.0), 0.0)
    grass = _layers(random, ((4, 0.6), (16, 0.6), (64, 0.8)), 1.0) + _layers(random, ((128, 1.0), (300, 1.4)), 4.0)
    grain = _layers(random, ((6, 0.6), (20, 0.8), (60, 0.9), (200, 0.9)), 1.0)
    cloud = _layers(random, ((3, 1.0), (6, 0.8), (12, 0.5), (28, 0.3), (70, 0.15)), 1.0)
    planes = [_scaled(soil + 1.2 * clods, 0.34), _scaled(grass, 0.36), _scaled(grain, 0.28), _scaled(cloud, 0.5)]
    return Textures(np.stack([_pyramid(plane) for plane in planes]))


def _layers(random: np.random.Generator, layers: tuple[tuple[int, float], ...], stretch: float) -> Float64:
    """Sum of band noise that repeats at the borders: cells over the side, and strength."""
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
    """About 1 with this deviation, nowhere below 0.1."""
    return np.maximum(1.0 + deviation * (plane - plane.mean()) / plane.std(), 0.1).astype(np.float32)


def _pyramid(plane: Float32) -> Float32:
    levels = [plane]
    for _ in range(LEVELS - 1):
        side = levels[-1].shape[0] // 2
        levels.append(np.asarray(cv2.resize(levels[-1], (side, side), interpolation=cv2.INTER_AREA), np.float32))
    return np.concatenate([level.ravel() for level in levels])
