"""Stops: cause, true object at the cause, and remaining margin."""

from dataclasses import dataclass

import numpy as np

from geometry.transforms import apply
from messages.command import Mode, SupervisorState
from messages.truth import TrueMachine, TrueObject, TrueObjects
from validation.drive.record import DriveRecord, stamps_of

STOPS = (Mode.OBSTACLE_STOP, Mode.FAULT_STOP, Mode.EMERGENCY_STOP)
OBSTACLE_CHANNELS = ("protective_field", "tracked_obstacle")
ONE_EPISODE_NS = 1_000_000_000  # a cause that disappears for less is the same
ASSOCIATION_M = 1.5  # a triggering point this near to the box of an object belongs to it


@dataclass(frozen=True)
class Stop:
    """One stop; `role` is the scenario's name of the object that caused it, "" without one."""

    t_s: float
    cause: str
    label: str
    role: str
    range_m: float
    stopping_distance_m: float
    required_range_m: float
    margin_m: float

    @property
    def as_dict(self) -> dict[str, object]:
        """Object in `run --json`."""
        numbers = {
            k: _number(getattr(self, k)) for k in ("range_m", "stopping_distance_m", "required_range_m", "margin_m")
        }
        return {"t_s": round(self.t_s, 2), "cause": self.cause, "class": self.label, "role": self.role} | numbers


def _number(value: float) -> float | None:
    return round(value, 3) if np.isfinite(value) else None


def find_stops(record: DriveRecord) -> list[Stop]:
    """All transitions into a stop mode, in order."""
    states = record.supervisor
    entries = [k for k in range(1, len(states)) if states[k].mode in STOPS and states[k - 1].mode not in STOPS]
    return [_describe(record, states, k) for k in entries]


def _describe(record: DriveRecord, states: list[SupervisorState], entry: int) -> Stop:
    """Cause, first range and margin; the stop begins with the first state with a reason of the same kind."""
    state, first = states[entry], entry
    kind = cause_kind(state.reason)
    since_ns = state.stamp_ns
    for k in range(entry, -1, -1):
        if since_ns - states[k].stamp_ns > ONE_EPISODE_NS:
            break
        if cause_kind(states[k].reason) == kind:
            first, since_ns = k, states[k].stamp_ns
    last = entry
    while last + 1 < len(states) and states[last + 1].mode is state.mode:
        last += 1
    began = states[first]
    role, margin = _truth_at(record, states[entry : last + 1])
    label = state.obstacle_class.value
    return Stop(
        record.time_s(state.stamp_ns), state.reason, label, role,
        began.clearance_m, began.stopping_distance_m, began.required_range_m,
        state.clearance_m if margin is None else margin,
    )  # fmt: skip


def cause_kind(reason: str) -> str:
    """Kind of a cause: both obstacle channels are one, other codes go by their first part."""
    first = reason.partition(".")[0]
    return "obstacle" if first in OBSTACLE_CHANNELS else first


def _truth_at(record: DriveRecord, during: list[SupervisorState]) -> tuple[str, float | None]:
    """Role of the object at the triggering points, and the smallest true clearance to it during the stop."""
    objects, truth = record.objects, record.truth
    if not objects or not truth:
        return "", None
    object_stamps, truth_stamps = stamps_of(objects), stamps_of(truth)
    for state in during:
        there = objects[_at(object_stamps, state.stamp_ns)]
        found = _touched(state, truth[_at(truth_stamps, state.stamp_ns)], there)
        if found:
            first, last = _at(object_stamps, during[0].stamp_ns), _at(object_stamps, during[-1].stamp_ns)
            clearances = [o.clearance_m for m in objects[first : last + 1] for o in m.objects if o.id == found.id]
            return found.role, min(clearances)
    return "", None


def _at(stamps_ns: np.ndarray, stamp_ns: int) -> int:
    return max(int(np.searchsorted(stamps_ns, stamp_ns, side="right")) - 1, 0)


def _touched(state: SupervisorState, machine: TrueMachine, objects: TrueObjects) -> TrueObject | None:
    """Object with a role nearest to a triggering point, within `ASSOCIATION_M`."""
    if not len(state.triggering_points_base_m):
        return None
    hits = apply(machine.T_map_base, state.triggering_points_base_m.astype(float))[:, :2]
    best, least = None, ASSOCIATION_M
    for true in objects.objects:
        c, s = np.cos(true.yaw_rad), np.sin(true.yaw_rad)
        local = (hits - true.center_map_m[:2]) @ np.array([[c, -s], [s, c]])
        outside = np.maximum(np.abs(local) - true.size_m[:2] / 2.0, 0.0)
        distance = float(np.hypot(outside[:, 0], outside[:, 1]).min())
        if true.role and distance < least:
            best, least = true, distance
    return best


def false_stops(stops: list[Stop], expected: dict[str, int]) -> list[Stop]:
    """Stops that the scenario does not announce: none of its objects there, or more often than stated."""
    left, out = dict(expected), []
    for stop in stops:
        if left.get(stop.role, 0) > 0:
            left[stop.role] -= 1
        else:
            out.append(stop)
    return out
