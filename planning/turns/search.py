"""Fastest free turn between two poses: all words with straight ends, ranked by time, checked against the free space."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Float64, Int32
from geometry.drawbar import follow
from geometry.jit import kernel
from geometry.pose2 import Pose2
from planning.turns.curve import MAX_SEGMENTS, solve, trace
from planning.turns.free_space import FreeSpace, is_touching
from planning.turns.words import MAX_WORDS, SEGMENTS, words

STEP_M = 0.1
COARSE_M = 0.5
BETWEEN = 4  # steps of a last check between two poses: a corner of a body may pass a corner of the field there
COARSE_SLACK_M = 0.1  # of the first check, before ramps are corrected
COARSE_HITCH = 1.3  # of the hitch angle at the goal, in that check
MAX_POSES = 6000
MAX_CANDIDATES = 6144
MIN_RUN_M = 0.6
FACTORS = (1.0, 1.3, 1.8)
MORE_M = (0.0, 1.5, 3.5, 6.5)  # longer straight ends
BACK_M = (-3.0, -5.5, -9.0)  # straight ends in reverse
AT_ONCE_M = -1e-10  # straight end where the rig stands: reversing, an arc follows at once
OVER_M = (3.0, 8.0)  # beyond the other end of a line
FIRST_LIMIT, LIMIT = 24, 160
UP_SHARES, LEAST_UP_M = (0.3, 0.45, 0.6, 0.75, 1.0), 1.0  # of the run-in of a trailed implement after the tightest turn
FIRST_LIMIT_TRAILED, LIMIT_TRAILED = 40, 400
NEAR_M, FAR_S = 40.0, 12.0  # farther apart a bound is the straight distance and this time


@dataclass(frozen=True)
class TurnTimes:
    """Speeds of turns; time of one change of direction and length that it keeps free ahead of the rig.

    `has_reverse`: turns may reverse.
    """

    forward_mps: float
    reverse_mps: float
    cusp_s: float
    gap_m: float
    has_reverse: bool


@dataclass(frozen=True)
class ConnectionRequest:
    """From `start` to `goal`, straight for at least `run_out_m` after the first and `line_up_m` before the second.

    The rig may also reverse over the line just driven, `behind_m` long, or over the one to come, `ahead_m` long.
    A trailed implement has the hitch angle `hitch_rad` at the start and at most `most_hitch_rad` at the goal.
    """

    start: Pose2
    goal: Pose2
    run_out_m: float
    line_up_m: float
    behind_m: float = 0.0
    ahead_m: float = 0.0
    hitch_rad: float = 0.0
    most_hitch_rad: float = math.inf


@dataclass(frozen=True)
class Leg:
    """Part of a path in one direction: points (N, 2) at most 0.1 m apart, heading and curvature (N,)."""

    direction: int
    p_map_m: Float64
    heading_rad: Float64
    curvature_radpm: Float64

    def pose(self, k: int) -> Pose2:
        """Pose at an index."""
        return Pose2(*map(float, (*self.p_map_m[k], self.heading_rad[k])))

    @property
    def back(self) -> "Leg":
        """The same way driven the other way round, turned by half a circle."""
        return Leg(self.direction, self.p_map_m[::-1], self.heading_rad[::-1] + math.pi, -self.curvature_radpm[::-1])

    @property
    def backwards(self) -> "Leg":
        """The same poses in the opposite order and direction of travel."""
        return Leg(-self.direction, self.p_map_m[::-1], self.heading_rad[::-1], self.curvature_radpm[::-1])


@dataclass(frozen=True)
class Connection:
    """Free connection of two poses, one leg for each direction; `hitch_rad` of a trailed implement at its end."""

    legs: tuple[Leg, ...]
    time_s: float
    hitch_rad: float = 0.0

    @property
    def points_m(self) -> Float64:
        """All points (N, 2)."""
        return np.vstack([leg.p_map_m for leg in self.legs])


def find_turn(
    request: ConnectionRequest, space: FreeSpace, times: TurnTimes, is_first_only: bool = False
) -> Connection | None:
    """Fastest free turn, or None; first the shortest straight ends, then all (not with `is_first_only`)."""
    if not space.contains(request.start.x_m, request.start.y_m):
        return None
    if space.trailer is not None:
        return _find_trailed(request, space, times, is_first_only)
    back = BACK_M if times.has_reverse else ()
    outs, ups = ([m + more for more in MORE_M] for m in (request.run_out_m, request.line_up_m))
    found = _search(request, space, times, ([outs[0], *back[:1]], [ups[0], *back[:1]], FACTORS[:1]), FIRST_LIMIT)
    if found is not None or is_first_only:
        return found
    over = [
        [-line_m - more for more in OVER_M if line_m > 0.0 and back] for line_m in (request.behind_m, request.ahead_m)
    ]
    return _search(request, space, times, ([*outs, *back, *over[0]], [*ups, *back, *over[1]], FACTORS), LIMIT)


def _find_trailed(
    request: ConnectionRequest, space: FreeSpace, times: TurnTimes, is_first_only: bool
) -> Connection | None:
    """As `find_turn`: after most turns the implement is on its line before the longest run-in ends."""
    least_m = min(LEAST_UP_M, request.line_up_m)
    ups = list(dict.fromkeys(max(share * request.line_up_m, least_m) for share in UP_SHARES))
    found = _search(request, space, times, ([request.run_out_m], ups, FACTORS[:1]), FIRST_LIMIT_TRAILED)
    if found is not None or is_first_only:
        return found
    outs = [request.run_out_m + more for more in MORE_M]
    ends = outs, [*ups, *(request.line_up_m + more for more in MORE_M[1:])], FACTORS
    return _search(request, space, times, ends, LIMIT_TRAILED)


def _search(
    request: ConnectionRequest, space: FreeSpace, times: TurnTimes,
    ends: tuple[Sequence[float], Sequence[float], Sequence[float]], limit: int,
) -> Connection | None:  # fmt: skip
    outs, ups, factors = (np.array(values, np.float64) for values in ends)
    speeds = np.array([times.forward_mps, times.reverse_mps, times.cusp_s])
    start, goal = np.array(request.start, np.float64), np.array(request.goal, np.float64)
    poses = np.empty((MAX_POSES, 5))
    count, time_s = search_kernel(
        start, goal, outs, ups, factors, speeds, times.has_reverse, times.gap_m, space.radius_m, space.smoothing_m,
        limit, space.boxes_m, space.trailed_m, request.hitch_rad, request.most_hitch_rad, *space.grid, poses,
    )  # fmt: skip
    if count == 0:
        return None
    hitch_rad = space.hitch_after(poses[:count, :2], poses[:count, 2], request.hitch_rad)
    return Connection(_legs(poses[:count]), time_s, hitch_rad)


def straight(a: Pose2, b: Pose2) -> Leg:
    """Straight leg from a pose to another ahead of it (in reverse: behind it), at the heading of the first."""
    ahead = math.cos(a.yaw_rad) * (b.x_m - a.x_m) + math.sin(a.yaw_rad) * (b.y_m - a.y_m)
    count = max(2, math.ceil(abs(ahead) / STEP_M) + 1)
    p = np.linspace((a.x_m, a.y_m), (b.x_m, b.y_m), count)
    return Leg(1 if ahead >= 0.0 else -1, p, np.full(count, a.yaw_rad), np.zeros(count))


def _legs(poses: Float64) -> tuple[Leg, ...]:
    cuts = np.flatnonzero(np.diff(poses[:, 4])) + 1
    return tuple(
        Leg(int(part[0, 4]), part[:, :2].copy(), part[:, 2].copy(), part[:, 3].copy()) for part in np.split(poses, cuts)
    )


def bounds_s(ends: Sequence[Pose2], starts: Sequence[Pose2], run_out_m: float, line_up_m: float, radius_m: float,
             times: TurnTimes) -> Float64:  # fmt: skip
    """Time of the fastest turn with shortest straight ends from each end to each start, (E, S), s, without obstacles.

    With reversing, longer straight ends may be faster.
    """
    speeds = np.array([times.forward_mps, times.reverse_mps, times.cusp_s])
    back = BACK_M[:1] if times.has_reverse else ()
    return _bounds(
        np.array(ends, np.float64).reshape(-1, 3), np.array(starts, np.float64).reshape(-1, 3),
        np.array([run_out_m, *back]), np.array([line_up_m, *back]), radius_m, speeds, times.has_reverse,
    )  # fmt: skip


@kernel
def _bounds(
    ends: Float64, starts: Float64, outs: Float64, ups: Float64, radius_m: float, speeds: Float64, has_reverse: bool
) -> Float64:
    found = np.empty((len(ends), len(starts)))
    lengths, sides = np.empty((MAX_WORDS, SEGMENTS)), np.empty((MAX_WORDS, SEGMENTS))
    row = np.empty(MAX_SEGMENTS)
    for i in range(len(ends)):
        for j in range(len(starts)):
            far = math.hypot(starts[j, 0] - ends[i, 0], starts[j, 1] - ends[i, 1])
            if far > NEAR_M:
                found[i, j] = far / speeds[0] + FAR_S
                continue
            best = np.inf
            for out in outs:
                for up in ups:
                    if out < 0.0 and up < 0.0:
                        continue
                    count = _words_between(ends[i], starts[j], out, up, radius_m, has_reverse, lengths, sides)
                    for k in range(count):
                        best = min(best, _time(lengths[k], radius_m, out, up, speeds, row))
            found[i, j] = best
    return found


@kernel
def _words_between(
    start: Float64, goal: Float64, out: float, up: float, radius_m: float, has_reverse: bool, lengths: Float64,
    sides: Float64,
) -> int:  # fmt: skip
    c, s = math.cos(start[2]), math.sin(start[2])
    dx = goal[0] - up * math.cos(goal[2]) - start[0] - out * c
    dy = goal[1] - up * math.sin(goal[2]) - start[1] - out * s
    return words(
        (c * dx + s * dy) / radius_m, (c * dy - s * dx) / radius_m, goal[2] - start[2], has_reverse, lengths, sides
    )


@kernel
def _time(lengths: Float64, radius_m: float, out: float, up: float, speeds: Float64, row: Float64) -> float:
    """Time of a word with its straight ends; infinite when a run is too short. Fills `row` with lengths in metres."""
    row[0], row[MAX_SEGMENTS - 1] = out, up
    for k in range(SEGMENTS):
        row[k + 1] = lengths[k] * radius_m if abs(lengths[k]) > 1e-6 else 0.0
    time, run, direction = 0.0, 0.0, 0.0
    for k in range(MAX_SEGMENTS):
        if row[k] == 0.0:
            continue
        sign = 1.0 if row[k] > 0.0 else -1.0
        if direction != 0.0 and sign != direction:
            if run < MIN_RUN_M:
                return np.inf
            run, time = 0.0, time + speeds[2]
        direction, run = sign, run + abs(row[k])
        time += abs(row[k]) / (speeds[0] if sign > 0.0 else speeds[1])
    if direction < 0.0:
        time += speeds[2]
    return time if run >= MIN_RUN_M else np.inf


@kernel
def search_kernel(
    start: Float64, goal: Float64, outs: Float64, ups: Float64, factors: Float64, speeds: Float64, has_reverse: bool,
    gap_m: float, radius_m: float, ramp_m: float, limit: int, boxes_m: Float64, trailed_m: Float64, hitch_rad: float,
    most_hitch_rad: float, edges_m: Float64, west_m: float, south_m: float, columns: int, rows: int, first: Int32,
    items: Int32, poses: Float64,
) -> tuple[int, float]:  # fmt: skip
    """Fills `poses` with the fastest free one of the first `limit` candidates; their number (0: none) and its time."""
    lengths, sides = np.empty((MAX_WORDS, SEGMENTS)), np.empty((MAX_WORDS, SEGMENTS))
    rows_m, rows_radpm = np.zeros((MAX_CANDIDATES, MAX_SEGMENTS)), np.zeros((MAX_CANDIDATES, MAX_SEGMENTS))
    time, total = np.empty(MAX_CANDIDATES), 0
    row = np.empty(MAX_SEGMENTS)
    slim = boxes_m.copy()
    slim[:, 0] += COARSE_SLACK_M
    slim[:, 1:] -= COARSE_SLACK_M
    outs = _free_ends(start, 1.0, outs, ramp_m, slim, edges_m, west_m, south_m, columns, rows, first, items)
    ups = _free_ends(goal, -1.0, ups, ramp_m, slim, edges_m, west_m, south_m, columns, rows, first, items)
    for factor in factors:
        radius = factor * radius_m
        for out in outs:
            for up in ups:
                count = _words_between(start, goal, out, up, radius, has_reverse, lengths, sides)
                for k in range(count):
                    needed = _time(lengths[k], radius, out, up, speeds, row)
                    if needed < np.inf and total < MAX_CANDIDATES:
                        rows_m[total], time[total] = row, needed
                        rows_radpm[total, 0] = rows_radpm[total, MAX_SEGMENTS - 1] = 0.0
                        for n in range(SEGMENTS):
                            rows_radpm[total, n + 1] = sides[k, n] / radius
                        total += 1
    order = np.argsort(time[:total], kind="mergesort")
    slim_trailed = trailed_m.copy()
    slim_trailed[:, 0] += COARSE_SLACK_M
    slim_trailed[:, 1:3] -= COARSE_SLACK_M
    for n in range(min(limit, total)):
        k = order[n]
        count = trace(rows_m[k], rows_radpm[k], start, ramp_m, COARSE_M, poses)
        if count == 0 or not _is_free(poses, count, gap_m, slim, edges_m, west_m, south_m, columns, rows, first, items):
            continue
        if not _is_trailed_free(
            poses, count, slim_trailed, hitch_rad, COARSE_HITCH * most_hitch_rad, edges_m, west_m, south_m, columns,
            rows, first, items
        ):  # fmt: skip
            continue
        if not solve(rows_m[k], rows_radpm[k], start, goal, ramp_m, STEP_M, poses):
            continue
        count = trace(rows_m[k], rows_radpm[k], start, ramp_m, STEP_M, poses)
        if count == 0 or not _is_free(
            poses, count, gap_m, boxes_m, edges_m, west_m, south_m, columns, rows, first, items
        ):  # fmt: skip
            continue
        if not _is_free_between(poses, count, boxes_m, edges_m, west_m, south_m, columns, rows, first, items):
            continue
        if _is_trailed_free(
            poses, count, trailed_m, hitch_rad, most_hitch_rad, edges_m, west_m, south_m, columns, rows, first, items
        ):  # fmt: skip
            return count, time[k]
    return 0, np.inf


@kernel
def _free_ends(
    pose: Float64, sign: float, ends: Float64, ramp_m: float, boxes_m: Float64, edges_m: Float64, west_m: float,
    south_m: float, columns: int, rows: int, first: Int32, items: Int32,
) -> Float64:  # fmt: skip
    """Those lengths of a straight end at a pose, ahead of it with `sign` 1, on which the rig is free."""
    c, s, free_m = sign * math.cos(pose[2]), sign * math.sin(pose[2]), np.zeros(2)
    most_m = max(0.0, ends.max()), max(0.0, -ends.min())
    for k in range(2):
        way = 1.0 - 2.0 * k
        while free_m[k] < most_m[k]:
            x, y = pose[0] + way * free_m[k] * c, pose[1] + way * free_m[k] * s
            if is_touching(x, y, pose[2], boxes_m, edges_m, west_m, south_m, columns, rows, first, items):
                break
            free_m[k] += COARSE_M
    found: Float64 = ends[(ends <= free_m[0] + 0.5 * ramp_m) & (-ends <= free_m[1] + 0.5 * ramp_m)]
    return found


@kernel
def _is_free(
    poses: Float64, count: int, gap_m: float, boxes_m: Float64, edges_m: Float64, west_m: float, south_m: float,
    columns: int, rows: int, first: Int32, items: Int32,
) -> bool:  # fmt: skip
    """Whether the rig is free at all poses, and `gap_m` farther where it changes direction."""
    for k in range(count):
        x, y, heading = poses[k, 0], poses[k, 1], poses[k, 2]
        if is_touching(x, y, heading, boxes_m, edges_m, west_m, south_m, columns, rows, first, items):
            return False
        before = poses[k - 1, 4] if k > 0 else 1.0
        if poses[k, 4] != before or (k == count - 1 and poses[k, 4] < 0.0):
            by = gap_m * (before if poses[k, 4] != before else -1.0)
            x, y = x + by * math.cos(heading), y + by * math.sin(heading)
            if is_touching(x, y, heading, boxes_m, edges_m, west_m, south_m, columns, rows, first, items):
                return False
    return True


@kernel
def _is_free_between(
    poses: Float64, count: int, boxes_m: Float64, edges_m: Float64, west_m: float, south_m: float, columns: int,
    rows: int, first: Int32, items: Int32,
) -> bool:  # fmt: skip
    """Whether the rig is free between each pose and the next."""
    for k in range(count - 1):
        for n in range(1, BETWEEN):
            share = n / BETWEEN
            x, y, heading = poses[k, :3] + share * (poses[k + 1, :3] - poses[k, :3])
            if is_touching(x, y, heading, boxes_m, edges_m, west_m, south_m, columns, rows, first, items):
                return False
    return True


@kernel
def _is_trailed_free(
    poses: Float64, count: int, trailed_m: Float64, hitch_rad: float, most_hitch_rad: float, edges_m: Float64,
    west_m: float, south_m: float, columns: int, rows: int, first: Int32, items: Int32,
) -> bool:  # fmt: skip
    """Whether a trailed implement, if there is one, is free at all poses and near the line of the last one there."""
    if len(trailed_m) == 0:
        return True
    box, hitch_m, axle_m, yaw, x, y = trailed_m[:, :3], trailed_m[0, 3], trailed_m[0, 4], 0.0, 0.0, 0.0
    for k in range(count):
        next_x = poses[k, 0] + hitch_m * math.cos(poses[k, 2])
        next_y = poses[k, 1] + hitch_m * math.sin(poses[k, 2])
        yaw = poses[0, 2] + hitch_rad if k == 0 else follow(yaw, next_x - x, next_y - y, axle_m)
        x, y = next_x, next_y
        if is_touching(x, y, yaw, box, edges_m, west_m, south_m, columns, rows, first, items):
            return False
    turn = yaw - poses[count - 1, 2]
    return bool(abs(turn - 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)) <= most_hitch_rad)
