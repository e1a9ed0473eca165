"""Ghost: the machine with the worst-case brake that obeys the recorded requests, on the recorded path.

Until the first request it is the recorded machine. From a request on it drives by itself: after the dead time the brake
builds up until the requested speed is reached; it never profits from braking of a driver. A release puts it back onto
the recorded machine, unless both differ by more than `SPLIT_M` by then: the recording no longer shows what the stack
would have seen from the ghost. The request in force then stays (latched), and later ones only tighten it: where the
ghost reaches the place at which they were made, and, where the ghost is ahead of a machine that brakes better, those
that the stack made when the object was not nearer than it is to the ghost. Numbers only, no messages.
"""

import math
from dataclasses import dataclass

import numpy as np

from geometry.arrays import Bool, Float64
from validation.obstacle_stop.conditions import BrakingValues

STEP_S = 0.01
SPLIT_M = 0.5
STANDING_MPS = 0.02
MAX_COAST_S = 60.0


@dataclass(frozen=True, eq=False)
class GhostDrive:
    """Distance and speed (K,) at times (K,); `is_own`: not the recorded machine; `is_requested`: it obeys."""

    t_s: Float64
    s_m: Float64
    speed_mps: Float64
    is_own: Bool
    is_requested: Bool

    @property
    def stands(self) -> bool:
        """Whether it ends at standstill by itself."""
        return bool(self.is_requested[-1] and self.speed_mps[-1] <= STANDING_MPS)


@dataclass(eq=False)
class _State:
    s_m: float
    speed_mps: float
    brake_mps2: float = 0.0
    is_own: bool = False
    held_mps: float = math.inf
    is_latched: bool = False
    latched_at: int = 0
    seen: int = 0


@dataclass(frozen=True, eq=False)
class _Recorded:
    """Distance, requested limit and gap (K,) of the recorded machine."""

    s_m: Float64
    limit_mps: Float64
    gap_m: Float64

    def least_limit_mps(self, first: int, gap_m: float) -> float:
        """Least limit of the request in force from step `first` on, while the gap was not less."""
        released = np.flatnonzero(np.isinf(self.limit_mps[first:]))
        run = slice(first, first + int(released[0]) if len(released) else None)
        is_met = np.isfinite(self.gap_m[run]) & (self.gap_m[run] >= gap_m)
        return float(self.limit_mps[run][is_met].min(initial=math.inf))


def drive_ghost(
    t_s: Float64, s_m: Float64, speed_mps: Float64, limit_mps: Float64, gap_m: Float64, braking: BrakingValues
) -> GhostDrive:
    """Ghost of a recording: distance and speed (K,) at times (K,) `STEP_S` apart, and the speed limit requested then.

    `gap_m` (K,) is the gap of the recorded machine to the object, infinite out of the path. An infinite limit is no
    request. After the last time the request in force stays.
    """
    recorded = _Recorded(s_m, limit_mps, gap_m)
    dead = round(braking.dead_time_s / STEP_S)
    ghost, commands = _State(float(s_m[0]), float(speed_mps[0])), [math.inf] * dead
    rows = []
    for k in range(len(t_s)):
        command = _command(ghost, k, recorded)
        commands.append(command)
        acting = commands[k]
        if not ghost.is_own or (math.isinf(command) and math.isinf(acting) and not ghost.is_latched):
            ghost.s_m, ghost.speed_mps, ghost.brake_mps2 = float(s_m[k]), float(speed_mps[k]), 0.0
            ghost.is_own = command < speed_mps[k]
        rows.append((ghost.s_m, ghost.speed_mps, ghost.is_own, math.isfinite(command)))
        if ghost.is_own:
            _advance(ghost, acting, min(float(speed_mps[k]), acting), braking)
        if ghost.is_latched and ghost.held_mps <= 0.0 and ghost.speed_mps <= 0.0:
            break
    rows += _beyond(ghost, commands[len(rows) :], recorded, braking) if ghost.is_own else []
    s, v, own, requested = (np.array(column) for column in zip(*rows, strict=True))
    return GhostDrive(t_s[0] + STEP_S * np.arange(len(s)), s, v, own.astype(bool), requested.astype(bool))


def _command(ghost: _State, k: int, recorded: _Recorded) -> float:
    """Speed limit that the ghost obeys at step `k`."""
    requested = float(recorded.limit_mps[k])
    if ghost.is_own and not ghost.is_latched and abs(recorded.s_m[k] - ghost.s_m) > SPLIT_M and requested < math.inf:
        _latch(ghost, requested, k, k)
    return _tightened(ghost, k, recorded) if ghost.is_latched else requested


def _latch(ghost: _State, limit_mps: float, at: int, seen: int) -> None:
    ghost.is_latched, ghost.held_mps, ghost.latched_at, ghost.seen = True, limit_mps, at, seen


def _tightened(ghost: _State, last: int, recorded: _Recorded) -> float:
    """Latched limit after the requests up to step `last` at the places and gaps that the ghost has reached."""
    while ghost.seen <= last and recorded.s_m[ghost.seen] <= ghost.s_m:
        ghost.held_mps = min(ghost.held_mps, float(recorded.limit_mps[ghost.seen]))
        ghost.seen += 1
    ahead_m = ghost.s_m - float(recorded.s_m[last])
    if ahead_m > 0.0 and math.isfinite(recorded.gap_m[last]):
        nearer_mps = recorded.least_limit_mps(ghost.latched_at, float(recorded.gap_m[last]) - ahead_m)
        ghost.held_mps = min(ghost.held_mps, nearer_mps)
    return ghost.held_mps


def _advance(ghost: _State, acting_mps: float, coasting_mps: float, braking: BrakingValues) -> None:
    """One step with the limit that acts on the brake; `coasting_mps` is the least speed without braking."""
    speed = ghost.speed_mps
    if acting_mps < speed:
        before, full = ghost.brake_mps2, braking.deceleration_mps2
        build_up = full / braking.build_up_s * STEP_S if braking.build_up_s > 0.0 else full
        ghost.brake_mps2 = min(full, before + build_up)
        ghost.speed_mps = max(acting_mps, speed - 0.5 * (before + ghost.brake_mps2) * STEP_S)
    else:
        ghost.brake_mps2, ghost.speed_mps = 0.0, max(speed, coasting_mps)
    ghost.s_m += 0.5 * (speed + ghost.speed_mps) * STEP_S


def _beyond(
    ghost: _State, commands: list[float], recorded: _Recorded, braking: BrakingValues
) -> list[tuple[float, float, bool, bool]]:
    """Rows after the end of the recording, up to standstill or to its last place: the request in force stays."""
    last = len(recorded.s_m) - 1
    if not ghost.is_latched and math.isfinite(recorded.limit_mps[last]):
        _latch(ghost, float(recorded.limit_mps[last]), last, last + 1)
    if not ghost.is_latched:
        return []  # released: the brake is about to follow
    rows = [(ghost.s_m, ghost.speed_mps, True, True)]
    for k in range(round(MAX_COAST_S / STEP_S)):
        held = _tightened(ghost, last, recorded)
        commands.append(held)
        is_settled = ghost.speed_mps <= held and (held > 0.0 or ghost.speed_mps <= 0.0)
        if ghost.speed_mps <= 0.0 or (is_settled and ghost.s_m >= recorded.s_m[last]):
            break
        _advance(ghost, commands[k], 0.0, braking)
        rows.append((ghost.s_m, ghost.speed_mps, True, True))
    return rows
