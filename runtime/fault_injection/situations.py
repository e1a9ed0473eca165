"""Situations in which faults are injected, and the monitor that detects them."""

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
import shapely

from messages.command import Mode, SupervisorState
from messages.faults import Fault
from messages.message import Envelope, Message
from messages.plan import MissionStatus, Path, PathSectionType
from messages.truth import TrueMachine
from safety.rules import speed_limit

STANDING_MPS, STEADY_MPS, PERIOD_S = 0.02, 0.05, 0.05  # the truth's period
MODE_NAMES = tuple(str(mode) for mode in Mode)


@dataclass
class DriveMonitor:
    """Sink: newest message of each topic; since the last `reset` motion, and texts of alarms with their first time.

    `fastest_mps` is the highest speed within the first `reaction_s`, until which the machine may still gain speed;
    `steepest` the steepest downhill grade (sine) in the direction of travel.
    """

    reaction_s: float = math.inf
    newest: dict[str, Message] = field(default_factory=dict)
    seconds: float = 0.0  # since the reset, counted in true machine messages: clocks may be faulty
    travel_m: float = 0.0
    fastest_mps: float = 0.0
    steepest: float = 0.0
    standstill_s: float = 0.0
    path_error_m: float = 0.0
    speeds_mps: deque[float] = field(default_factory=lambda: deque(maxlen=round(1.0 / PERIOD_S)))
    alarms: dict[str, float] = field(default_factory=dict)
    reasons: list[str] = field(default_factory=list)

    def reset(self) -> None:
        """Clears motion, alarms and reasons."""
        self.seconds = self.travel_m = self.standstill_s = self.path_error_m = 0.0
        self.fastest_mps = self.steepest = 0.0
        self.alarms, self.reasons = {}, []
        self.speeds_mps.clear()

    def __call__(self, envelope: Envelope) -> None:
        """Processes a message."""
        message = envelope.message
        if isinstance(message, TrueMachine):
            self._add_motion(self.newest.get(envelope.topic), message)
        elif isinstance(message, SupervisorState):
            self._add_state(message)
        elif isinstance(message, Fault) and message.is_active:
            self._add_alarm(f"{message.code} ({message.source})")
        self.newest[envelope.topic] = message

    def _add_motion(self, before: Message | None, now: TrueMachine) -> None:
        if not isinstance(before, TrueMachine):
            return
        self.seconds += PERIOD_S
        self.speeds_mps.append(abs(now.speed_mps))
        if self.seconds <= self.reaction_s:
            self.fastest_mps = max(self.fastest_mps, abs(now.speed_mps))
        if self.standstill_s == 0.0:
            self.steepest = max(self.steepest, -math.copysign(1.0, now.speed_mps) * float(now.T_map_base[2, 0]))
        self.travel_m += math.dist(before.T_map_base[:2, 3], now.T_map_base[:2, 3])
        self.standstill_s = self.standstill_s + PERIOD_S if abs(now.speed_mps) < STANDING_MPS else 0.0
        path = self.newest.get("path")
        if isinstance(path, Path) and self.standstill_s == 0.0:
            self.path_error_m = max(self.path_error_m, _distance_m(path, now.T_map_base[:2, 3]))

    def _add_state(self, state: SupervisorState) -> None:
        if state.reason and (not self.reasons or self.reasons[-1] != state.reason):
            self.reasons.append(state.reason)
            self._add_alarm(state.reason)
        for rule in state.rules:
            if rule.text:
                self._add_alarm(rule.code)

    def _add_alarm(self, code: str) -> None:
        self.alarms.setdefault(code, self.seconds)

    @property
    def reason(self) -> str:
        """First reason of the supervisor that is not the name of a mode; "" without one."""
        return next((reason for reason in self.reasons if reason not in MODE_NAMES), "")

    @property
    def truth(self) -> TrueMachine | None:
        """True machine state."""
        truth = self.newest.get("truth_machine")
        return truth if isinstance(truth, TrueMachine) else None

    @property
    def state(self) -> SupervisorState | None:
        """Newest state of the supervisor."""
        state = self.newest.get("supervisor")
        return state if isinstance(state, SupervisorState) else None


def _distance_m(path: Path, p_map_m: np.ndarray) -> float:
    """Distance of a point (2,) to the nearest segment of the path."""
    square = ((path.p_map_m - p_map_m) ** 2).sum(axis=1)
    k = int(square.argmin())
    near = path.p_map_m[max(0, k - 1) : k + 2]
    return float(shapely.LineString(near).distance(shapely.Point(p_map_m))) if len(near) > 1 else math.sqrt(square[k])


def in_turn(monitor: DriveMonitor) -> bool:
    """In a turn with more than 0.2 rad of steering."""
    return _on(monitor, PathSectionType.TURN) and abs(monitor.truth.steering_angle_rad) > 0.2  # type: ignore[union-attr]


def on_swath(monitor: DriveMonitor) -> bool:
    """On a swath at full speed, which it has kept for a second, with the implement working."""
    if not _on(monitor, PathSectionType.SWATH) or not monitor.truth.is_working:  # type: ignore[union-attr]
        return False
    speeds_mps = monitor.speeds_mps
    is_steady = len(speeds_mps) == speeds_mps.maxlen and max(speeds_mps) - min(speeds_mps) < STEADY_MPS
    return is_steady and min(speeds_mps) > 2.5


def before_obstacle(monitor: DriveMonitor) -> bool:
    """On a swath with an obstacle ahead, before the machine stops."""
    if not _on(monitor, PathSectionType.SWATH) or monitor.state is None or monitor.truth is None:
        return False
    return monitor.state.clearance_m < 15.0 and monitor.truth.speed_mps > 1.5


def docking(monitor: DriveMonitor) -> bool:
    """Reversing into the bay under the docking speed limit."""
    if not _on(monitor, PathSectionType.DOCK) or monitor.state is None or monitor.truth is None:
        return False
    return monitor.truth.speed_mps < -0.4 and any(rule.code == speed_limit.DOCKING for rule in monitor.state.rules)


def _on(monitor: DriveMonitor, section_type: PathSectionType) -> bool:
    status = monitor.newest.get("mission")
    is_on = isinstance(status, MissionStatus) and status.section_type is section_type and monitor.truth is not None
    return is_on and monitor.state is not None and monitor.state.mode is Mode.AUTOMATIC


# by mission, in the order of occurrence; the line is at full speed after a few seconds
SITUATIONS = {
    "line": {"swath": on_swath},
    "demo": {"turn": in_turn, "obstacle": before_obstacle},
    "dock": {"docking": docking},
}
