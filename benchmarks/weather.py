"""Published models of bad weather, applied to the returns of a recorded scan.

Fog, two models. Hahner et al. 2021 ("Fog simulation on real lidar point clouds", with its parameters): the power of a
return falls by exp(-2 alpha R), alpha = ln 20 / visibility; where the fog before it gives more, the return is that of
the fog, at the range of the greatest response times 2^u, u uniform in ±1 (its noise variant v2). Rasshofer et al. 2011
as in `simulation.environment.air`: each beam, also those that met nothing, has a fog return of exponential strength.
Rain: a drop in the beam that the lidar can detect; drops by Marshall and Palmer 1948, the power of one by Kilic et al.
2021 (LISA): the share of the beam that it covers over r². Dust: beams end at uniform ranges.
The model of Hahner et al. loses no return; in the other a return below the detection limit of the lidar is lost: that
of 10 % reflectivity at 50 m (HDL-64E manual).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from configs.vehicle import Lidar
from geometry.arrays import Bool, Float32, Float64, Int64
from simulation.environment.air import (
    APERTURE_M,
    FOG_BACKSCATTER,
    LIDAR_RATIO_SR,
    OVERLAP_M,
    PULSE_M,
    SMALLEST_DROP_M,
    extinction_per_m,
    fog_ranges_m,
)

LEAST_POWER = 0.1 / 50.0**2  # reflectivity over r² of the weakest return
BACKSCATTER_HARD = 1e-6 / np.pi  # Hahner et al.
PULSE_S, LIGHT_MPS = 20e-9, 299_792_458.0  # half-power width of Hahner et al.
OVERLAP_HAHNER_M = (0.9, 1.0)
RAIN_MMPH, DIVERGENCE_RAD = 25.0, 2e-3
NEAREST_M = 1.0


@dataclass(frozen=True)
class Scan:
    """Returns (N, 3) in the frame of the lidar, their reflectivity (N,), which are clutter (N,), and the return of the
    scan before (N,) that each was, -1 for none."""

    points_m: Float32
    reflectivity: Float32
    is_clutter: Bool
    source: Int64


Weather = Callable[[Scan, Lidar, np.random.Generator], Scan]


def recorded(points_m: Float32, reflectivity: Float32) -> Scan:
    """A scan as recorded: what was detected had at least the least power."""
    square = (points_m.astype(np.float64) ** 2).sum(axis=1)
    n = len(points_m)
    known = np.maximum(reflectivity, LEAST_POWER * square).astype(np.float32)
    return _take(Scan(points_m, known, np.zeros(n, bool), np.arange(n)), square > 0.25)


def dropped(share: float) -> Weather:
    """A random share of the returns is lost."""
    return lambda scan, _, rng: _take(scan, rng.random(len(scan.points_m)) >= share)


def every_beam(step: int) -> Weather:
    """Only every so many rings of the lidar return."""

    def apply(scan: Scan, lidar: Lidar, _: np.random.Generator) -> Scan:
        ring, _column = beams_of(scan.points_m, lidar)
        return _take(scan, ring % step == 0)

    return apply


def fog_hahner(visibility_m: float) -> Weather:
    """Fog by Hahner et al."""
    alpha = extinction_per_m(visibility_m)

    def apply(scan: Scan, _: Lidar, rng: np.random.Generator) -> Scan:
        range_m = np.linalg.norm(scan.points_m, axis=1).astype(np.float64)
        grid_m, response, at_m = _fog_response(alpha)
        k = np.minimum(np.searchsorted(grid_m, range_m), len(grid_m) - 1)
        ratio = FOG_BACKSCATTER / visibility_m / BACKSCATTER_HARD
        hard, soft = np.exp(-2.0 * alpha * range_m) / range_m**2, ratio * response[k]
        fog_m = at_m[k] * 2.0 ** rng.uniform(-1.0, 1.0, len(range_m))
        return _stronger(scan, hard, soft, range_m, fog_m)

    return apply


@cache
def _fog_response(alpha: float) -> tuple[Float64, Float64, Float64]:
    """Range of a target, greatest response of the fog before it, and the range of that."""
    step = 0.05
    s = np.arange(step, 121.0, step)
    low, high = OVERLAP_HAHNER_M
    density = np.exp(-2.0 * alpha * s) / s**2 * np.clip((s - low) / (high - low), 0.0, 1.0)
    pulse_m = LIGHT_MPS * PULSE_S  # its whole length, in range
    pulse = np.sin(np.pi * np.arange(0.0, pulse_m, step) / pulse_m) ** 2
    response = np.convolve(density, pulse)[: len(s)] * step * 2.0 / LIGHT_MPS
    best = np.maximum.accumulate(response)
    return s, best, s[np.minimum(np.searchsorted(best, best), response.argmax())]


def fog_rasshofer(visibility_m: float) -> Weather:
    """Fog by Rasshofer et al., also in beams that met nothing."""
    alpha = extinction_per_m(visibility_m)
    quantiles = fog_ranges_m(alpha)
    reflectivity = np.pi * FOG_BACKSCATTER / visibility_m * PULSE_M

    def apply(scan: Scan, lidar: Lidar, rng: np.random.Generator) -> Scan:
        scan = with_empty_beams(scan, lidar)
        range_m = np.linalg.norm(scan.points_m, axis=1).astype(np.float64)
        u = rng.uniform(0.0, len(quantiles) - 1.0, len(range_m))
        fog_m = np.interp(u, np.arange(len(quantiles)), quantiles)
        overlap = np.clip((fog_m - OVERLAP_M[0]) / (OVERLAP_M[1] - OVERLAP_M[0]), 0.0, 1.0)
        strength = rng.exponential(reflectivity, len(range_m)) * overlap
        hard, soft = (r * np.exp(-2.0 * alpha * d) / d**2 for r, d in ((scan.reflectivity, range_m), (strength, fog_m)))
        is_seen = np.maximum(hard, soft) >= LEAST_POWER
        return _take(_stronger(scan, hard, np.where(fog_m < range_m, soft, 0.0), range_m, fog_m), is_seen)

    return apply


def _stronger(scan: Scan, hard: Float64, soft: Float64, range_m: Float64, fog_m: Float64) -> Scan:
    """The stronger return of each beam."""
    is_fog = soft > hard
    points = np.where(is_fog[:, None], scan.points_m * (fog_m / range_m)[:, None], scan.points_m).astype(np.float32)
    return Scan(points, scan.reflectivity, scan.is_clutter | is_fog, scan.source)


def rain(count: int) -> Weather:
    """`count` beams end at a drop."""
    scale_m = 1e-3 / (4.1 * RAIN_MMPH**-0.21)
    r = np.linspace(NEAREST_M, 30.0, 3000)
    width = APERTURE_M + DIVERGENCE_RAD * r
    least_m = np.maximum(SMALLEST_DROP_M, width * r * np.sqrt(LEAST_POWER * LIDAR_RATIO_SR / np.pi))
    share = np.cumsum(width**2 * np.exp(-least_m / scale_m))
    return _ended(count, lambda rng, n: np.interp(rng.random(n), share / share[-1], r), 180.0)


def noise(count: int, reach_m: float) -> Weather:
    """`count` beams end at ranges that are uniform up to `reach_m`."""
    return _ended(count, lambda rng, n: rng.uniform(2.0, reach_m, n), 180.0)


def dust(count: int, half_deg: float) -> Weather:
    """`count` beams within an angle of the x axis end in a cloud 3 to 10 m away."""
    return _ended(count, lambda rng, n: rng.uniform(3.0, 10.0, n), half_deg)


def _ended(count: int, ranges: Callable[[np.random.Generator, int], Float64], half_deg: float) -> Weather:
    def apply(scan: Scan, lidar: Lidar, rng: np.random.Generator) -> Scan:
        scan = with_empty_beams(scan, lidar)
        ahead = np.abs(np.arctan2(scan.points_m[:, 1], scan.points_m[:, 0])) <= np.radians(half_deg)
        beams = rng.permutation(np.flatnonzero(ahead))
        at_m = ranges(rng, len(beams))
        full_m = np.linalg.norm(scan.points_m[beams], axis=1)
        hit = np.flatnonzero(at_m < full_m)[:count]
        points, is_clutter = scan.points_m.copy(), scan.is_clutter.copy()
        points[beams[hit]] *= (at_m[hit] / full_m[hit])[:, None]
        is_clutter[beams[hit]] = True
        ended = Scan(points, scan.reflectivity, is_clutter, scan.source)
        return _take(ended, (scan.source >= 0) | is_clutter)

    return apply


def with_empty_beams(scan: Scan, lidar: Lidar) -> Scan:
    """The scan, and beams of the lidar without a return: far away, without reflectivity."""
    ring, column = beams_of(scan.points_m, lidar)
    is_met = np.zeros((len(lidar.elevation_deg), lidar.columns), bool)
    is_met[ring, column] = True
    # up and down by one beam: real elevations are not those of the table
    near = is_met | np.roll(is_met, 1, 1) | np.roll(is_met, -1, 1)
    near[1:] |= is_met[:-1]
    near[:-1] |= is_met[1:]
    ring, column = np.nonzero(~near)
    el = np.radians(np.sort(np.array(lidar.elevation_deg)))[ring]
    az = (column + 0.5) * (2.0 * np.pi / lidar.columns) - np.pi
    far = 1000.0 * np.column_stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)])
    n = len(ring)
    return Scan(
        np.concatenate([scan.points_m, far.astype(np.float32)]),
        np.concatenate([scan.reflectivity, np.zeros(n, np.float32)]),
        np.concatenate([scan.is_clutter, np.zeros(n, bool)]),
        np.concatenate([scan.source, np.full(n, -1)]),
    )


def beams_of(points_m: Float32, lidar: Lidar) -> tuple[Int64, Int64]:
    """Ring, counted from the lowest, and column of each return (N,): the nearest of the lidar's table."""
    tangents = np.tan(np.radians(np.sort(np.array(lidar.elevation_deg))))
    flat = np.hypot(points_m[:, 0], points_m[:, 1])
    ring = np.searchsorted((tangents[:-1] + tangents[1:]) / 2.0, points_m[:, 2] / np.maximum(flat, 1e-6))
    azimuth = np.arctan2(points_m[:, 1], points_m[:, 0])
    return ring, ((azimuth + np.pi) * (lidar.columns / (2.0 * np.pi))).astype(np.int64) % lidar.columns


def _take(scan: Scan, kept: Bool) -> Scan:
    return Scan(scan.points_m[kept], scan.reflectivity[kept], scan.is_clutter[kept], scan.source[kept])


WEATHERS: dict[str, Weather] = {
    "as recorded": lambda scan, _lidar, _rng: scan,
    "30 % dropped": dropped(0.3),
    "60 % dropped": dropped(0.6),
    "every 2nd beam": every_beam(2),
    "every 4th beam": every_beam(4),
    **{f"fog {v} m, Hahner": fog_hahner(v) for v in (200, 100, 50, 30)},
    **{f"fog {v} m, Rasshofer": fog_rasshofer(v) for v in (200, 100, 50, 30)},
    "rain 400": rain(400),
    "rain 1500": rain(1500),
    "noise to 20 m 1500": noise(1500, 20.0),
    "dust 500": dust(500, 180.0),
    "dust 2000": dust(2000, 180.0),
    "dust 500 ahead": dust(500, 30.0),
    "dust 2000 ahead": dust(2000, 30.0),
}
