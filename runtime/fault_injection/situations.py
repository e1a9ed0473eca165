"""What a cell of the campaign sees of a drive."""

import math
from dataclasses import dataclass, field

import numpy as np
import shapely

from messages.command import Mode, SupervisorState
from messages.faults import Fault
from messages.message import Envelope, Message
from messages.plan import MissionStatus, Path, PathSectionType
from messages.truth import TrueMachine

STANDING_MPS, PERIOD_S = 0.02, 0.05  # the truth's period
MODE_WORDS = tuple(str(mode) for mode in Mode)


@dataclass
class Watch:
    """A sink: the newest message of each topic, and from `mark` on what happened."""

    newest: dict[str, Message] = field(default_factory=dict)
    seconds: float = 0.0  # since the mark, by the truth's own count: clocks may be wrong
    travel_m: float = 0.0
    still_s: float = 0.0
    error_m: float = 0.0
    told: list[str] = field(default_factory=list)
    reasons: list[tuple[float, str]] = field(default_factory=list)

    def mark(self) -> None:
        """Begin to count."""
        self.seconds = self.travel_m = self.still_s = self.error_m = 0.0
        self.told, self.reasons = [], []

    def __call__(self, envelope: Envelope) -> None:
        """Take note of a message."""
        message = envelope.message
        if isinstance(message, TrueMachine):
            self._move(self.newest.get(envelope.topic), message)
        elif isinstance(message, SupervisorState):
            self._listen(message)
        elif isinstance(message, Fault) and message.is_active:
            self._tell(f"{message.code} ({message.source})")
        self.newest[envelope.topic] = message

    def _move(self, before: Message | None, now: TrueMachine) -> None:
        if not isinstance(before, TrueMachine):
            return
        self.seconds += PERIOD_S
        self.travel_m += math.dist(before.T_map_base[:2, 3], now.T_map_base[:2, 3])
        self.still_s = self.still_s + PERIOD_S if abs(now.speed_mps) < STANDING_MPS else 0.0
        path = self.newest.get("path")
        if isinstance(path, Path) and self.still_s == 0.0:
            self.error_m = max(self.error_m, _distance_m(path, now.T_map_base[:2, 3]))

    def _listen(self, state: SupervisorState) -> None:
        if state.reason and (not self.reasons or self.reasons[-1][1] != state.reason):
            self.reasons.append((self.seconds, state.reason))
        for rule in state.rules:
            if rule.text:
                self._tell(rule.code)

    def _tell(self, code: str) -> None:
        if code not in self.told:
            self.told.append(code)

    @property
    def reason(self) -> str:
        """Why the machine stopped: the first word of the supervisor that is one of a stop, else its first word."""
        words = [reason for _, reason in self.reasons if reason not in MODE_WORDS]
        return words[0] if words else ""

    @property
    def truth(self) -> TrueMachine | None:
        """The machine as it is."""
        truth = self.newest.get("truth_machine")
        return truth if isinstance(truth, TrueMachine) else None

    @property
    def state(self) -> SupervisorState | None:
        """The supervisor's newest word."""
        state = self.newest.get("supervisor")
        return state if isinstance(state, SupervisorState) else None


def _distance_m(path: Path, p_map_m: np.ndarray) -> float:
    """From the path as a line; the nearest part counts."""
    square = ((path.p_map_m - p_map_m) ** 2).sum(axis=1)
    k = int(square.argmin())
    near = path.p_map_m[max(0, k - 1) : k + 2]
    return float(shapely.LineString(near).distance(shapely.Point(p_map_m))) if len(near) > 1 else math.sqrt(square[k])


def in_turn(watch: Watch) -> bool:
    """Within a turn, the wheels turned."""
    return _on(watch, PathSectionType.TURN) and abs(watch.truth.steering_angle_rad) > 0.2  # type: ignore[union-attr]


def on_swath(watch: Watch) -> bool:
    """On a swath at full speed, the implement working."""
    return _on(watch, PathSectionType.SWATH) and watch.truth.is_working and watch.truth.speed_mps > 2.5  # type: ignore[union-attr]


def before_obstacle(watch: Watch) -> bool:
    """An obstacle is seen ahead, and the machine drives on while it may."""
    if not _on(watch, PathSectionType.SWATH) or watch.state is None or watch.truth is None:
        return False
    return watch.state.clearance_m < 15.0 and watch.truth.speed_mps > 1.5


def docking(watch: Watch) -> bool:
    """Back into the bay, where the speed of docking holds."""
    if not _on(watch, PathSectionType.DOCK) or watch.state is None or watch.truth is None:
        return False
    return watch.truth.speed_mps < -0.4 and any(rule.code == "speed_limit.docking" for rule in watch.state.rules)


def _on(watch: Watch, section_type: PathSectionType) -> bool:
    status = watch.newest.get("mission")
    is_on = isinstance(status, MissionStatus) and status.section_type is section_type and watch.truth is not None
    return is_on and watch.state is not None and watch.state.mode is Mode.AUTOMATIC


# by mission, in the order in which they come about
SITUATIONS = {
    "demo": {"turn": in_turn, "swath": on_swath, "obstacle": before_obstacle},
    "dock": {"docking": docking},
}
