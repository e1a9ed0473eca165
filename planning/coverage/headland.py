"""Headland passes: closed paths along the field edge, displaced inwards where a body would leave the field.

A pass starts as the field outline moved inwards, with all corners rounded to the turning radius, and is displaced by no
more than the bodies need (`pass_shape.py`). Where that fails the pass is cut: what remains are open passes. Parts of
the field too narrow for a closed pass have open ones along their edges, driven in either direction. With
reversing a rounded corner is filled: the rig reverses straight into it from behind its arc, and works out of it again.
Where that is better it drives straight into the corner, turns there, and works out of it, without the arc.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from shapely.geometry import LineString, MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from geometry.arrays import Bool, Float64, Int64, runs_of
from geometry.footprint import worked
from geometry.polygon import ARC_ERROR_M, close_by, parts, ring_points, rounded, shrink, united
from geometry.polyline import arc_length, curvatures, headings, resample, smooth
from geometry.pose2 import Pose2
from geometry.rectangle import Rectangle
from planning.coverage.pass_shape import STEP_M, displaced, is_undrivable
from planning.field.drivable_area import DrivableArea
from planning.rig import Rig, corner_reach_m
from planning.turns.free_space import FreeSpace
from planning.turns.search import AT_ONCE_M, Connection, ConnectionRequest, find_turn

MIN_RING_M2 = 1.0
SMALL_RING = 6.0  # of the area of the smallest circle: a smaller pass costs turns at each swath that it cuts in two
MORE_OVERLAP, MUCH_BARE = (0.0, 0.1), 0.003  # of the working width; of the field, between the passes
ROUNDING = (1.0, 1.3)  # of the turning radius; with the larger one passes end farther from the end of a narrow part
MIN_OPEN_M = 8.0
SWING_M = 0.03  # added to the distance of the passes from the edge: a trailed implement swings before and after bends
NEAR_WIDTHS = 0.3  # of another pass
SLIM = 0.5  # of the bodies: where they are not free either, a line is cut before it is displaced
SHARP = 2.0  # of the curvature of the turning radius: a line is cut in such a corner
STRAIGHT_RADPM, MAX_JOINT_RADPM = 0.004, 0.03
MIN_FILL_RAD = 0.7
MAX_FILL_RAD = 2.6
LEVEL = 15  # points
FILL_RUN_M = (1.0, 16.0)  # straight behind the arc before reversing
MIN_REVERSE_M = 1.0
BEYOND_M = 3.0  # an arc begins and ends gently
APART = 10  # points
FILL_STEP_M, FILL_ENOUGH, TURN_ENOUGH = 0.4, 0.97, 0.995  # a fill, or one with a turn, ends at this share of its work
BARE_S_PER_M2 = 30.0  # time that a bare square metre in a corner counts as
NEAR_M = 20.0  # of the fills of a corner, beyond its arc and its turn
BESIDE = 150  # points of a pass before and after an arc that may work the same ground


@dataclass(frozen=True)
class CornerFill:
    """Straight excursion of `by_m` from point `index` of a pass into a corner and back.

    Behind the corner (`by_m` negative) the rig reverses into it and works out of it; before it the rig works into it
    and reverses out of it.
    """

    index: int
    by_m: float


@dataclass(frozen=True)
class CornerTurn:
    """Turn in a corner from the end of the fill before it to that of the fill behind it, in place of the arc."""

    before: CornerFill
    behind: CornerFill
    way: Connection


@dataclass(frozen=True)
class HeadlandPass:
    """Path of `base` in driving order, points 0.1 m apart; a closed one repeats its first point at the end.

    `number` counts from the edge, from 0. One that `is_two_way` is drivable in the opposite direction too.
    `fills` are driven beside the path, `turns` with their fills in place of a part of it.
    """

    number: int
    points_m: Float64
    heading_rad: Float64
    is_around_obstacle: bool
    is_closed: bool
    fills: tuple[CornerFill, ...] = ()
    turns: tuple[CornerTurn, ...] = ()
    is_two_way: bool = False

    @property
    def curvature_radpm(self) -> Float64:
        """Curvature at each point, (N,)."""
        return curvatures(self.heading_rad, arc_length(self.points_m))

    def pose(self, k: int) -> Pose2:
        """Pose at an index, around the end of a closed pass."""
        k %= len(self.points_m) - 1
        return Pose2(*map(float, (*self.points_m[k], self.heading_rad[k])))


def headland_passes_of(drivable: DrivableArea, rig: Rig, count: int, overlap_m: float) -> list[HeadlandPass]:
    """All passes from the edge inwards; none where the field is too narrow for them.

    With reversing they overlap more than `overlap_m` where much stays bare between them, corners apart: a pass does
    not follow each bend of the one before.
    """
    if count == 0:
        return []
    space = rig.space(drivable.inner)
    shape = shrink(drivable.free, depth_m(drivable, rig, overlap_m, 0))
    outer = _passes_around(shape, space, rig, 0)
    outer += _passes_beside(shape, outer, space, rig)
    best: tuple[float, list[HeadlandPass]] = (math.inf, [])
    for more in MORE_OVERLAP if rig.has_reverse and count > 1 else MORE_OVERLAP[:1]:
        depths = [depth_m(drivable, rig, overlap_m + more * rig.working_width_m, k) for k in range(count)]
        found, bare_m2 = list(outer), 0.0
        for k, depth in enumerate(depths[1:], 1):
            found += _passes_around(shrink(drivable.free, depth), space, rig, k)
        if rig.has_reverse:
            inside = shrink(drivable.free, depths[-1] + 0.5 * rig.working_width_m)
            found, bare = _all_filled(found, drivable, space, rig, inside)
            bare_m2 = round(bare.intersection(shape.difference(shrink(drivable.free, depths[-1]))).area, 3)
        best = min(best, (bare_m2, found), key=lambda b: b[0])
        if bare_m2 <= MUCH_BARE * drivable.free.area:
            break
    return sorted(best[1], key=lambda r: (r.is_around_obstacle, r.number))


def _passes_around(shape: BaseGeometry, space: FreeSpace, rig: Rig, number: int) -> list[HeadlandPass]:
    return [r for part in parts(shape, MIN_RING_M2) for r in _passes_in(part, space, rig, number)]


def _all_filled(
    passes: list[HeadlandPass], drivable: DrivableArea, space: FreeSpace, rig: Rig, inside: BaseGeometry
) -> tuple[list[HeadlandPass], BaseGeometry]:
    """The passes with fills and turns at their corners, and what then is bare beside the area `inside` all passes.

    A corner has the fills that each work `corner_fill_m2` or more of what else stays bare; or a turn in place of its
    arc where that takes less time, bare ground counted as time.
    """
    areas = [pass_coverage(p, rig) for p in passes]
    bare = drivable.free.difference(united([*areas, inside]))
    found = list(passes)
    for n, ring in reversed(list(enumerate(passes))):  # the strips beside an arc that is left out are filled before it
        for before, behind in _fills(ring, space, rig) if ring.is_closed else ():
            near, far = _split(bare, ring, [fill for fill in (before, behind) if fill is not None], rig)
            kept, left = list[CornerFill](), near
            for longest in (behind, before):
                if longest is None:
                    continue
                fill, gain_m2 = _as_long_as_needed(longest, ring, left, rig)
                if gain_m2 >= rig.config.corner_fill_m2 and _is_apart(fill, [*found[n].fills, *kept], found[n]):
                    kept.append(fill)
                    left = left.difference(_fill_area(ring, fill, rig))
            filled = replace(found[n], fills=(*found[n].fills, *kept))
            if before is not None and behind is not None:
                others = [*areas[:n], *areas[n + 1 :], inside]
                turned = _with_turn(found[n], before, behind, near, others, space, rig)
                if turned is not None:
                    saved_s = (
                        _fills_s(kept, rig) + _arc_s(before, behind, ring, rig) - _turn_s(turned[0].turns[-1], rig)
                    )
                    if saved_s > BARE_S_PER_M2 * (turned[1].area - left.area):
                        filled, left = turned
            found[n], bare = filled, MultiPolygon([*far, *parts(left, 0.0)])
        areas[n] = pass_coverage(found[n], rig)
    return found, bare


def _split(
    bare: BaseGeometry, ring: HeadlandPass, fills: Sequence[CornerFill], rig: Rig
) -> tuple[BaseGeometry, list[Polygon]]:
    """The parts of an area near fills and the arc between them, and the others."""
    areas = np.array(parts(bare, 0.0), object)
    box = shapely.envelope(shapely.union_all([_fill_area(ring, fill, rig) for fill in fills])).buffer(NEAR_M)
    is_near = shapely.intersects(areas, box)
    return MultiPolygon(list(areas[is_near])), list(areas[~is_near])


def _with_turn(
    ring: HeadlandPass, before: CornerFill, behind: CornerFill, bare: BaseGeometry, others: Sequence[BaseGeometry],
    space: FreeSpace, rig: Rig,
) -> tuple[HeadlandPass, BaseGeometry] | None:  # fmt: skip
    """The pass with a turn in place of an arc, between fills as long as needed, and what is bare then."""
    n = len(ring.points_m) - 1
    length = (behind.index - before.index) % n
    if not _is_alone(before.index, length, ring):
        return None
    arc = _strip(ring, before.index + np.arange(length + 1), rig)
    beside = min(BESIDE, (n - length) // 2)
    sides = [before.index + np.arange(-beside, 1), behind.index + np.arange(beside + 1)]
    around = [a for a in others if a.intersects(arc)] + [_strip(ring, side, rig) for side in sides]
    for area in around:
        arc = arc.difference(area)
    left = bare.union(arc.intersection(space.allowed))
    behind, _ = _as_long_as_needed(behind, ring, left, rig, TURN_ENOUGH)
    left = left.difference(_fill_area(ring, behind, rig))
    before, _ = _as_long_as_needed(before, ring, left, rig, TURN_ENOUGH)
    left = left.difference(_fill_area(ring, before, rig))
    first, last = (ring.pose(f.index).ahead(f.by_m) for f in (before, behind))
    way = find_turn(ConnectionRequest(first, last, AT_ONCE_M, rig.config.line_up_m), space, rig.turn_times)
    return None if way is None else (replace(ring, turns=(*ring.turns, CornerTurn(before, behind, way))), left)


def _is_alone(first: int, length: int, ring: HeadlandPass) -> bool:
    """Whether the fills and turns of a pass are all apart from a part of it."""
    n = len(ring.points_m) - 1
    if any((f.index - first) % n <= length for f in ring.fills):
        return False
    spans = [(t.before.index, (t.behind.index - t.before.index) % n) for t in ring.turns]
    return all((a - first) % n > length and (first - a) % n > size for a, size in spans)


def _fills_s(fills: Sequence[CornerFill], rig: Rig) -> float:
    """Time of fills."""
    times = rig.turn_times
    out_s = 1.0 / rig.work_mps + 1.0 / times.reverse_mps
    return sum(abs(f.by_m) * out_s + 2.0 * times.cusp_s for f in fills)


def _arc_s(before: CornerFill, behind: CornerFill, ring: HeadlandPass, rig: Rig) -> float:
    """Time of an arc."""
    return (behind.index - before.index) % (len(ring.points_m) - 1) * STEP_M / rig.turn_mps


def _turn_s(turn: CornerTurn, rig: Rig) -> float:
    """Time of a turn with its fills."""
    is_reversed = turn.way.legs[0].direction < 0
    fills_m = abs(turn.before.by_m) + abs(turn.behind.by_m)
    return fills_m / rig.work_mps + turn.way.time_s + is_reversed * rig.turn_times.cusp_s


def _is_apart(fill: CornerFill, others: Sequence[CornerFill], ring: HeadlandPass) -> bool:
    """Whether on a pass no fill behind a corner begins shortly beyond one before a corner, nor any within a turn."""
    count = len(ring.points_m) - 1
    behind, before = ([f.index for f in (fill, *others) if f.by_m * sign > 0.0] for sign in (-1.0, 1.0))
    is_within = not _is_alone(fill.index, 0, replace(ring, fills=()))
    return not is_within and not any(0 < (b - a) % count <= APART for a in before for b in behind)


def _as_long_as_needed(
    fill: CornerFill, ring: HeadlandPass, bare: BaseGeometry, rig: Rig, enough: float = FILL_ENOUGH
) -> tuple[CornerFill, float]:
    """A fill without its end where it works next to nothing of the bare area, and what it works of it, m²."""
    count = max(1, round(abs(fill.by_m) / FILL_STEP_M))
    lengths = np.linspace(0.0, fill.by_m, count + 1)[1:]
    strip = _fill_area(ring, fill, rig).intersection(bare)
    gains = shapely.area(shapely.intersection(strip, _fill_areas(ring, fill.index, lengths, rig)))
    k = int(np.argmax(gains >= enough * gains[-1]))
    return replace(fill, by_m=float(lengths[k])), float(gains[k])


def depth_m(drivable: DrivableArea, rig: Rig, overlap_m: float, number: int) -> float:
    """Distance of the centre line of pass `number` from the edge."""
    first = drivable.margin_m + rig.width_m / 2.0 + rig.config.edge_slack_m
    first += 0.0 if rig.trailer is None else SWING_M
    return first + number * (rig.working_width_m - overlap_m)


def pass_coverage(ring: HeadlandPass, rig: Rig) -> BaseGeometry:
    """Area worked by a pass and its fills."""
    is_driven = np.ones(len(ring.points_m), np.bool_)
    n = len(is_driven) - 1
    for turn in ring.turns:
        is_driven[(turn.before.index + np.arange(1, (turn.behind.index - turn.before.index) % n)) % n] = False
    is_driven[n] = is_driven[0]
    fills = [*ring.fills, *(fill for turn in ring.turns for fill in (turn.before, turn.behind))]
    strips = [_strip(ring, run, rig) for run in _runs(is_driven, ring.is_closed)]
    return shapely.union_all([*strips, *(_fill_area(ring, fill, rig) for fill in fills)]).buffer(0.01)


def _strip(ring: HeadlandPass, index: Int64, rig: Rig) -> BaseGeometry:
    """Area worked over points of a pass."""
    index = index[np.unique(np.append(np.arange(0, len(index), 4), len(index) - 1))]
    index = index % (len(ring.points_m) - 1) if ring.is_closed else index
    p, heading = rig.carriers(ring.points_m, ring.heading_rad, is_closed=ring.is_closed)
    return worked(*rig.working_edges(p[index], heading[index]))


def _fill_area(ring: HeadlandPass, fill: CornerFill, rig: Rig) -> Polygon:
    area: Polygon = _fill_areas(ring, fill.index, np.array([fill.by_m]), rig)[0]
    return area


def _fill_areas(ring: HeadlandPass, index: int, by_m: Float64, rig: Rig) -> np.ndarray:
    """Areas worked by fills of some lengths (K,) at a point of a pass, (K,) polygons."""
    heading = float(ring.heading_rad[index])
    p = ring.points_m[index] + np.append(by_m, 0.0)[:, None] * np.array([np.cos(heading), np.sin(heading)])
    left, right = rig.working_edges(p, np.full(len(p), heading))
    last = np.broadcast_to([left[-1], right[-1]], (len(by_m), 2, 2))
    return np.asarray(shapely.polygons(np.stack([last[:, 0], left[:-1], right[:-1], last[:, 1]], axis=1)))


def _passes_in(part: Polygon, space: FreeSpace, rig: Rig, number: int) -> list[HeadlandPass]:
    """The passes of an area with corners of the smallest radius, or of a larger one where more of them is drivable."""
    leaving = _straight_on(space, rig.config.run_out_m)
    leaves_swaths = rig.working_width_m < 2.0 * rig.radius_m  # inside the smallest circle
    least_m2 = SMALL_RING * math.pi * rig.radius_m**2 if leaves_swaths else MIN_RING_M2
    best: tuple[int, list[HeadlandPass]] | None = None
    for factor in ROUNDING:
        undrivable, found = 0, list[HeadlandPass]()
        for piece in parts(rounded(part, factor * rig.radius_m), least_m2):
            for k, ring in enumerate(ring_points(piece)):
                line = smooth(resample(ring, STEP_M), rig.config.smoothing_m, is_closed=True)
                room = leaving if k > 0 else space
                points, heading = displaced(line, room)
                wrong = is_undrivable(points, heading, room, is_closed=True)
                undrivable += int(wrong.sum())
                found += _cut(HeadlandPass(number, points, heading, k > 0, True), wrong, rig, room)
        if best is None or undrivable < best[0]:
            best = undrivable, found
        if undrivable == 0:
            break
    assert best is not None
    return best[1]


def _passes_beside(shape: BaseGeometry, others: list[HeadlandPass], space: FreeSpace, rig: Rig) -> list[HeadlandPass]:
    """Open passes along the outline of a shape where `others` are not: in parts too narrow for them.

    They are drivable in both directions, with a trailed implement in one. Their ends are far enough from the edges for
    a turn.
    """
    taken = shapely.union_all([LineString(r.points_m).buffer(NEAR_WIDTHS * rig.working_width_m) for r in others])
    shapely.prepare(taken)
    slim = replace(space, bodies=tuple(replace(b, width_m=SLIM * b.width_m) for b in space.bodies), trailer=None)
    is_two_way, swing_m = rig.trailer is None, corner_reach_m(rig) - rig.radius_m - rig.width_m / 2.0
    both = _both_ways(space, rig.config.stop_gap_m) if is_two_way else space
    found = list[HeadlandPass]()
    for part in parts(close_by(shape, rig.radius_m).simplify(ARC_ERROR_M), MIN_RING_M2):
        for k, ring in enumerate(ring_points(part)):
            line = smooth(resample(ring, STEP_M), rig.config.smoothing_m, is_closed=True)
            heading = headings(line, is_closed=True)
            is_out = shapely.contains_xy(taken, *line.T) | slim.touching(line, heading)
            is_sharp = np.abs(curvatures(heading, arc_length(line))) > SHARP / rig.radius_m
            for run in _runs(~(is_out | is_sharp), True):
                if len(run) > MIN_OPEN_M / STEP_M:
                    points, heading = displaced(line[run], both, swing_m)
                    open_pass = HeadlandPass(0, points, heading, k > 0, False, is_two_way=is_two_way)
                    found += _cut(open_pass, is_undrivable(points, heading, both), rig, both)
    return found


def _both_ways(space: FreeSpace, gap_m: float) -> FreeSpace:
    """Free space of the bodies in both directions on a line, and `gap_m` ahead and behind."""
    ends = [((b.rear_m, b.front_m), (-b.front_m, -b.rear_m)) for b in space.bodies]
    bodies = [Rectangle(r - gap_m, f + gap_m, b.width_m) for b, e in zip(space.bodies, ends, strict=True) for r, f in e]
    return replace(space, bodies=tuple(bodies))


def _straight_on(space: FreeSpace, run_out_m: float) -> FreeSpace:
    """Free space of bodies that reach `run_out_m` ahead: a pass around an obstacle can be left straight on."""
    return replace(space, bodies=tuple(replace(b, front_m=max(b.front_m, run_out_m)) for b in space.bodies))


def _cut(ring: HeadlandPass, outside: Bool, rig: Rig, space: FreeSpace) -> list[HeadlandPass]:
    """The drivable parts of a pass; a trailed implement is in line at the beginning of each."""
    if ring.is_closed and not outside.any():
        return [ring]
    least, bend = int(max(MIN_OPEN_M, rig.min_swath_m) / STEP_M), np.abs(ring.curvature_radpm)
    kept = [_trimmed(run, bend[run] < MAX_JOINT_RADPM) for run in _runs(~outside, ring.is_closed)]
    found = [
        replace(ring, points_m=ring.points_m[run], heading_rad=np.unwrap(ring.heading_rad[run]), is_closed=False)
        for run in kept
        if len(run) > least
    ]
    if rig.trailer is None:
        return found
    return [p for p in found if space.is_free(p.points_m, p.heading_rad)]


def _runs(is_kept: Bool, is_closed: bool) -> list[Int64]:
    """Indices of each run of kept points of a line; of a closed one, which repeats its first point, around its end."""
    if not is_closed or is_kept.all():
        return [np.arange(a, b + 1) for a, b in runs_of(is_kept)]
    n = len(is_kept) - 1
    first = int(np.argmin(is_kept[:-1]))
    return [(first + np.arange(a, b + 1)) % n for a, b in runs_of(np.roll(is_kept[:-1], -first))]


def _trimmed(run: Int64, is_level: Bool) -> Int64:
    """A run of points without the bends at both ends: a line begins and ends straight."""
    at = np.flatnonzero(is_level)
    return run[at[0] : at[-1] + 1] if len(at) else run[:0]


def _fills(ring: HeadlandPass, space: FreeSpace, rig: Rig) -> list[tuple[CornerFill | None, CornerFill | None]]:
    """Longest fills at each corner of a closed pass, to either side: before it and behind it."""
    curvature = ring.curvature_radpm[:-1]
    n, found = len(curvature), list[tuple[CornerFill | None, CornerFill | None]]()
    reach = rig.radius_m + rig.working_width_m / 2.0
    for start, length, turn in [*_bends(curvature, 0.5 / rig.radius_m), *_bends(-curvature, 0.5 / rig.radius_m)]:
        corner_m = reach * np.tan(min(turn, MAX_FILL_RAD) / 2.0) + BEYOND_M  # from the ends of the arc, at most
        fills = list[CornerFill | None]()
        for ends, sign in ((start, -1), (start + length, 1)):
            index, fill = _straight_near(curvature, int(ends), sign), None
            if index is not None:
                gap_m = ((index - ends) * sign % n) * STEP_M
                most = gap_m + corner_m + sign * rig.working_x_m
                free = _free_m(ring, index, -sign * (most + rig.config.stop_gap_m), space) - rig.config.stop_gap_m
                if free > gap_m + MIN_REVERSE_M:
                    fill = CornerFill(index, -sign * free)
            fills.append(fill)
        found.append((fills[0], fills[1]))
    return found


def _bends(curvature_radpm: Float64, least_radpm: float) -> list[tuple[int, int, float]]:
    """First index, number of points and angle of each bend to the left of a closed pass that turns far."""
    is_bent, n = curvature_radpm > least_radpm, len(curvature_radpm)
    found = []
    for start in np.flatnonzero(~is_bent & np.roll(is_bent, -1)):
        length = int(np.argmin(np.roll(is_bent, -start - 1))) + 1
        turn = float(curvature_radpm[(start + np.arange(length + 1)) % n].sum()) * STEP_M
        if turn > MIN_FILL_RAD:
            found.append((int(start), length, turn))
    return found


def _straight_near(curvature: Float64, end: int, sign: int) -> int | None:
    """Point beyond one end of an arc where a pass is straight again."""
    at = (end + sign * np.arange(*(int(m / STEP_M) for m in FILL_RUN_M))) % len(curvature)
    bend = np.abs(curvature[at])
    level = np.convolve(bend < STRAIGHT_RADPM, np.ones(LEVEL), "valid") > LEVEL - 0.5  # and straight from there on
    index = int(at[int(np.argmax(level)) if level.any() else int(np.argmin(bend))])
    return index if abs(curvature[index]) < MAX_JOINT_RADPM else None


def _free_m(ring: HeadlandPass, index: int, by_m: float, space: FreeSpace) -> float:
    """Distance that the rig can drive straight from a point of a pass, at most |`by_m`|, in reverse when negative."""
    s = np.arange(0.0, abs(by_m), STEP_M)
    h = float(ring.heading_rad[index])
    line = ring.points_m[index] + np.sign(by_m) * s[:, None] * np.array([np.cos(h), np.sin(h)])
    out = np.append(space.touching(line, np.full(len(s), h)), True)
    return float(max(int(np.argmax(out)) - 1, 0) * STEP_M)
