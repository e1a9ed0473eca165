"""Swaths along an adaptive curve or a circle, each line kept drivable and cut to where the rig is free.

Line N lies at N spacings from the guidance line (`planning/guidance/offset_lines.py`). `base` follows it. A swath
begins and ends without curvature, as the turn before and after it: the curvature is ramped within the swath.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from geometry.arrays import Bool, Int64, runs_of
from geometry.footprint import corners_of, worked
from planning.guidance.line import Circle, Curve
from planning.guidance.offset_lines import STEP_M, OffsetLine, lines_over
from planning.rig import Rig
from planning.turns.free_space import FreeSpace
from planning.turns.search import Leg

ACROSS = 5  # points of a line between two places where the area across it is measured, 0.5 m
MIN_STRIP_M2 = 0.5
MOST_CURVATURE = 1.07  # of that of the smallest turning radius, as of headland passes
RATE_RADPM2 = 0.12  # change of curvature per metre at both ends of a swath
LEVEL_RADPM = 0.01  # at an end this much is left
CLOSING = 3  # points by which a complete ring overlaps its own beginning
SHORTER, TRIED = 5, 6  # points by which a swath is shortened whose ramp is not free, and how often
CHANGE = 1.3  # length of a change to the next ring, of that of two arcs


@dataclass(frozen=True)
class CurvedSwath:
    """A curved line with work; legs of `base` from a to b and from b to a, None where not drivable.

    `row` is the number of its guidance line.
    """

    number: int
    onwards: Leg | None
    back: Leg | None
    block: int = 0
    row: float = 0.0

    @property
    def longer(self) -> Leg:
        """The leg of the longer direction."""
        return max((leg for leg in (self.onwards, self.back) if leg is not None), key=lambda leg: len(leg.p_map_m))

    def legs(self, lead_m: float) -> tuple[Leg | None, Leg | None]:
        """Path of `base` in both directions."""
        return self.onwards, self.back

    def area(self, rig: Rig) -> BaseGeometry:
        """Area worked in the longer direction."""
        return area_of(self.longer, rig)


def area_of(leg: Leg, rig: Rig) -> BaseGeometry:
    """Area worked over a leg."""
    keep = corners_of(np.unwrap(leg.heading_rad))
    p, heading = rig.carriers(leg.p_map_m, leg.heading_rad)
    return worked(*rig.working_edges(p[keep], heading[keep]))


def curved_swaths_over(
    area: BaseGeometry, guide: Curve | Circle, rig: Rig, overlap_m: float, space: FreeSpace
) -> list[CurvedSwath]:
    """Swaths over an area, line by line from the right of the guidance line (of a circle from inside), numbers 0."""
    found = list[CurvedSwath]()
    if area.is_empty:
        return found
    pitch_m = rig.working_width_m - overlap_m
    shapely.prepare(area)
    rings = list[OffsetLine]()
    for line in lines_over(area, guide, pitch_m, rig.radius_m, rig.config.smoothing_m):
        is_wanted = _is_wanted(line, area, pitch_m)
        if not is_wanted.any():
            continue
        is_free = [_is_free(line, is_reversed, rig, space) for is_reversed in (False, True)]
        if line.is_closed and is_wanted.all() and is_free[0].all() and is_free[1].all():
            rings.append(line)
            continue
        open_swaths = _on_open(*_opened(line, is_wanted, is_free), rig, space)
        found += [replace(swath, row=float(line.number)) for swath in open_swaths]
    return [*found, *_ring_swaths(rings, area, pitch_m, rig)]


def _is_wanted(line: OffsetLine, area: BaseGeometry, pitch_m: float) -> Bool:
    """Points of a line across which, half a spacing to either side, some of the area lies; short ones lengthened."""
    at = np.unique(np.append(np.arange(0, len(line.points_m), ACROSS), len(line.points_m) - 1))
    p, h = line.points_m[at], line.heading_rad[at]
    side = (0.5 * pitch_m + 1e-6) * np.column_stack([-np.sin(h), np.cos(h)])
    across = shapely.linestrings(np.stack([p - side, p + side], axis=1))
    length = np.asarray(shapely.length(shapely.intersection(across, area)), np.float64)
    wanted = np.zeros(len(line.points_m), np.bool_)
    for a, b in runs_of(np.asarray(length > 1e-6, np.bool_)):
        if float(length[a : b + 1].sum()) * ACROSS * STEP_M > MIN_STRIP_M2:
            wanted[max(0, at[a] - ACROSS + 1) : at[b] + ACROSS] = True
    return wanted


def _is_free(line: OffsetLine, is_reversed: bool, rig: Rig, space: FreeSpace) -> Bool:
    """Points of a line where the rig is free and the line is not too bent; with reversing `stop_gap_m` is kept."""
    heading = line.heading_rad + (math.pi if is_reversed else 0.0)
    free = ~space.touching(line.points_m, heading) & (np.abs(line.curvature_radpm) < MOST_CURVATURE / rig.radius_m)
    gap = math.ceil(rig.config.stop_gap_m / STEP_M) if rig.has_reverse else 0
    padded = np.concatenate([free[-gap:], free, free[:gap]]) if line.is_closed and gap else np.pad(free, gap)
    if gap and not line.is_closed:
        padded[:gap], padded[-gap:] = free[0], free[-1]
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * gap + 1)
    return np.asarray(windows.all(axis=1), np.bool_)


def _opened(line: OffsetLine, is_wanted: Bool, is_free: Sequence[Bool]) -> tuple[OffsetLine, Bool, list[Bool]]:
    """A closed line cut open where it is not worked, and a little longer: both directions reach past the cut."""
    if not line.is_closed:
        return line, is_wanted, list(is_free)
    n = len(line.points_m) - 1
    gaps = np.flatnonzero(~is_wanted[:-1]) if not is_wanted.all() else np.flatnonzero(~is_free[0][:-1])
    if not len(gaps):
        gaps = np.flatnonzero(~is_free[1][:-1])
    middle = _middle_of_longest(gaps, n)
    pad = min(n // 4, 100)
    index = (middle + np.arange(-pad, n + pad)) % n
    heading = np.unwrap(line.heading_rad[:-1][index])
    wanted = is_wanted[:-1][index]
    wanted[:pad] = wanted[n + pad :] = False
    opened = OffsetLine(line.number, line.points_m[:-1][index], heading, line.curvature_radpm[:-1][index], False)
    return opened, wanted, [free[:-1][index] for free in is_free]


def _middle_of_longest(gaps: Int64, n: int) -> int:
    """Middle of the longest run of consecutive indices on a closed line of `n` points."""
    is_gap = np.zeros(n, np.bool_)
    is_gap[gaps] = True
    first = int(np.argmin(is_gap)) if not is_gap.all() else 0
    a, b = max(runs_of(np.roll(is_gap, -first)), key=lambda run: run[1] - run[0])
    return (first + (a + b) // 2) % n


def _on_open(
    line: OffsetLine, is_wanted: Bool, is_free: Sequence[Bool], rig: Rig, space: FreeSpace
) -> list[CurvedSwath]:
    """Swaths on the wanted parts of an open line, each in one direction or both."""
    lead = round(-rig.working_x_m / STEP_M)
    least = math.ceil(rig.config.min_swath_m / STEP_M)
    found = list[CurvedSwath]()
    for first, last in runs_of(is_wanted):
        more = max(0, math.ceil((least - (last - first)) / 2))
        first, last = first - more, last + more
        ways = [_runs(is_free[k], first, last, lead * (1 - 2 * k), least) for k in (0, 1)]
        legs = [[(a, b, _leg(line, a, b, bool(k), lead, rig, space)) for a, b in ways[k]] for k in (0, 1)]
        onwards, backs = ([one for one in some if one[2] is not None] for some in legs)
        for a, b, leg in onwards:
            partner = next((o for o in backs if min(b, o[1]) - max(a, o[0]) > 0.5 * least), None)
            if partner is not None:
                backs = [o for o in backs if o is not partner]
            found.append(CurvedSwath(0, leg, None if partner is None else partner[2]))
        found += [CurvedSwath(0, None, leg) for _, _, leg in backs]
    return found


def _runs(is_free: Bool, first: int, last: int, lead: int, least: int) -> list[tuple[int, int]]:
    """Runs of points of the working line in `first` to `last` at which the rig, with `base` `lead` ahead, is free."""
    low, high = max(first, -lead, 0), min(last, len(is_free) - 1 - max(lead, 0))
    if high - low < least:
        return []
    return [(low + a, low + b) for a, b in runs_of(is_free[low + lead : high + lead + 1]) if b - a >= least]


def _leg(
    line: OffsetLine, first: int, last: int, is_reversed: bool, lead: int, rig: Rig, space: FreeSpace
) -> Leg | None:
    """Leg of `base` while its working line goes over points `first` to `last`, or a little less where it is free."""
    a, b = (first - lead, last - lead) if is_reversed else (first + lead, last + lead)
    part = slice(a, b + 1)
    leg = Leg(1, line.points_m[part], line.heading_rad[part], line.curvature_radpm[part])
    leg = leg.back if is_reversed else leg
    for _ in range(TRIED):
        ramped = _ramped(leg)
        is_out = space.touching(ramped.p_map_m, ramped.heading_rad)
        if not is_out.any():
            return ramped
        half = len(is_out) // 2
        kept = slice(SHORTER * int(is_out[:half].any()), len(is_out) - SHORTER * int(is_out[half:].any()))
        leg = Leg(1, leg.p_map_m[kept], leg.heading_rad[kept], leg.curvature_radpm[kept])
        if len(leg.p_map_m) * STEP_M < rig.config.min_swath_m:
            return None
    return None


def _ramped(leg: Leg) -> Leg:
    """The leg with its curvature ramped to 0 at both ends, where it leaves its line by some centimetres."""
    return _ramped_end(_ramped_end(leg).back).back


def _ramped_end(leg: Leg) -> Leg:
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(leg.p_map_m, axis=0).T))])
    limit = LEVEL_RADPM + RATE_RADPM2 * (s[-1] - s)
    over = np.flatnonzero(np.abs(leg.curvature_radpm) > limit)
    if not len(over):
        return leg
    k = max(int(over[0]) - 1, 0)
    curvature = leg.curvature_radpm.copy()
    curvature[k + 1 :] = np.clip(curvature[k + 1 :], -limit[k + 1 :], limit[k + 1 :])
    step = np.diff(s[k:])
    turn = np.concatenate([[0.0], np.cumsum(0.5 * (curvature[k:-1] + curvature[k + 1 :]) * step)])
    heading, p = leg.heading_rad.copy(), leg.p_map_m.copy()
    heading[k:] = heading[k] + turn
    middle = 0.5 * (heading[k:-1] + heading[k + 1 :])
    p[k + 1 :] = p[k] + np.cumsum(step[:, None] * np.column_stack([np.cos(middle), np.sin(middle)]), axis=0)
    return Leg(leg.direction, p, heading, curvature)


def _ring_swaths(rings: Sequence[OffsetLine], area: BaseGeometry, pitch_m: float, rig: Rig) -> list[CurvedSwath]:
    """Complete rings; each begins so far ahead of where its neighbour ends that the rig changes over without a turn."""
    change_m = rig.config.run_out_m + rig.config.line_up_m + CHANGE * 2.0 * math.sqrt(rig.radius_m * pitch_m)
    found, ahead = list[CurvedSwath](), None
    for ring in rings[::-1]:
        n = len(ring.points_m) - 1
        if ahead is None:  # the first one begins where there is most room beside it
            points = np.asarray(shapely.points(ring.points_m[:-1:ACROSS]))
            first = ACROSS * int(np.argmax(np.round(shapely.distance(points, area.boundary), 1)))
        else:
            first = int(np.argmin(np.hypot(*(ring.points_m[:-1] - ahead).T)))
        index = (first + np.arange(n + CLOSING + 1)) % n
        heading = np.unwrap(ring.heading_rad[:-1][index])
        leg = Leg(1, ring.points_m[:-1][index], heading, ring.curvature_radpm[:-1][index])
        found.append(CurvedSwath(0, _ramped(leg), _ramped(leg.back), row=float(ring.number)))
        ahead = ring.points_m[(first + CLOSING + round(change_m / STEP_M)) % n]
    return found[::-1]
