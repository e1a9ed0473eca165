"""Stop requests of the supervisor: what is requested, which true objects explain it, and which explain nothing."""

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Bool, Float32, Float64
from geometry.pose2 import to_frame
from messages.command import RuleResult, SupervisorState
from messages.faults import Response
from messages.message import Envelope
from validation.drive.stops import OBSTACLE_CHANNELS
from validation.obstacle_stop.by_stamp import nearest
from validation.obstacle_stop.conditions import Conditions
from validation.obstacle_stop.frames import is_in_ring
from validation.obstacle_stop.observation import LogObservation, StopRequest
from validation.obstacle_stop.swept_path import separation_m

TOLERANCE_MPS = 0.05  # tolerance of the supervisor's speed limits
STOP_MPS = 0.3
LATENCY_NS = 300_000_000  # of the measurement behind a request
NO_POINTS = np.empty((0, 3), np.float32)
CAUSE_M = 1.0  # triggering points so much further than the nearest one belong to the same cause


@dataclass(frozen=True, eq=False, slots=True)
class Delivered:
    """What a request needs of a supervisor state, its time of delivery, and the speed that was wanted then.

    `rules` are those of obstacles that limit the speed, `points_m` (N, 3) the triggering points in base, if there are
    any such rules.
    """

    receive_ns: int
    stamp_ns: int
    label: str
    clearance_m: float
    commanded_mps: float
    rules: tuple[RuleResult, ...]
    points_m: Float32

    @classmethod
    def of(cls, envelope: Envelope, state: SupervisorState, commanded_mps: float) -> "Delivered":
        """The delivered state with the speed that was commanded then."""
        rules = tuple(r for r in state.rules if r.code in OBSTACLE_CHANNELS and r.speed_limit_mps < math.inf)
        points = state.triggering_points_base_m if rules else NO_POINTS
        label, clearance_m = (state.obstacle_class.value, state.clearance_m) if rules else ("", math.inf)
        return cls(envelope.receive_ns, state.stamp_ns, label, clearance_m, commanded_mps, rules, points)


def stop_requests(
    delivered: list[Delivered], truth_stamps_ns: Sequence[int], observed: LogObservation, conditions: Conditions
) -> list[StopRequest]:
    """The delivered states as requests in the order of their delivery."""
    explain = _Explanation(truth_stamps_ns, observed, conditions)
    return [_request(one, observed, explain) for one in sorted(delivered, key=lambda d: d.receive_ns)]


def _request(one: Delivered, observed: LogObservation, explain: "_Explanation") -> StopRequest:
    wanted_mps = max(abs(observed.motion.speed_at(one.stamp_ns)), one.commanded_mps)
    binding = [r for r in one.rules if r.speed_limit_mps < wanted_mps - TOLERANCE_MPS]
    stops = [r for r in binding if r.response >= Response.CONTROLLED_STOP or r.speed_limit_mps < STOP_MPS]
    is_stop = any(r.response >= Response.CONTROLLED_STOP for r in binding)
    limit = 0.0 if is_stop else min((max(0.0, r.speed_limit_mps) for r in binding), default=math.inf)
    reason = (stops or binding)[0].code if binding else ""
    touched, cause, is_false, hit = explain(one) if binding else ((), (), None, None)
    return StopRequest(
        one.receive_ns, one.stamp_ns, reason, one.label, one.clearance_m, limit, bool(stops),
        touched, cause, is_false, hit,
    )  # fmt: skip


class _Explanation:
    """Relates triggering points to true objects."""

    def __init__(self, truth_stamps_ns: Sequence[int], observed: LogObservation, conditions: Conditions) -> None:
        self._stamps, self._observed, self._conditions = truth_stamps_ns, observed, conditions
        self._setting = observed.setting

    def __call__(self, one: Delivered) -> tuple[tuple[int, ...], tuple[int, ...], bool | None, Float64 | None]:
        """Ids at any triggering point, ids at the nearest ones, whether these are false, and the nearest in odom."""
        pose, points = self._observed.motion.pose_at(one.stamp_ns), one.points_m.astype(np.float64)
        if pose is None or not len(points):
            return (), (), None, None
        points = points[np.isfinite(points).all(axis=1)]
        away = self._from_outline(points)
        odom = to_frame(pose, points[:, :2])
        near = away <= away.min(initial=math.inf) + CAUSE_M
        touched, cause = self._ids_at(odom, one.stamp_ns), self._ids_at(odom[near], one.stamp_ns)
        is_false = None if cause else self._is_decided(points[near], odom[near], one.stamp_ns)
        first = odom[int(np.argmin(away))] if len(away) else None
        return touched, cause, False if cause else is_false, first

    def _from_outline(self, points: Float64) -> Float64:
        """Separation (N,) of points from the machine."""
        none = np.zeros(2)
        poses = np.column_stack([points[:, :2], np.zeros(len(points))])
        rows = [
            separation_m(np.array([0.5 * (b.front_m + b.rear_m), 0.0, 0.0]),
                         np.array([0.5 * (b.front_m - b.rear_m), b.half_width_m]), poses, none)
            for b in self._setting.working.bodies
        ]  # fmt: skip
        return np.asarray(np.min(rows, axis=0))

    def _ids_at(self, odom: Float64, stamp_ns: int) -> tuple[int, ...]:
        """True objects at the points at the time of the measurement behind the request."""
        reach, out = self._conditions.truth.association_m, []
        points = np.column_stack([odom, np.zeros(len(odom))])
        for track in self._observed.true_tracks.values():
            last = bisect_right(track.stamps_ns, stamp_ns + self._max_age_ns)
            for k in range(last - 1, -1, -1):
                if track.stamps_ns[k] < stamp_ns - LATENCY_NS - self._max_age_ns:
                    break
                if separation_m(track.pose(k), track.half_m, points, np.zeros(2)).min(initial=math.inf) <= reach:
                    out.append(track.id)
                    break
        return tuple(out)

    @property
    def _max_age_ns(self) -> int:
        return round(self._conditions.truth.max_age_s * 1e9)

    def _is_decided(self, points: Float64, odom: Float64, stamp_ns: int) -> bool | None:
        """True where truth is complete at one of the points; None elsewhere."""
        observed = self._observed
        if nearest(self._stamps, stamp_ns, self._max_age_ns) is None:
            return None
        if not self._conditions.is_evaluated(self._setting.log, observed.time_s(stamp_ns)):
            return None
        bearing = np.arctan2(points[:, 1], points[:, 0] - self._view_x_m)
        is_shown = (np.abs(bearing) <= self._setting.view_rad) & ~self._is_ignored(odom)
        return True if bool(is_shown.any()) else None

    @property
    def _view_x_m(self) -> float:
        T = self._setting.T_base_lidar.get(self._setting.truth_frame or "")
        return 0.0 if T is None else float(T[0, 3])

    def _is_ignored(self, odom_m: Float64) -> Bool:
        out = np.zeros(len(odom_m), bool)
        for area in self._conditions.areas(self._setting.log):
            out |= is_in_ring(odom_m, np.array(area.outline_odom_m))
        return out


def limits_for(
    object_id: int,
    ids_before: Callable[[int], set[int]],
    requests: list[StopRequest],
    from_ns: int,
    until_ns: int,
) -> list[tuple[int, float]]:
    """Speed limits by delivery that an object explains, or one that is in the path before it at that time.

    A run of requests counts from the first one that it explains, whatever explains the later ones of the same run.
    """
    out, counts = [], False
    for one in requests:
        if not from_ns <= one.receive_ns <= until_ns:
            continue
        if one.is_braking and not counts:
            counts = object_id in one.touched or not ids_before(one.stamp_ns).isdisjoint(one.touched)
        counts = counts and one.is_braking
        out.append((one.receive_ns, one.limit_mps if counts else math.inf))
    return out
