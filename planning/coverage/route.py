"""Complete route as pieces: from the yard along the lane, headland passes, swaths, and back."""

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
from planning.coverage.headland_route import JOINT, STRIDE, pose_at, route_headland
from planning.coverage.order import Visit, order
from planning.coverage.swath import Swath
from planning.field.drivable_area import describe
from planning.turns.connector import PathConnector, RoutePiece
from planning.turns.turn import STEP_M, ConnectionRequest, shortest_length_m

REORDERINGS = 8
NO_CONNECTION_M = 1e4
HOME_STRAIGHT_M = 1.0


def route(connector: PathConnector, swaths: list[Swath]) -> list[RoutePiece]:
    """All pieces in order; raises FieldError with the position where no connection is found."""
    site = connector.drivable.site
    start = site.start.pose
    pieces, pose = _lane_entry(connector, start)
    passes, rest = route_headland(connector, pose)
    home, home_start = _return_lane(connector)
    return [*pieces, *passes, *_after_headland(connector, rest, home_start, swaths), *home]


def _after_headland(connector: PathConnector, rest: Float64, home: Pose2, swaths: list[Swath]) -> list[RoutePiece]:
    """Swaths and return; before them the part of the last pass up to where it can be left."""
    for k in range(JOINT, len(rest) - 1, STRIDE):
        pose, driven = pose_at(rest, k), rest[k - JOINT : k + 1]
        if (
            k > JOINT
            and connector.find(_return_request(connector, pose, home), is_thorough=False, before=driven) is None
        ):
            continue
        pieces = _drive_swaths(connector, pose, driven, home, swaths)
        if pieces is not None:
            return [*([RoutePiece(PathSectionType.TURN, -1, rest[JOINT : k + 1], False)] if k > JOINT else []), *pieces]
    connector.require(_return_request(connector, pose_at(rest, JOINT), home), "back to the lane")
    raise AssertionError


def _drive_swaths(
    connector: PathConnector, start: Pose2, driven: Float64, home: Pose2, swaths: list[Swath]
) -> list[RoutePiece] | None:
    """The swaths and the return; a swath that cannot be reached or left is dropped and reported as uncovered.

    None where `start`, at the end of the points `driven`, cannot be left.
    """
    while True:
        pieces, stuck = _drive_tour(connector, start, driven, home, _ordered(connector, start, home, swaths))
        if pieces is not None or stuck is None:
            return pieces
        swaths = [s for s in swaths if s is not stuck]


def _return_request(connector: PathConnector, pose: Pose2, home: Pose2) -> ConnectionRequest:
    return ConnectionRequest(pose, home, connector.rig.config.run_out_m, HOME_STRAIGHT_M)


def _drive_tour(
    connector: PathConnector, start: Pose2, driven: Float64, home: Pose2, tour: list[tuple[Swath, bool]]
) -> tuple[list[RoutePiece] | None, Swath | None]:
    """Pieces of a tour, or None and the unreachable swath."""
    pose, last_swath = start, None
    pieces: list[RoutePiece] = []
    for swath, is_reversed in tour:
        first, last = swath.poses(is_reversed, -connector.rig.working_x_m)
        connection = connector.find(_request(connector, pose, first), before=driven if last_swath is None else None)
        if connection is None:
            is_trap = last_swath is not None and connector.find(_return_request(connector, pose, home)) is None
            return None, last_swath if is_trap else swath
        pieces += [RoutePiece(PathSectionType.TURN, swath.number, connection, False)]
        pieces += [RoutePiece(PathSectionType.SWATH, swath.number, _straight(first, last), True)]
        pose, last_swath = last, swath
    connection = connector.find(_return_request(connector, pose, home), before=driven if last_swath is None else None)
    if connection is None:
        return None, last_swath
    return [*pieces, RoutePiece(PathSectionType.TURN, -1, connection, False)], None


def _straight(a: Pose2, b: Pose2) -> Float64:
    return resample(np.array([[a.x_m, a.y_m], [b.x_m, b.y_m]]), STEP_M)


def _lane_entry(connector: PathConnector, start: Pose2) -> tuple[list[RoutePiece], Pose2]:
    lane = lane_line(connector)
    first, last = _end_poses(lane)
    request = ConnectionRequest(start, first, 0.0, 0.0)
    _check_lane(connector, lane)
    pieces = [RoutePiece(PathSectionType.LANE, -1, connector.require(request, "out of the yard"), False)]
    return [*pieces, RoutePiece(PathSectionType.LANE, -1, lane, False)], last


def _check_lane(connector: PathConnector, lane: Float64) -> None:
    for line, heading in ((lane, headings(lane)), (lane, headings(lane) + np.pi)):
        inside = is_inside(connector.rig.bodies, line, heading, connector.drivable.allowed)
        if not inside.all():
            where = describe(connector.drivable.site, *map(float, line[int(np.argmin(inside))]))
            raise FieldError(
                f"a rig {connector.rig.width_m:g} m wide does not fit on the lane at {where}: widen gate or lane"
            )


def lane_line(connector: PathConnector) -> Float64:
    """Centre line of all lanes in order, with corners rounded."""
    site = connector.drivable.site
    if not site.lanes:
        raise FieldError(f"site {site.name!r} has no lane: draw one from the yard through the gate into the field")
    return fillet(polyline([p for lane in site.lanes for p in lane.center_m]), connector.rig.radius_m)


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


def _return_lane(connector: PathConnector) -> tuple[list[RoutePiece], Pose2]:
    lane = lane_line(connector)[::-1]
    first, last = _end_poses(lane)
    parked = _parking(connector, last)
    line = np.vstack([lane, _straight(last, parked)[1:]])
    return [RoutePiece(PathSectionType.LANE, -1, line, False)], first


def _parking(connector: PathConnector, lane_end: Pose2) -> Pose2:
    yard = Polygon(connector.drivable.site.yard.outline_m)
    for ahead in np.arange(0.5, 40.0, 0.5):
        pose = lane_end.ahead(float(ahead))
        p, h = np.array([[pose.x_m, pose.y_m]]), np.array([pose.yaw_rad])
        if (
            is_inside(connector.rig.bodies, p, h, yard)[0]
            and is_inside(connector.rig.bodies, p, h, connector.drivable.allowed)[0]
        ):
            return pose
    where = describe(connector.drivable.site, lane_end.x_m, lane_end.y_m)
    raise FieldError(
        f"the rig cannot stand in the yard straight on from the lane's end at {where}: make the yard deeper"
    )


def _ordered(connector: PathConnector, start: Pose2, home: Pose2, swaths: list[Swath]) -> list[tuple[Swath, bool]]:
    """Swaths ordered by connection length: too short lower bounds are replaced by real lengths iteratively."""
    visits = [s.poses(r, -connector.rig.working_x_m) for s in swaths for r in (False, True)]
    starts, ends = [a for a, _ in visits] + [home], [b for _, b in visits] + [start]
    cost = np.zeros((len(starts), len(starts)))
    for i, end in enumerate(ends):
        for j, first in enumerate(starts):
            cost[i, j] = (
                NO_CONNECTION_M
                if i // 2 == j // 2
                else shortest_length_m(_request(connector, end, first), connector.rig.radius_m)
            )
    cost[-1, -1] = 0.0
    best: tuple[float, Sequence[Visit]] = (np.inf, [])
    for _ in range(REORDERINGS):
        tour = order(cost)
        stops = [len(starts) - 1, *(2 * k + r for k, r in tour), len(starts) - 1]
        real = [connector.find(_request(connector, ends[i], starts[j]), is_thorough=False) for i, j in pairwise(stops)]
        lengths = [NO_CONNECTION_M if connection is None else float(arc_length(connection)[-1]) for connection in real]
        best = min(best, (sum(lengths), tour), key=lambda b: b[0])
        bounds = [cost[i, j] for i, j in pairwise(stops)]
        for i, j, length in zip(stops[:-1], stops[1:], lengths, strict=True):
            cost[i, j] = min(length, NO_CONNECTION_M / 10) if length < NO_CONNECTION_M else 150.0
        if sum(lengths) < sum(bounds) + 0.5:
            break
    return [(swaths[k], r) for k, r in best[1]]


def _request(connector: PathConnector, a: Pose2, b: Pose2) -> ConnectionRequest:
    return ConnectionRequest(a, b, connector.rig.config.run_out_m, connector.rig.config.line_up_m)
