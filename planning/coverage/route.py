"""The whole drive as pieces: from the yard along the lane, the rounds, the swaths, and back."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from shapely.geometry import Polygon

from geometry.arrays import Float64
from geometry.footprint import is_inside
from geometry.polyline import arc_length, headings, polyline, resample
from geometry.pose2 import Pose2
from messages.errors import FieldError
from messages.plan import PathSectionType
from planning.coverage.headland_route import EVERY, JOINT, drive_rounds, pose_at
from planning.coverage.order import Visit, order
from planning.coverage.swath import Swath
from planning.field.drivable_area import describe
from planning.turns.connector import Piece, Ways
from planning.turns.turn import STEP_M, Wanted, shortest_length_m

REORDERINGS = 8
NO_WAY_M = 1e4
HOME_STRAIGHT_M = 1.0


def route(ways: Ways, swaths: list[Swath]) -> list[Piece]:
    """All pieces in order; raises FieldError with the place where it cannot go on."""
    site = ways.ground.site
    start = site.start.pose
    pieces, pose = _way_in(ways, start)
    found, rest = drive_rounds(ways, pose)
    home, home_start = _way_home(ways)
    return [*pieces, *found, *_after_rounds(ways, rest, home_start, swaths), *home]


def _after_rounds(ways: Ways, rest: Float64, home: Pose2, swaths: list[Swath]) -> list[Piece]:
    """Swaths and way home, and before them as much more of the last round as it takes until it can be left."""
    for k in range(JOINT, len(rest) - 1, EVERY):
        pose, driven = pose_at(rest, k), rest[k - JOINT : k + 1]
        if k > JOINT and ways.find(_leave(ways, pose, home), is_thorough=False, before=driven) is None:
            continue
        pieces = _drive_swaths(ways, pose, driven, home, swaths)
        if pieces is not None:
            return [*([Piece(PathSectionType.TURN, -1, rest[JOINT : k + 1], False)] if k > JOINT else []), *pieces]
    ways.demand(_leave(ways, pose_at(rest, JOINT), home), "back to the lane")
    raise AssertionError


def _drive_swaths(ways: Ways, start: Pose2, driven: Float64, home: Pose2, swaths: list[Swath]) -> list[Piece] | None:
    """The swaths and the way home; one that cannot be reached or left is dropped and shows as uncovered.

    None where `start`, to which `driven` leads, cannot be left itself.
    """
    while True:
        pieces, stuck = _drive_tour(ways, start, driven, home, _ordered(ways, start, home, swaths))
        if pieces is not None or stuck is None:
            return pieces
        swaths = [s for s in swaths if s is not stuck]


def _leave(ways: Ways, pose: Pose2, home: Pose2) -> Wanted:
    return Wanted(pose, home, ways.rig.config.run_out_m, HOME_STRAIGHT_M)


def _drive_tour(
    ways: Ways, start: Pose2, driven: Float64, home: Pose2, tour: list[tuple[Swath, bool]]
) -> tuple[list[Piece] | None, Swath | None]:
    """The pieces of a tour, or None and the swath that it cannot have."""
    pose, at = start, None
    pieces: list[Piece] = []
    for swath, is_reversed in tour:
        first, last = swath.poses(is_reversed, -ways.rig.working_x_m)
        way = ways.find(_wanted(ways, pose, first), before=driven if at is None else None)
        if way is None:
            is_trap = at is not None and ways.find(_leave(ways, pose, home)) is None
            return None, at if is_trap else swath
        pieces += [Piece(PathSectionType.TURN, swath.number, way, False)]
        pieces += [Piece(PathSectionType.SWATH, swath.number, _straight(first, last), True)]
        pose, at = last, swath
    way = ways.find(_leave(ways, pose, home), before=driven if at is None else None)
    if way is None:
        return None, at
    return [*pieces, Piece(PathSectionType.TURN, -1, way, False)], None


def _straight(a: Pose2, b: Pose2) -> Float64:
    return resample(np.array([[a.x_m, a.y_m], [b.x_m, b.y_m]]), STEP_M)


def _way_in(ways: Ways, start: Pose2) -> tuple[list[Piece], Pose2]:
    lane = lane_line(ways)
    first, last = _end_poses(lane)
    wanted = Wanted(start, first, 0.0, 0.0)
    _check_lane(ways, lane)
    pieces = [Piece(PathSectionType.LANE, -1, ways.demand(wanted, "out of the yard"), False)]
    return [*pieces, Piece(PathSectionType.LANE, -1, lane, False)], last


def _check_lane(ways: Ways, lane: Float64) -> None:
    for way, heading in ((lane, headings(lane)), (lane, headings(lane) + np.pi)):
        inside = is_inside(ways.rig.bodies, way, heading, ways.ground.allowed)
        if not inside.all():
            where = describe(ways.ground.site, *map(float, way[int(np.argmin(inside))]))
            raise FieldError(
                f"a rig {ways.rig.width_m:g} m wide does not fit on the lane at {where}: widen gate or lane"
            )


def lane_line(ways: Ways) -> Float64:
    """The middle of all lanes one after the other, with corners rounded."""
    site = ways.ground.site
    if not site.lanes:
        raise FieldError(f"site {site.name!r} has no lane: draw one from the yard through the gate into the field")
    return fillet(polyline([p for lane in site.lanes for p in lane.center_m]), ways.rig.radius_m)


def fillet(points_m: Float64, radius_m: float) -> Float64:
    """The polyline with its corners replaced by arcs of `radius_m` (smaller where an edge is too short)."""
    out = [points_m[:1]]
    for a, b, c in zip(points_m[:-2], points_m[1:-1], points_m[2:], strict=True):
        u, v = (b - a) / np.hypot(*(b - a)), (c - b) / np.hypot(*(c - b))
        turn = float(np.arctan2(u[0] * v[1] - u[1] * v[0], u @ v))
        tangent = min(
            radius_m * abs(np.tan(turn / 2.0)), 0.5 * float(np.hypot(*(b - a))), 0.5 * float(np.hypot(*(c - b)))
        )
        share = np.linspace(0.0, 1.0, max(2, int(abs(turn) * radius_m / STEP_M)))[:, None]
        p0, p2 = b - tangent * u, b + tangent * v
        normal = np.array([-u[1], u[0]]) * np.sign(turn)
        r = tangent / max(abs(np.tan(turn / 2.0)), 1e-9)
        angle = share[:, 0] * abs(turn)
        arc = p0 + r * (np.sin(angle)[:, None] * u + (1.0 - np.cos(angle))[:, None] * normal)
        out.append(arc if abs(turn) > 1e-6 else np.vstack([p0, p2]))
    out.append(points_m[-1:])
    return resample(np.vstack(out), STEP_M)


def _end_poses(points_m: Float64) -> tuple[Pose2, Pose2]:
    def pose(p: Float64, q: Float64, at: Float64) -> Pose2:
        return Pose2(float(at[0]), float(at[1]), float(np.arctan2(q[1] - p[1], q[0] - p[0])))

    return pose(points_m[0], points_m[1], points_m[0]), pose(points_m[-2], points_m[-1], points_m[-1])


def _way_home(ways: Ways) -> tuple[list[Piece], Pose2]:
    lane = lane_line(ways)[::-1]
    first, last = _end_poses(lane)
    parked = _parking(ways, last)
    way = np.vstack([lane, _straight(last, parked)[1:]])
    return [Piece(PathSectionType.LANE, -1, way, False)], first


def _parking(ways: Ways, lane_end: Pose2) -> Pose2:
    yard = Polygon(ways.ground.site.yard.outline_m)
    for ahead in np.arange(0.5, 40.0, 0.5):
        pose = lane_end.ahead(float(ahead))
        p, h = np.array([[pose.x_m, pose.y_m]]), np.array([pose.yaw_rad])
        if is_inside(ways.rig.bodies, p, h, yard)[0] and is_inside(ways.rig.bodies, p, h, ways.ground.allowed)[0]:
            return pose
    where = describe(ways.ground.site, lane_end.x_m, lane_end.y_m)
    raise FieldError(
        f"the rig cannot stand in the yard straight on from the lane's end at {where}: make the yard deeper"
    )


def _ordered(ways: Ways, start: Pose2, home: Pose2, swaths: list[Swath]) -> list[tuple[Swath, bool]]:
    """Swaths in an order that is short by real ways: a guess that was too short is corrected and tried again."""
    visits = [s.poses(r, -ways.rig.working_x_m) for s in swaths for r in (False, True)]
    starts, ends = [a for a, _ in visits] + [home], [b for _, b in visits] + [start]
    cost = np.zeros((len(starts), len(starts)))
    for i, end in enumerate(ends):
        for j, first in enumerate(starts):
            cost[i, j] = (
                NO_WAY_M if i // 2 == j // 2 else shortest_length_m(_wanted(ways, end, first), ways.rig.radius_m)
            )
    cost[-1, -1] = 0.0
    best: tuple[float, Sequence[Visit]] = (np.inf, [])
    for _ in range(REORDERINGS):
        tour = order(cost)
        stops = [len(starts) - 1, *(2 * k + r for k, r in tour), len(starts) - 1]
        real = [ways.find(_wanted(ways, ends[i], starts[j]), is_thorough=False) for i, j in pairwise(stops)]
        lengths = [NO_WAY_M if way is None else float(arc_length(way)[-1]) for way in real]
        best = min(best, (sum(lengths), tour), key=lambda b: b[0])
        guessed = [cost[i, j] for i, j in pairwise(stops)]
        for i, j, length in zip(stops[:-1], stops[1:], lengths, strict=True):
            cost[i, j] = min(length, NO_WAY_M / 10) if length < NO_WAY_M else 150.0
        if sum(lengths) < sum(guessed) + 0.5:
            break
    return [(swaths[k], r) for k, r in best[1]]


def _wanted(ways: Ways, a: Pose2, b: Pose2) -> Wanted:
    return Wanted(a, b, ways.rig.config.run_out_m, ways.rig.config.line_up_m)
