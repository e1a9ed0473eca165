"""Evidence in the range image of a lidar: whether a return belongs to a surface, and whether it is borne by the ground.

Beams next to each other that meet a body return from next to each other; dust, drops and flakes return on single
beams. A body on the ground blocks all beams below its top; below a body in the air they return from beyond it.

    column of one azimuth, seen from the side        o  sensor
      o────────────────►x        x  the return         \\
       \\ `──────.___        ►    beams that pass below it, and return from beyond
        \\            `►   ►
    ─────►──────────────────────── ground
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geometry.arrays import Bool, Float32, Float64, Int32, Int64, UInt16
from geometry.fast_angle import azimuth_of
from geometry.jit import inline_kernel, kernel

COLUMNS_ASIDE = 2  # neighbours of a return: three rings by five columns
NEAR_M, NEAR_SLOPE = 0.1, 2.0  # greatest difference of range of neighbours: noise, and per metre across: 63° of slant
STEEP, GAP_M = 0.6, 0.4  # slope of a beam that meets a body from above, and height of that above the ground
BESIDE_M = 0.3  # horizontal distance within which a beam returns from the same body
BANDS_M = (3.0, 5.0, 7.0, 10.0, 14.0, 20.0)  # ends of bands of range, in which fog is about equally dense
SECTORS, LOCAL = 24, 0.25  # of a field of view; share of the mean of isolated returns from which on one has scatter
SAMPLE, SCATTERED = 10_000, 32  # returns by which scatter is found; its fewest returns without a neighbour
KEPT_BESIDE = 2  # returns of a body, next to which a scattered one is its edge
IN_RING = 4 / 14  # of the places next to a return
SUGGESTIVE, SIGNIFICANT = 1.0, 3.0  # sigmas by which fewer have one neighbour than none, in a sample and of all
DENSEST, DENSE_SLACK = 2.0, 1.5  # greatest mean of neighbours by chance; returns with two over those by chance
MEMORY, FRESH_M = 0.9, 0.1  # share of a sum of scans that the next keeps; change of range in a place that is new
BY_CHANCE = 0.5  # random returns of a scan and band that are left over, on average
SLACK_RAD = 1e-6  # for rounding
STEEPEST, SLOPE_STEPS = 8.0, 2000.0  # greatest slope of the table of rings (83 degrees), and its steps per unit
CLOSED_RAD = 6.2  # field of view whose first and last column are neighbours


@dataclass(frozen=True)
class RangeImage:
    """Ranges (rings, columns) in mm, 0 = no return; `rows` (rings,) from the lowest ring to the highest, and `rank` of
    each row in that order; elevation (rings,) and azimuth (columns,) of the beams."""

    ranges_mm: UInt16
    rows: Int64
    rank: Int64
    elevation_rad: Float64
    azimuth_rad: Float64

    @cached_property
    def directions(self) -> tuple[Float64, Float64, Float64, Float64]:
        """Cosine and sine of elevation (rings,), cosine and sine of azimuth (columns,)."""
        el, az = self.elevation_rad, self.azimuth_rad
        return np.cos(el), np.sin(el), np.cos(az), np.sin(az)

    def without(self, pixels: Int64) -> "RangeImage":
        """The image without the returns at places (K,) in the flattened image."""
        ranges_mm = self.ranges_mm.copy()
        ranges_mm.reshape(-1)[pixels] = 0
        return replace(self, ranges_mm=ranges_mm)


def range_image(ranges_mm: UInt16, elevation_rad: Float64, azimuth_rad: Float64) -> RangeImage:
    """Range image of a scan whose azimuths are equally spaced."""
    rows = np.argsort(elevation_rad, kind="stable")
    return RangeImage(ranges_mm, rows, np.argsort(rows, kind="stable"), elevation_rad, azimuth_rad)


@dataclass(frozen=True)
class BeamGrid:
    """Beams of a lidar to which the returns of a list are assigned.

    `elevation_rad` (rings,) from the lowest on; `columns` of a whole turn; `ring_table`: ring by steps of the slope.
    """

    elevation_rad: Float64
    columns: int
    ring_table: Int32

    def place(self, points_m: Float32) -> tuple[RangeImage, Int64]:
        """Range image of returns (N, 3) in the sensor frame, and the place of each in it, flattened, (N,).

        The elevations of a real lidar differ from its table: the nearest of several returns in a place is in the image.
        """
        azimuth = np.asarray((np.arange(self.columns) + 0.5) * (2.0 * np.pi / self.columns) - np.pi, np.float64)
        ranges_mm, pixels = (
            np.zeros((len(self.elevation_rad), self.columns), np.uint16),
            np.empty(len(points_m), np.int64),
        )
        _place(np.ascontiguousarray(points_m, np.float32), self.ring_table, self.columns, ranges_mm.reshape(-1), pixels)
        return range_image(ranges_mm, self.elevation_rad, azimuth), pixels


def beam_grid(elevation_rad: Float64, column_rad: float) -> BeamGrid:
    """Grid of a lidar with these elevations (rings,) and this angle between columns."""
    order = np.sort(elevation_rad)
    slopes, steps = np.tan(order), np.arange(-STEEPEST, STEEPEST, 1.0 / SLOPE_STEPS) + 0.5 / SLOPE_STEPS
    table = np.searchsorted((slopes[:-1] + slopes[1:]) / 2.0, steps).astype(np.int32)
    return BeamGrid(order, max(1, round(2.0 * math.pi / column_rad)), table)


def points_of(ranges_mm: UInt16, elevation_rad: Float64, azimuth_rad: Float64) -> Float32:
    """Returns (K, 3) in the sensor frame, row by row of the image; raises ValueError where the shapes disagree."""
    if ranges_mm.shape != (len(elevation_rad), len(azimuth_rad)):
        beams = f"{len(elevation_rad)} elevations and {len(azimuth_rad)} azimuths"
        raise ValueError(f"range image of shape {ranges_mm.shape}: the beams have {beams}")
    el, az = (np.array([np.cos(angle), np.sin(angle)], np.float32) for angle in (elevation_rad, azimuth_rad))
    points = np.empty((np.count_nonzero(ranges_mm != 0), 3), np.float32)
    _fill_points(ranges_mm, el[0], el[1], az[0], az[1], points)
    return points


def isolated(image: RangeImage, pixels: Int64) -> Bool:
    """Which returns, by their places `pixels` (K,) in the flattened image, are fewer than three next to each other."""
    out = np.empty(len(pixels), np.bool_)
    _mark_isolated(image.ranges_mm, image.rows, image.rank, image.elevation_rad, *_columns(image), pixels, out)
    return out


def _columns(image: RangeImage) -> tuple[float, bool]:
    """Angle between columns, and whether the first and the last are neighbours."""
    azimuth = image.azimuth_rad
    span_rad = abs(float(azimuth[-1] - azimuth[0])) if len(azimuth) > 1 else 0.0
    column_rad = span_rad / max(len(azimuth) - 1, 1)
    return column_rad, span_rad + column_rad > CLOSED_RAD


def dust(image: RangeImage, pixels: Int64, within_m: float, least: int) -> Bool:
    """Which returns, as in `isolated`, are isolated within a range; none where fewer than `least` are, (K,)."""
    is_dust = isolated(image, pixels) & (image.ranges_mm.ravel()[pixels] <= 1000.0 * within_m)
    return is_dust & (np.count_nonzero(is_dust) >= least)


class ScatterMemory:
    """Counts of the last scans of one lidar, for lidars with too few returns to show thin fog in one.

    Only returns at another range than in the scan before count: scatter is new in each, a body of single returns stays.
    """

    def __init__(self) -> None:
        self._before: UInt16 = np.zeros((0, 0), np.uint16)
        self.counts: Float64 = np.zeros((3, len(BANDS_M), SECTORS))
        self.scans = 0.0

    def before(self, ranges_mm: UInt16) -> UInt16:
        """Ranges of the scan before, those of this one where that had other beams."""
        last, self._before = self._before, ranges_mm
        if last.shape == ranges_mm.shape:
            return last
        self.counts[:], self.scans = 0.0, 0.0
        return ranges_mm

    def add(self, counts: Int64) -> None:
        """Takes the counts (3, B, S) of a scan."""
        self.counts, self.scans = MEMORY * self.counts + counts, MEMORY * self.scans + 1.0


def scattered(image: RangeImage, pixels: Int64, memory: ScatterMemory | None = None) -> Bool:
    """Which returns of a whole scan, by their places `pixels` (K,) in the flattened image, are of fog, rain or dense
    dust, (K,). With a `memory` the scans before are evidence too.

    Returns that lie in the air at random have a Poisson number of others next to them: in a band of ranges fewer have
    one than none, while of plants and other bodies more have. Those with no more than chance gives, in all and in their
    ring, are scattered, and those that are isolated without them, in the sectors of the field of view that have
    isolated returns. The ground between rings that are far apart has others in its ring alone.
    """
    most = _most_by_chance(image, pixels, memory)
    out = np.zeros(len(pixels), np.bool_)
    if most.any():
        beams = image.rows, image.rank, image.elevation_rad, *_columns(image)
        _mark_scattered(image.ranges_mm, *beams, pixels, most, out)
        rest = image.ranges_mm.copy()
        rest.ravel()[pixels[out]] = 0
        _keep_beside(image.ranges_mm, rest, *beams, pixels, out)
        rest.ravel()[pixels[~out]] = image.ranges_mm.ravel()[pixels[~out]]
        left = np.flatnonzero(~out & (most[_sectors(image, pixels), _bands(image, pixels), 0] > 0))
        out[left] = isolated(replace(image, ranges_mm=rest), pixels[left])
    return out


def _bands(image: RangeImage, pixels: Int64) -> Int64:
    return np.searchsorted(BANDS_M, 1e-3 * image.ranges_mm.ravel()[pixels])


def _sectors(image: RangeImage, pixels: Int64) -> Int64:
    columns = image.ranges_mm.shape[1]
    found: Int64 = pixels % columns * SECTORS // columns
    return found


def _most_by_chance(image: RangeImage, pixels: Int64, memory: ScatterMemory | None) -> Int64:
    """Greatest number of neighbours by chance in each sector, band and beyond, in all and in the ring, (S, B + 1, 2), 0
    without scatter.

    Of random returns with a mean of m neighbours, m times as many have one as have none, and m²/2 times as many have
    two: bodies with gaps have more with one, and still more with two. A sample shows where all must be counted.
    """
    beams = image.rows, image.rank, image.elevation_rad, *_columns(image)
    before = image.ranges_mm if memory is None else memory.before(image.ranges_mm)
    every, sigmas = max(1, len(pixels) // SAMPLE), SUGGESTIVE
    counts, fresh = np.zeros((2, 3, len(BANDS_M), SECTORS), np.int64)
    while True:
        counts[:], fresh[:] = 0, 0
        some = np.ascontiguousarray(pixels[::every])
        _count_few(image.ranges_mm, before, *beams, some, counts, fresh)  # one kernel for both
        is_scatter = _has_scatter(counts, every, sigmas)
        if not is_scatter or (every == 1 and sigmas == SIGNIFICANT):
            break
        every, sigmas = 1, SIGNIFICANT
    found, scans = counts.astype(np.float64), 1.0
    if memory is not None:
        memory.add(every * fresh)
        if not is_scatter and _has_scatter(memory.counts, 1, SIGNIFICANT * math.sqrt(every)):
            is_scatter, found, scans = True, memory.counts, memory.scans
    most = np.zeros((SECTORS, len(BANDS_M) + 1, 2), np.int64)
    for band in range(len(BANDS_M) if is_scatter else 0):
        isolated_here = found[0, band]
        has_scatter = isolated_here >= LOCAL * isolated_here.mean()
        most[has_scatter, band] = _limits(found[:, band, has_scatter].sum(axis=1), scans)
    return most


def _has_scatter(counts: Float64 | Int64, every: int, sigmas: float) -> bool:
    none, one, _ = counts.sum(axis=2)
    return bool(((every * none >= SCATTERED) & (none - one >= sigmas * np.sqrt(none + one))).any())


def _limits(counts: Float64, scans: float) -> tuple[int, int]:
    """Greatest number of neighbours by chance in a scan with scatter, in all and in the ring, from the numbers (3,) of
    those of a band with 0, 1 and 2 in some scans: 1 where bodies with gaps prevail, so that only isolated returns are
    of scatter."""
    none, one, two = counts.tolist()
    mean = one / max(none, 1)
    is_random = one < none or (mean <= DENSEST and 2.0 * two <= DENSE_SLACK * mean * one)
    if none < SCATTERED:
        return 0, 0
    of_scan = none / scans
    return (chance_neighbours(of_scan, mean), chance_neighbours(of_scan, mean * IN_RING)) if is_random else (1, 1)


def chance_neighbours(none: float, mean: float) -> int:
    """Greatest number of neighbours that a scan's random returns have by chance, from 1.

    `none`: returns without a neighbour; `mean`: number of neighbours of one. Fewer than `BY_CHANCE` have more.
    """
    most, share = 1, math.exp(-mean) * mean
    beyond = 1.0 - math.exp(-mean) - share
    while none * math.exp(mean) * beyond > BY_CHANCE:
        most += 1
        share *= mean / most
        beyond -= share
    return most


def floating(
    image: RangeImage, pixels: Int64, T_base_sensor: Float64, ground_m: float, ground_slope: float, clear_m: float
) -> tuple[Bool, Bool]:
    """Which returns, by their places `pixels` (K,) in the flattened image, have `clear_m` of clear space beneath them.

    And which stand, (K,): all beams down to the ground meet their body. What is seen steeply from above shows nothing.

    The space reaches from the lowest return at the distance of the return down to `ground_m`, and `ground_slope` per
    metre of distance from the sensor, above the plane z = 0 of base. Two beams or more, through `clear_m` of its
    height, return from beyond. Beams without a return, or that end before it, prove nothing.
    """
    floats, stands = np.empty(len(pixels), np.bool_), np.empty(len(pixels), np.bool_)
    _mark_floating(
        image.ranges_mm, image.rows, image.rank, *image.directions,
        np.ascontiguousarray(T_base_sensor, np.float64), ground_m, ground_slope, clear_m, pixels, floats, stands,
    )  # fmt: skip
    return floats, stands


def clear_beneath(
    image: RangeImage, points_base: Float64, T_base_sensor: Float64, ground_m: float, ground_slope: float,
) -> Bool:  # fmt: skip
    """Beneath which points (K, 3), seen by another sensor, this image shows clear space down to the ground, (K,).

    As in `floating`, but over all columns within `BESIDE_M`: nothing returns from there, and in half of the columns
    three beams or more, through half of the height, return from beyond.
    """
    out = np.zeros(len(points_base), np.bool_)
    cos_el, sin_el, cos_az, sin_az = image.directions
    away = (points_base - T_base_sensor[:3, 3]) @ T_base_sensor[:3, :3]
    _mark_clear_beneath(
        image.ranges_mm, image.rows, cos_el, sin_el, image.azimuth_rad, cos_az, sin_az,
        np.arctan2(away[:, 1], away[:, 0]),
        np.ascontiguousarray(points_base), np.ascontiguousarray(T_base_sensor, np.float64), ground_m, ground_slope, out,
    )  # fmt: skip
    return out


@kernel
def _fill_points(
    ranges: UInt16, cos_el: Float32, sin_el: Float32, cos_az: Float32, sin_az: Float32, points: Float32
) -> None:  # fmt: skip
    k = 0
    for row in range(ranges.shape[0]):
        for column in range(ranges.shape[1]):
            if ranges[row, column] != 0:
                range_m = np.float32(ranges[row, column]) * np.float32(1e-3)
                flat = range_m * cos_el[row]
                points[k, 0], points[k, 1] = flat * cos_az[column], flat * sin_az[column]
                points[k, 2] = range_m * sin_el[row]
                k += 1


@kernel
def _place(points: Float32, ring_table: Int32, columns: int, ranges: UInt16, pixels: Int64) -> None:
    """Loops without branches are vectorized."""
    n, row = points.shape[0], points.reshape(-1)
    turn, slope, range_mm = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    scale = np.float32(columns / (2.0 * np.pi))
    for i in range(n):
        x, y, z = row[3 * i], row[3 * i + 1], row[3 * i + 2]
        turn[i] = azimuth_of(x, y) * scale
        slope[i] = z / (np.sqrt(x * x + y * y) + np.float32(1e-6))
        range_mm[i] = np.float32(1e3) * np.sqrt(x * x + y * y + z * z)
    steps, end = np.float32(SLOPE_STEPS), np.float32(STEEPEST)
    last = ring_table.shape[0] - 1
    for i in range(n):
        if not range_mm[i] < np.float32(1e9) or not abs(slope[i]) < np.float32(1e9):  # not finite
            pixels[i] = 0
            continue
        ring = ring_table[min(int((min(max(slope[i], -end), end) + end) * steps), last)]
        k = np.int64(ring) * columns + min(max(int(turn[i]), 0), columns - 1)
        pixels[i] = k
        mm = np.uint16(min(max(range_mm[i], np.float32(1.0)), np.float32(65535.0)))
        if ranges[k] == 0 or mm < ranges[k]:
            ranges[k] = mm


@inline_kernel
def _slants(rows: Int64, elevation: Float64, column_rad: float) -> Float64:
    """Difference of range per metre of range up to which the neighbours of each ring by rank, (rings, 3, columns), are
    next to it."""
    slants = np.zeros((len(rows), 3, 2 * COLUMNS_ASIDE + 1))
    for rank in range(len(rows)):
        for a in range(max(rank - 1, 0), min(rank + 2, len(rows))):
            up = elevation[rows[a]] - elevation[rows[rank]]
            for d in range(-COLUMNS_ASIDE, COLUMNS_ASIDE + 1):
                slants[rank, a - rank + 1, d + COLUMNS_ASIDE] = NEAR_SLOPE * np.sqrt(up * up + (d * column_rad) ** 2)
    return slants


@inline_kernel
def _near(
    ranges: UInt16, rows: Int64, slants: Float64, is_closed: bool, rank: int, column: int, own_mm: int, most: int,
    rings_aside: int = 1,
) -> tuple[int, int, int]:  # fmt: skip
    """Number of returns next to one of a ring (by `rank`) and column, at a range like its own, counted up to `most`.

    And rank and column of the first. `rings_aside` 0: those in its ring alone.
    """
    count, first, at, columns = 0, rank, column, ranges.shape[1]
    own = 1e-3 * own_mm
    for a in range(max(rank - rings_aside, 0), min(rank + rings_aside + 1, ranges.shape[0])):
        for d in range(-COLUMNS_ASIDE, COLUMNS_ASIDE + 1):
            c = column + d
            if c < 0 or c >= columns:
                if not is_closed:
                    continue
                c %= columns
            range_mm = ranges[rows[a], c]
            if range_mm == 0 or (a == rank and d == 0):
                continue
            if abs(1e-3 * range_mm - own) <= NEAR_M + slants[rank, a - rank + 1, d + COLUMNS_ASIDE] * own:
                if count == 0:
                    first, at = a, c
                count += 1
                if count == most:
                    return count, first, at
    return count, first, at


@kernel
def _mark_isolated(
    ranges: UInt16, rows: Int64, rank: Int64, elevation: Float64, column_rad: float, is_closed: bool, pixels: Int64,
    out: Bool,
) -> None:  # fmt: skip
    columns, slants = ranges.shape[1], _slants(rows, elevation, column_rad)
    for k in range(pixels.shape[0]):
        ring, column = rank[pixels[k] // columns], pixels[k] % columns
        count, ring, column = _near(ranges, rows, slants, is_closed, ring, column, ranges[rows[ring], column], 2)
        if count == 1:  # the third may be next to the second
            count, ring, column = _near(ranges, rows, slants, is_closed, ring, column, ranges[rows[ring], column], 2)
        out[k] = count < 2


@kernel
def _mark_scattered(
    ranges: UInt16, rows: Int64, rank: Int64, elevation: Float64, column_rad: float, is_closed: bool, pixels: Int64,
    most: Int64, out: Bool,
) -> None:  # fmt: skip
    """Marks returns with no more than `most` (S, B + 1, 2) others next to them, in all and in the ring, by sector and
    band; where it is 1, isolated ones."""
    columns, slants = ranges.shape[1], _slants(rows, elevation, column_rad)
    for k in range(pixels.shape[0]):
        row, column = pixels[k] // columns, pixels[k] % columns
        limit, in_ring = most[column * SECTORS // columns, _band(ranges[row, column])]
        if limit > 0:
            count, ring, at = _near(ranges, rows, slants, is_closed, rank[row], column, ranges[row, column], limit + 1)
            if limit == 1 and count == 1:
                count, ring, at = _near(ranges, rows, slants, is_closed, ring, at, ranges[rows[ring], at], 2)
            out[k] = count <= limit
            if out[k] and count > in_ring:
                own_mm, most_here = ranges[row, column], in_ring + 1
                out[k] = _near(ranges, rows, slants, is_closed, rank[row], column, own_mm, most_here, 0)[0] <= in_ring


@kernel
def _keep_beside(
    ranges: UInt16, rest: UInt16, rows: Int64, rank: Int64, elevation: Float64, column_rad: float, is_closed: bool,
    pixels: Int64, out: Bool,
) -> None:  # fmt: skip
    """Takes back the marks of returns next to `KEPT_BESIDE` others that are not marked: the edge of a body."""
    columns, slants = ranges.shape[1], _slants(rows, elevation, column_rad)
    for k in range(pixels.shape[0]):
        if out[k]:
            row, column = pixels[k] // columns, pixels[k] % columns
            count, _, _ = _near(rest, rows, slants, is_closed, rank[row], column, ranges[row, column], KEPT_BESIDE)
            out[k] = count < KEPT_BESIDE


@kernel
def _count_few(
    ranges: UInt16, before: UInt16, rows: Int64, rank: Int64, elevation: Float64, column_rad: float, is_closed: bool,
    pixels: Int64, counts: Int64, fresh: Int64,
) -> None:  # fmt: skip
    """Counts the returns with none, one and two others next to them, by band of range and sector, (3, B, S); and those
    of them that are at another range than the one `before` in their place."""
    columns, slants = ranges.shape[1], _slants(rows, elevation, column_rad)
    for k in range(pixels.shape[0]):
        row, column = pixels[k] // columns, pixels[k] % columns
        band = _band(ranges[row, column])
        if band < len(BANDS_M):
            count, _, _ = _near(ranges, rows, slants, is_closed, rank[row], column, ranges[row, column], 3)
            if count < 3:
                counts[count, band, column * SECTORS // columns] += 1
                change_m = abs(1e-3 * ranges[row, column] - 1e-3 * before[row, column])
                fresh[count, band, column * SECTORS // columns] += change_m > FRESH_M


@inline_kernel
def _band(range_mm: int) -> int:
    band = 0
    while band < len(BANDS_M) and 1e-3 * range_mm > BANDS_M[band]:
        band += 1
    return band


@kernel
def _mark_floating(
    ranges: UInt16, rows: Int64, rank: Int64, cos_el: Float64, sin_el: Float64, cos_az: Float64, sin_az: Float64,
    T: Float64, ground_m: float, ground_slope: float, clear_m: float, pixels: Int64, floats: Bool, stands: Bool,
) -> None:  # fmt: skip
    rings, columns = ranges.shape
    flat, rise = np.empty(rings), np.empty(rings)  # of the beams of one column, by rank; 0: not computed yet
    first, following = np.full(columns, -1), np.empty(len(pixels), np.int64)  # returns of each column
    for k in range(pixels.shape[0]):
        column = pixels[k] % columns
        following[k], first[column] = first[column], k
    for column in range(columns):
        flat[:] = 0.0
        k = first[column]
        while k >= 0:
            at_m, above_m, clear, passing, is_above = 0.0, 0.0, 0.0, 0, False
            is_whole, is_down = True, False  # all beams down from the return meet its body; they reach the ground
            for a in range(rank[pixels[k] // columns], -1, -1):
                r = rows[a]
                if flat[a] == 0.0:
                    x, y, z = cos_el[r] * cos_az[column], cos_el[r] * sin_az[column], sin_el[r]
                    flat[a] = np.hypot(T[0, 0] * x + T[0, 1] * y + T[0, 2] * z, T[1, 0] * x + T[1, 1] * y + T[1, 2] * z)
                    rise[a] = (T[2, 0] * x + T[2, 1] * y + T[2, 2] * z) / flat[a]
                ends_m = 1e-3 * ranges[r, column] * flat[a]
                if at_m == 0.0:
                    at_m = ends_m
                height_m, end_height_m = T[2, 3] + rise[a] * at_m, T[2, 3] + rise[a] * ends_m
                if height_m <= ground_m + ground_slope * at_m:
                    is_down = True
                    break
                if ends_m > at_m + BESIDE_M:
                    clear += above_m - height_m
                    passing += 1
                elif end_height_m <= ground_m + ground_slope * ends_m:
                    is_down = True
                    break
                elif ends_m >= at_m - BESIDE_M:  # a lower part of the body, or something below it
                    clear, passing = 0.0, 0
                    is_above = rise[a] < -STEEP and end_height_m > ground_m + ground_slope * ends_m + GAP_M
                else:
                    is_whole = False
                above_m = height_m
            floats[k] = passing >= 2 and clear >= clear_m
            stands[k] = is_whole and is_down and passing == 0 and not is_above
            k = following[k]


@kernel
def _mark_clear_beneath(
    ranges: UInt16, rows: Int64, cos_el: Float64, sin_el: Float64, azimuth: Float64, cos_az: Float64, sin_az: Float64,
    towards: Float64, points: Float64, T: Float64, ground_m: float, ground_slope: float, out: Bool,
) -> None:  # fmt: skip
    for k in range(points.shape[0]):
        at_m = np.hypot(points[k, 0] - T[0, 3], points[k, 1] - T[1, 3])
        bottom_m = ground_m + ground_slope * at_m
        half_rad = np.arctan2(BESIDE_M, at_m)
        is_clear, columns, clear_columns = at_m > BESIDE_M, 0, 0
        for column in range(azimuth.shape[0]):
            away = abs(azimuth[column] - towards[k])
            if half_rad + SLACK_RAD < away < 2.0 * np.pi - half_rad - SLACK_RAD:
                continue  # before the remainder, which takes most of the time
            turn = (azimuth[column] - towards[k] + np.pi) % (2.0 * np.pi) - np.pi
            if not is_clear or abs(turn) > half_rad:
                continue
            columns += 1
            above_m, clear, passing = points[k, 2], 0.0, 0
            for a in range(rows.shape[0] - 1, -1, -1):
                r = rows[a]
                x, y, z = cos_el[r] * cos_az[column], cos_el[r] * sin_az[column], sin_el[r]
                flat = np.hypot(T[0, 0] * x + T[0, 1] * y + T[0, 2] * z, T[1, 0] * x + T[1, 1] * y + T[1, 2] * z)
                ends_m = 1e-3 * ranges[r, column] * flat
                rise = (T[2, 0] * x + T[2, 1] * y + T[2, 2] * z) / flat
                height_m, end_height_m = T[2, 3] + rise * at_m, T[2, 3] + rise * ends_m
                if height_m >= points[k, 2] - BESIDE_M:
                    continue
                if height_m <= bottom_m:
                    break
                if ends_m > at_m + BESIDE_M:
                    clear += above_m - height_m
                    passing += 1
                elif ends_m >= at_m - BESIDE_M and end_height_m > ground_m + ground_slope * ends_m:
                    is_clear = False
                above_m = height_m
            clear_columns += passing >= 3 and clear >= 0.5 * (points[k, 2] - bottom_m)
        out[k] = is_clear and columns > 0 and 2 * clear_columns >= columns
